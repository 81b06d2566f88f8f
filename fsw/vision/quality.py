"""How well points are matched: precision, recall, MU and the comprehensive matching parameter (Eq. 24-30)."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.enhancement import apply_homography

FloatArray = NDArray[np.float64]

PRECISION_WEIGHT = 20.0  # b of Eq. 24
_MIN_POINTS = 4  # that a homography needs


class MatchQuality(NamedTuple):
    """Counts and rates of a matching; coverage is detected over total."""

    total: int
    detected: int
    correct: int
    precision: float
    recall: float
    coverage: float
    uniqueness: float


def uniqueness(precision: float, recall: float, weight: float = PRECISION_WEIGHT) -> float:
    """Matching uniqueness MU (Eq. 24): with b = 20 almost the precision alone. 0 where nothing is right."""
    if precision <= 0.0 or recall <= 0.0:
        return 0.0
    return (1.0 + weight**2) / (weight**2 / precision + 1.0 / recall)


def match_quality(total: int, detected: int, correct: int, weight: float = PRECISION_WEIGHT) -> MatchQuality:
    """P, R (Eq. 25) and MU of so many correct matches among the detected, of a scene with this total of points."""
    precision = correct / detected if detected else 0.0
    recall = correct / total if total else 0.0
    coverage = detected / total if total else 0.0
    return MatchQuality(total, detected, correct, precision, recall, coverage, uniqueness(precision, recall, weight))


def comprehensive(char: float, matching_uniqueness: float) -> float:
    """Comprehensive matching parameter CMP (Eq. 30): harmonic mean of char and MU."""
    total = char + matching_uniqueness
    return 2.0 * char * matching_uniqueness / total if total > 0.0 else 0.0


def homography_error(H: FloatArray, from_px: FloatArray, to_px: FloatArray) -> FloatArray:
    """Distance eta (n,) in px between points (n, 2) and where H (3, 3) sends their partners (n, 2) (Eq. 26-29)."""
    return np.asarray(np.linalg.norm(apply_homography(H, from_px) - to_px, axis=-1))


def correct_matches(
    from_px: FloatArray, to_px: FloatArray, limit_px: float, H: FloatArray | None = None
) -> NDArray[np.bool_]:
    """Which matched points (n, 2) obey the homography constraint eta < limit_px.

    H (3, 3): a known mapping (from a pose, or from the truth); without it the mapping that most pairs support is
    estimated, which a matching that is wrong throughout but consistent would pass: only a known mapping shows that.
    """
    if H is None:
        if len(from_px) < _MIN_POINTS:
            return np.zeros(len(from_px), dtype=np.bool_)
        # LMEDS draws its samples from a generator of its own with a fixed seed: the same points give the same
        # mapping.
        found, _ = cv2.findHomography(from_px, to_px, cv2.LMEDS)
        if found is None:
            return np.zeros(len(from_px), dtype=np.bool_)
        H = np.asarray(found, dtype=np.float64)
    return np.asarray(homography_error(H, from_px, to_px) < limit_px)
