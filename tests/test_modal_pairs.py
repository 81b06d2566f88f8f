"""Close pairs in a stationary response: found, told apart, or not believed."""

import numpy as np
import pytest
import scipy.signal

from fsw.modal.clustering import Candidate, Pole
from fsw.modal.pipeline import identify
from fsw.modal.stationary_groups import Refined, refined
from fsw.modal.stationary_likelihood import band_of, first_guess, most_likely
from fsw.modal.stationary_posterior import posterior
from sim.bench import modal_records
from sim.bench.modal_records import AMBIENT, pole, stationary

RATE_HZ, SAMPLES, NOISE = 20.0, 2400, 0.05


def response(frequency_hz: float, damping: float, seed: int) -> np.ndarray:
    """Analytic signal (T,) of unit variance of a mode driven by white force."""
    step = np.exp(pole(frequency_hz, damping) / RATE_HZ)
    pushes = np.random.default_rng(seed).standard_normal((2, 12000)).T @ (1.0, 1j) * np.sqrt(1.0 - abs(step) ** 2)
    return scipy.signal.lfilter([1.0], [1.0, -step], pushes)[-SAMPLES:]


def found_from_one(modes: list[tuple[float, float, float, list[complex]]], seed: int) -> list[Refined]:
    """What a single candidate at the first of the modes becomes; each is frequency, damping, deviation and shape."""
    signals = NOISE * np.random.default_rng([seed, 9]).standard_normal((SAMPLES, 4))
    for j, (f, damping, deviation, shape) in enumerate(modes):
        signals = signals + deviation * (response(f, damping, 100 * seed + j)[:, None] * np.array(shape)).real
    f, damping, _, shape = modes[0]
    own = Pole(8, pole(f, damping), np.array(shape, np.complex128), 1.0, 1.0, True)
    signals -= signals.mean(axis=0)
    return refined([Candidate(own, 9, f, damping)], signals, np.fft.rfft(signals, axis=0), RATE_HZ)


@pytest.mark.parametrize("damping", [0.001, 0.005, 0.02])
def test_a_mode_that_was_taken_for_one_with_its_neighbour_is_found(damping):
    alone = 0
    for seed in range(8):
        pair = [(0.73, damping, 4.0, [1.0, 0.0, 0.0, 0.0]), (0.77, damping, 2.0, [0.9, 0.43, 0.0, 0.0])]
        found = sorted(found_from_one(pair, seed), key=lambda entry: entry.candidate.frequency_hz)
        alone += len(found) == 1
        for (f, *_, shape), entry in zip(pair, found, strict=False):
            assert abs(entry.candidate.frequency_hz - f) < 4.0 * entry.frequency_sigma_hz
            assert abs(np.vdot(entry.candidate.pole.shape, shape)) > 0.95 * np.linalg.norm(shape)
    assert alone <= 1


# One pole stood for both, or a second one of the first one's shape beside it, or one seen in few orders.
@pytest.mark.parametrize("seed", [8, 9070, 9127, 9169, 9187])
def test_both_of_a_pair_of_the_published_case_are_valid(seed):
    hz = sorted(AMBIENT["A2"][0].values())
    valid = identify(*stationary(*AMBIENT["A2"], seed)).valid_modes
    assert len(valid) == len(hz)
    assert all(abs(m.frequency_hz - f) < 4.0 * m.frequency_sigma_hz for f, m in zip(hz, valid, strict=True))


# A shape that is not quite real moves in a second direction, but in step with the first.
@pytest.mark.parametrize("shape", [[1.0, 0.0, 0.0, 0.0], [0.9, 0.43j, 0.0, 0.1]])
@pytest.mark.parametrize("damping", [0.001, 0.005, 0.03])
def test_one_mode_is_one_mode(shape, damping):
    for seed in range(6):
        assert len(found_from_one([(0.73, damping, 4.0, shape)], 50 + seed)) == 1


@pytest.mark.parametrize("damping", [0.001, 0.005, 0.03])
@pytest.mark.parametrize("apart_hz", [0.002, 0.008, 0.02])
def test_of_a_pair_that_is_hard_to_tell_apart_nothing_wrong_is_believed(monkeypatch, damping, apart_hz):
    monkeypatch.setattr(modal_records, "DAMPING", damping)
    _, duration_s, rate_hz, points, noise_mm = AMBIENT["A2"]
    pair_hz = np.array([0.73, 0.73 + apart_hz])
    modes = {"B1": pair_hz[0], "IP": pair_hz[1], "T1": 3.0, "B2": 4.2}
    for seed in (40000, 61000):
        found = identify(*stationary(modes, duration_s, rate_hz, points, noise_mm, seed))
        for mode in (m for m in found.valid_modes if m.frequency_hz < 1.0):
            assert np.min(np.abs(mode.frequency_hz - pair_hz)) < 4.0 * mode.frequency_sigma_hz
            assert abs(mode.damping_ratio - damping) < 4.0 * mode.damping_ratio_sigma


def test_a_damping_that_comes_out_too_low_by_chance_is_not_believed_too_well():
    f, deviations = 0.72, []
    rate = -pole(f).real
    for seed in range(300):
        noise = NOISE * np.random.default_rng([seed, 1]).standard_normal(SAMPLES)
        band = band_of((response(f, 0.005, 7000 + seed).real + noise)[:, None], RATE_HZ, 0.59, 0.85)
        group = most_likely(band, first_guess(band, np.array([f]), np.array([rate]), np.ones((1, 1))))
        found = posterior(band, group.modes, 0, np.ones(1))
        deviations.append((found.decay_rate - rate) / found.decay_rate_sigma)
    assert np.mean(np.abs(deviations) < 1.96) > 0.94
    assert np.min(deviations) > -3.5 and np.mean(np.array(deviations) < -2.5) < 0.01
