"""MU and CMP reproduce the paper's Tables 4 and 5 from its counts, with 234 points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.vision.quality import comprehensive, correct_matches, match_quality, uniqueness

# method: detected, correct, MU (Table 4), char, CMP (Table 5)
PAPER = {
    "SIFT": (14, 8, 0.5499, 0.4665, 0.5048),
    "SuperGlue": (18, 16, 0.8631, 0.4665, 0.6057),
    "paper": (3, 3, 0.8389, 0.9091, 0.8726),
}


@pytest.mark.parametrize("method", PAPER)
@pytest.mark.requirement("WB-VIS-06")
def test_tables_4_and_5_come_out_with_one_panels_234_points(method: str) -> None:
    detected, correct, mu, char, cmp = PAPER[method]
    quality = match_quality(234, detected, correct)
    assert quality.uniqueness == pytest.approx(mu, abs=6e-5)
    assert comprehensive(char, quality.uniqueness) == pytest.approx(cmp, abs=1.5e-4)
    assert match_quality(306, detected, correct).uniqueness != pytest.approx(mu, abs=1e-3)


def test_nothing_found_is_zero_and_all_right_is_one() -> None:
    assert match_quality(234, 0, 0).uniqueness == 0.0
    assert match_quality(0, 0, 0).recall == 0.0
    assert match_quality(234, 234, 234).uniqueness == pytest.approx(1.0)
    assert comprehensive(0.0, 0.0) == 0.0


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_uniqueness_lies_between_precision_and_recall(p: float, r: float) -> None:
    assert min(p, r) - 1e-12 <= uniqueness(p, r) <= max(p, r) + 1e-12


def test_the_homography_constraint_finds_wrong_matches_and_a_known_one_finds_a_common_shift() -> None:
    H = np.array([[1.1, 0.1, 4.0], [-0.05, 0.97, 9.0], [1e-4, -5e-5, 1.0]])
    a = np.stack(np.meshgrid(np.arange(0.0, 400, 40), np.arange(0.0, 300, 22)), axis=-1).reshape(-1, 2)
    w = a @ H[2, :2] + 1.0
    b = (a @ H[:2, :2].T + H[:2, 2]) / w[:, None]
    wrong = np.arange(len(a)) % 9 == 0
    b[wrong] += (41.0, 3.0)
    assert np.array_equal(correct_matches(a, b, 3.0), ~wrong)
    shifted = np.roll(b, 1, axis=0)
    assert correct_matches(a, shifted, 3.0, H).mean() < 0.1
    assert not correct_matches(a[:3], b[:3], 3.0).any()
