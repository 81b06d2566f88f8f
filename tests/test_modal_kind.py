"""The look at a record before it is fitted as a free decay: what is plainly random is refused, and nothing else."""

import numpy as np
import pytest

from fsw.modal import decay
from fsw.modal.coordinates import principal_coordinates
from fsw.modal.correlation import fixed_window
from fsw.modal.kind import may_fall_freely
from fsw.modal.result import Options
from sim.bench.modal_records import AMBIENT, DECAYS, ON_BOARD, free_decay, published, stationary


def worth_a_fit(time_s, y):
    return may_fall_freely(principal_coordinates(time_s, y, 12), Options())


@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "least"), [(10.0, 46.0, 0.5), (30.0, 20.0, 0.75), (120.0, 20.0, 0.9)]
)
def test_a_random_response_is_seldom_fitted_as_a_decay(duration_s, rate_hz, least):
    modes, _, _, points, noise_mm = AMBIENT["A2"]
    refused = [not worth_a_fit(*stationary(modes, duration_s, rate_hz, points, noise_mm, 500 + s)) for s in range(20)]
    assert np.mean(refused) >= least


def test_of_a_few_cycles_random_responses_are_refused_and_decays_are_not():
    modes, rate_hz, points, noise_mm = ON_BOARD
    for seconds in (4.0, 6.0):
        time_s = np.arange(round(seconds * rate_hz)) / rate_hz
        assert all(worth_a_fit(time_s, free_decay(modes, time_s, points, noise_mm, 530 + s).noisy) for s in range(8))
    refused = [not worth_a_fit(*stationary(modes, 6.0, rate_hz, points, noise_mm, 530 + s)) for s in range(24)]
    assert np.mean(refused) >= 0.3


@pytest.mark.parametrize("seed", [540, 541, 542, 543])
def test_what_two_looks_leave_much_of_is_not_looked_at_again(seed, monkeypatch):
    modes, rate_hz, points, noise_mm = ON_BOARD
    looks = []
    search = decay.subspace_candidates
    monkeypatch.setattr(decay, "subspace_candidates", lambda *given: looks.append(given) or search(*given))
    coordinates = principal_coordinates(*stationary(modes, 6.0, rate_hz, points, noise_mm, seed), 12)
    settled, _ = decay.find_decay(coordinates.time_s, coordinates.signals, rate_hz, fixed_window, Options())
    moving = coordinates.signals - coordinates.signals.mean(axis=0)
    left = settled.fit.span.fit(coordinates.signals).cost / np.sum(moving**2)
    assert len(looks) <= 2 or left < 0.02


@pytest.mark.parametrize("gap", [0, 3, 15])
@pytest.mark.parametrize("case", DECAYS)
def test_a_decay_is_worth_a_fit_whatever_frames_are_missing(case, gap):
    for seed in range(510, 516):
        record = published(case, seed)
        there = np.random.default_rng(seed).uniform(size=len(record.time_s)) > 0.1
        there[len(there) // 3 :][:gap] = False
        assert worth_a_fit(record.time_s[there], record.noisy[there])


@pytest.mark.parametrize("disturbance", ["lamp", "drift"])
def test_what_wanders_beside_a_decay_does_not_hide_it(disturbance):
    """A lamp as loud as the wing, whose phase walks at random, and a drift that does."""
    modes, _, rate_hz, points, noise_mm = DECAYS["D2"]
    time_s = np.arange(600) / rate_hz
    worth = []
    for seed in range(520, 540):
        y = free_decay(modes, time_s, points, noise_mm, seed).noisy
        walk = np.cumsum(np.random.default_rng(seed).standard_normal(len(time_s)))
        lamp = np.cos(2.0 * np.pi * 1.7 * time_s + 0.02 * walk)
        disturbed = lamp if disturbance == "lamp" else walk / len(time_s) ** 0.5
        worth.append(worth_a_fit(time_s, y + 20.0 * disturbed[:, None] * np.linspace(0.2, 1.0, y.shape[1])))
    assert np.mean(worth) > 0.7
