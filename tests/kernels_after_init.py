"""Flies a scenario and prints the flight side's kernels that no INIT called: python FILE NAME SECONDS FOLDER.

The flight is short, and so decays and stationary responses are identified after it. In a process of its own, for
whatever called a kernel before would hide that no INIT does.
"""

import gc
import sys
from contextlib import redirect_stdout
from itertools import product
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from fsw.executive.executive import Executive
from fsw.modal.pipeline import identify
from sim.bench.modal_records import DECAYS, free_decay, stationary
from wingbeat.cli import main


def ready() -> set[str]:
    """Kernels of the flight side that are compiled, each with the types that it is compiled for."""
    found = (each for each in gc.get_objects() if isinstance(each, Dispatcher))
    ours = (each for each in found if each.py_func.__module__.startswith("fsw."))
    return {f"{each.py_func.__module__}.{each.py_func.__name__}{types}" for each in ours for types in each.overloads}


def identified(kind: str, seed: int) -> None:
    """What a flight does with 30 s of a wing that swings or is shaken; some cells are hidden now and then."""
    modes, seen = DECAYS["D2"][0], ((6, 5), 0.2, seed)
    time_s, z_mm = stationary(modes, 30.0, 15.0, *seen)
    if kind == "decay":
        z_mm = free_decay(modes, time_s, *seen).noisy
    z_mm[np.random.default_rng(seed).random(z_mm.shape) < 0.02] = np.nan
    found = identify(time_s, np.repeat(z_mm, 3, axis=1).astype(np.float32), overwrite=True, whole=True)
    assert found.kind == kind and found.valid_modes


def run(scenario: str, duration_s: str, folder: str) -> None:
    """Fly, and print."""
    begun: list[set[str]] = []
    init = Executive.init

    def noted(self: Executive, *arguments: Any) -> None:
        init(self, *arguments)
        begun.append(ready())

    Executive.init = noted  # type: ignore[method-assign]
    sys.argv = ["wingbeat", "sil", scenario, "--duration", duration_s, "--out", folder]
    with redirect_stdout(sys.stderr):
        try:
            main()
        except SystemExit as end:
            assert not end.code, end.code
    assert begun
    for kind, seed in product(("decay", "ambient"), range(3)):
        identified(kind, seed)
    print("\n".join(sorted(ready() - begun[-1])))


if __name__ == "__main__":
    run(*sys.argv[1:])
