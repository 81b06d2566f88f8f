"""Independent peers on the same records: pyOMA2 and pyyeti, where the extra `[peers]` is installed.

pyOMA2 runs its subspace methods with its own automatic clustering, pyyeti its ERA with automatic selection and the true
number of modes; both get the record as it is. They get no hint that the own method does not get, but that number.
"""

import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from os import devnull
from pathlib import Path

import numpy as np

from sim.bench.modal_records import FloatArray
from sim.bench.modal_scores import Found

# Block rows and highest order of pyOMA2; block rows of pyyeti's Hankel matrix.
_BLOCK_ROWS, _ORDER, _ERA_ROWS = 30, 24, 40


def peers(table: str, modes: int) -> dict[str, Callable[[FloatArray, FloatArray], list[Found]]]:
    """The peers that are installed and suit a table's kind of record; a line on stderr tells of those that are not."""
    found: dict[str, Callable[[FloatArray, FloatArray], list[Found]]] = {}
    if _installed("pyoma2"):
        found["pyOMA2 SSI-cov"] = lambda time_s, y: _pyoma2(time_s, y, "cov")
        found["pyOMA2 SSI-dat"] = lambda time_s, y: _pyoma2(time_s, y, "dat")
    if table == "decay" and _installed("pyyeti"):  # ERA is a method for impulse responses
        found["pyyeti ERA"] = lambda time_s, y: _pyyeti(time_s, y, modes)
    return found


_told: set[str] = set()


def _installed(package: str) -> bool:
    if find_spec(package) is not None:
        return True
    if package not in _told:
        _told.add(package)
        print(
            f"bench modal: {package} is not installed, its rows are left out: pip install '.[peers]'", file=sys.stderr
        )
    return False


def _rate_hz(time_s: FloatArray) -> float:
    return float(1.0 / np.median(np.diff(time_s)))


@contextmanager
def _quiet() -> Iterator[None]:
    """Neither warnings, logs nor progress of a peer between our rows."""
    before = sys.stderr
    logging.disable(logging.CRITICAL)
    with Path(devnull).open("w") as nowhere, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sys.stderr = nowhere
        try:
            yield
        finally:
            sys.stderr = before
            logging.disable(logging.NOTSET)


def _pyoma2(time_s: FloatArray, y: FloatArray, method: str) -> list[Found]:
    with _quiet():
        from pyoma2.algorithms import SSI
        from pyoma2.algorithms.data.run_params import Clustering
        from pyoma2.setup.single import SingleSetup

        setup = SingleSetup(y, fs=_rate_hz(time_s))
        algorithm = SSI(name="ssi", method=method, br=_BLOCK_ROWS, ordmax=_ORDER, step=2)
        setup.add_algorithms(algorithm)
        setup.run_by_name("ssi")
        algorithm.add_clustering(Clustering(name="automatic", quick="hier_avg"))
        try:
            algorithm.run_clustering("automatic")
        except (IndexError, ValueError):  # its clustering cannot do with very few poles
            return []
        modes = algorithm.result.clustering_results["automatic"]
        found = zip(np.atleast_1d(modes.Fn), np.atleast_1d(modes.Xi), strict=True)
        return [Found(float(f), float(damping)) for f, damping in found if np.isfinite(f)]


def _pyyeti(time_s: FloatArray, y: FloatArray, modes: int) -> list[Found]:
    with _quiet():
        from pyyeti.era import ERA

        era = ERA(
            y.T,
            _rate_hz(time_s),
            svd_tol=2 * modes,
            auto=True,
            alpha=_ERA_ROWS,
            MSV_lower_limit=0.0,
            damp_range=(0.0, 0.2),
            show_plot=False,
            verbose=False,
        )
    return [Found(float(f), float(damping)) for f, damping in zip(era.freqs_hz, era.zeta, strict=True)]
