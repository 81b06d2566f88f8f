"""Whether a peer is nearer to the truth than the own method, and by how much more than chance.

Errors of two methods on the same records rise and fall together. So both are compared on the modes that both of them
found, and the deviation of what is between them is that of records drawn again (bootstrap: Efron, 1979), the same for
both.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from sim.bench.modal_scores import MEDIAN, NAMES, WITHIN, Score
from sim.bench.table import Row

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_DRAWS = 500
# Name of a quantile of errors, its share, and its value at the bound.
_QUANTILES = (("median", 0.5, MEDIAN), ("p95", 0.95, WITHIN))


def beside(table: str, case: str, own: Score, peers: dict[str, Score], oracle: Score) -> list[Row]:
    """A row for each accuracy column of a record's modes, and of all together: the own error beside the nearest peer's.

    Errors are over the bound; `nearer_by` is the peer's less the own: below zero the peer is nearer.
    """
    modes = {f"{f:.2f} Hz": [j] for j, f in enumerate(own.frequency_hz)}
    parts = modes | {"whole": list(range(len(modes)))}
    rows: list[Row] = []
    for (part, of_part), (k, name), (column, share, unit) in product(parts.items(), enumerate(NAMES), _QUANTILES):
        three = {
            peer: np.stack([score.over_bound()[:, of_part, k] for score in (own, its, oracle)]) / unit
            for peer, its in peers.items()
        }
        values = {peer: _quantile(errors, share) for peer, errors in three.items() if _found(errors).any()}
        if not values:
            continue
        nearest = min(values, key=lambda peer: values[peer][1] - values[peer][0])
        ours, its_own, best = values[nearest]
        rows.append(
            {
                "table": f"{table} beside peers",
                "method": nearest,
                "case": f"{case} {part}",
                "column": f"{name} {column}",
                "wingbeat": ours,
                "peer": its_own,
                "oracle": best,
                "nearer_by": its_own - ours,
                "deviation": _deviation(three[nearest][:2], share),
                "peer_missed": int(np.count_nonzero(np.isnan(three[nearest][1]))),
            }
        )
    return rows


def _found(errors: FloatArray) -> BoolArray:
    """Modes (records, modes) that all methods (methods, records, modes) found."""
    return np.isfinite(errors).all(axis=0)


def _quantile(errors: FloatArray, share: float) -> list[float]:
    """Quantile of each method's errors (methods, records, modes), of the modes that all of them found."""
    return [float(value) for value in np.quantile(errors[:, _found(errors)], share, axis=1)]


def _deviation(errors: FloatArray, share: float) -> float:
    """Deviation of the difference of two methods' quantiles (2, records, modes), over records drawn again."""
    rng = np.random.default_rng(0)
    told = errors[:, _found(errors).any(axis=1)]
    records = told.shape[1]
    drawn = [np.subtract(*_quantile(told[:, rng.integers(0, records, records)], share)) for _ in range(_DRAWS)]
    return float(np.std(drawn))
