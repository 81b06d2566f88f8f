"""The damping of a stationary response by the flanks of its peak."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsw.modal.ambient import Peak, weigh_peak
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.stationary_flanks import with_flanks
from fsw.modal.stationary_groups import Refined
from fsw.modal.stationary_likelihood import band_of, first_guess, half_band_hz, most_likely
from fsw.modal.stationary_posterior import posterior
from sim.bench.modal_bounds import uncertainty_law

FloatArray = NDArray[np.float64]
HZ, DAMPING, RATE_HZ, DURATION_S = 4.2, 0.005, 20.0, 120.0
SEEDS = range(120)


def response(seed: int, slope: float = 0.0, noise: float = 0.02) -> FloatArray:
    """Displacement (T,) of unit rms of a mode under a force whose spectrum is as f^slope, cut out of a longer one."""
    count, rng = round(8.0 * DURATION_S * RATE_HZ), np.random.default_rng(seed)
    f = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    force = rng.standard_normal((2, len(f))) * np.maximum(f / HZ, 0.05) ** (0.5 * slope)
    q = np.fft.irfft((force[0] + 1j * force[1]) / (HZ**2 - f**2 + 2j * DAMPING * HZ * f), count)
    return (q / np.std(q))[: round(DURATION_S * RATE_HZ)] + noise * rng.standard_normal(round(DURATION_S * RATE_HZ))


def nearby(signal: FloatArray) -> tuple[Refined, Peak]:
    """The mode as the band about its peak tells it."""
    half_hz = half_band_hz(HZ, DAMPING, len(signal) / RATE_HZ)
    band = band_of(signal[:, None], RATE_HZ, HZ - half_hz, HZ + half_hz)
    start = first_guess(band, np.array([HZ]), np.array([2.0 * np.pi * HZ * DAMPING]), np.ones((1, 1)))
    told = posterior(band, most_likely(band, start).modes, 0, np.ones(1))
    s = complex(-told.decay_rate, 2.0 * np.pi * told.frequency_hz)
    pole = Pole(2, s, np.ones(1, np.complex128), 1.0, 1.0, True)
    candidate = Candidate(pole, 9, pole.frequency_hz, pole.damping_ratio)
    peak = weigh_peak(signal, RATE_HZ, pole.frequency_hz, pole.damping_ratio)
    assert peak is not None
    sigma = told.decay_rate_sigma / abs(s)
    return Refined(candidate, told.frequency_sigma_hz, sigma, told.line_gain, told.fall_gain, False), peak


def widened(signal: FloatArray, *others: Candidate) -> tuple[Refined, Refined]:
    """The mode as the band about its peak tells it, and with its flanks."""
    entry, peak = nearby(signal)
    return entry, with_flanks(entry, peak, signal, RATE_HZ, [entry.candidate, *others])


@pytest.mark.parametrize("slope", [0.0, -2.0])
def test_flanks_tell_the_damping_better_and_a_force_that_slopes_does_not_mislead_them(slope: float) -> None:
    pairs = [widened(response(seed, slope)) for seed in SEEDS]
    law = uncertainty_law(HZ, DURATION_S)[1]
    off = np.array([[entry.candidate.damping_ratio - DAMPING for entry in pair] for pair in pairs]) / law
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert rms[1] < 0.94 * rms[0] and rms[1] < 1.25
    sigma = np.array([[entry.damping_sigma for entry in pair] for pair in pairs]) / law
    assert np.mean(np.abs(off[:, 1] / sigma[:, 1]) < 1.96) >= 0.92
    assert np.median(sigma[:, 1]) < 0.85 * np.median(sigma[:, 0])
    for before, after in pairs:
        assert after.candidate.frequency_hz == before.candidate.frequency_hz
        assert after.frequency_sigma_hz == before.frequency_sigma_hz
        assert after.candidate.pole.damping_ratio == pytest.approx(after.candidate.damping_ratio, rel=1e-4)


def test_a_mode_stays_as_it_is_beside_another_one_in_noise_and_in_a_short_record() -> None:
    signal = response(1)
    entry, after = widened(signal)
    assert after is not entry
    beside = replace(entry.candidate, frequency_hz=HZ + 1.5 * half_band_hz(HZ, DAMPING, DURATION_S))
    far = replace(entry.candidate, frequency_hz=2.0 * HZ)
    assert widened(signal, beside)[1].damping_sigma == entry.damping_sigma
    assert widened(signal, far)[1].damping_sigma == after.damping_sigma
    for untold in (response(1, noise=8.0), signal[: round(25.0 * RATE_HZ)]):
        entry, after = widened(untold)
        assert after is entry


def test_another_peak_in_a_flank_that_nobody_found_does_not_pass_for_damping() -> None:
    time_s = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    line = np.cos(2.0 * np.pi * (HZ + 0.35) * time_s)
    for seed in range(8):
        entry, after = widened(response(seed) + 0.5 * line)
        assert abs(after.candidate.damping_ratio - DAMPING) < 4.0 * after.damping_sigma
        assert abs(after.candidate.damping_ratio - entry.candidate.damping_ratio) < 3.0 * entry.damping_sigma
