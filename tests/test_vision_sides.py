"""The straight line through a side's segments: who has a say in it, and when it is nobody's."""

import numpy as np
import pytest

from fsw.vision.edges import SEGMENTS
from fsw.vision.straight import straight_side

SIGMA_PX = 3e-3
PLACES = (np.arange(SEGMENTS) + 0.5) / SEGMENTS - 0.5


def segments(offset_px: np.ndarray, sigma_px: np.ndarray | float = SIGMA_PX) -> np.ndarray:
    """Segments (n, 4) at the first places along the side, so far off a line of slope 0.02 at 0.1 px."""
    n = len(offset_px)
    told = np.zeros((n, 4))
    told[:, 0], told[:, 1] = PLACES[:n], 0.1 + 0.02 * PLACES[:n] + offset_px
    told[:, 2] = told[:, 3] = np.broadcast_to(sigma_px, n) ** 2
    return told


def test_the_line_and_its_variance_at_the_middle_are_those_of_least_squares() -> None:
    good, firm, middle, slope, variance, residual = straight_side(segments(np.zeros(4)), 4, SEGMENTS)
    design = np.stack([np.ones(4), PLACES[:4]], axis=1)
    covariance = SIGMA_PX**2 * np.linalg.inv(design.T @ design)
    assert good and firm and middle == pytest.approx(0.1) and slope == pytest.approx(0.02)
    assert variance == pytest.approx(covariance[0, 0]) and residual == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("off", "good", "firm"),
    [((0.5, -0.5), True, True), ((0.5, -0.5, 0.4), True, False), ((0.5, -0.5, 0.4, -0.4), False, False)],
)
def test_segments_off_the_line_are_dropped_while_half_agree(off: tuple[float, ...], good: bool, firm: bool) -> None:
    offset = np.zeros(SEGMENTS)
    offset[[1, 3, 4, 0][: len(off)]] = off
    told, sure, middle, *_ = straight_side(segments(offset), SEGMENTS, SEGMENTS)
    assert (told, sure) == (good, firm)
    assert not good or middle == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("found", "pieces", "good", "firm"),
    [(2, 2, True, True), (2, 3, True, True), (2, 4, True, False), (3, 6, True, False), (2, 6, False, False)],
)
def test_what_is_not_found_does_not_agree(found: int, pieces: int, good: bool, firm: bool) -> None:
    assert straight_side(segments(np.zeros(found)), found, pieces)[:2] == (good, firm)


@pytest.mark.parametrize(("times", "good", "firm"), [(4.0, True, True), (100.0, True, False)])
def test_a_segment_that_would_agree_with_any_line_has_no_say(times: float, good: bool, firm: bool) -> None:
    """In a shadow segments are four times less sure than in the light beside it; cut off at full scale, a hundred."""
    some = np.where(np.arange(SEGMENTS) < 3, times, 1.0)
    assert straight_side(segments(np.zeros(SEGMENTS), SIGMA_PX * some), SEGMENTS, SEGMENTS)[:2] == (good, firm)
    # Where all of the side is cut off, it is seen none the less.
    assert straight_side(segments(np.zeros(SEGMENTS), SIGMA_PX * times), SEGMENTS, SEGMENTS)[:2] == (True, True)
