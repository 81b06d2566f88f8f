"""Identification of stationary response, forced lines, noise, and the real records."""

from pathlib import Path

import numpy as np
import pytest

from fsw.channels import read_channels
from fsw.modal.ambient import expected_peak
from fsw.modal.pipeline import identify
from fsw.modal.uncertainty import au_law
from sim.bench.modal_records import DAMPING, stationary

RECORDS = Path(__file__).parents[2] / "shared" / "data" / "records"
MODES = {"B1": 0.72, "T1": 3.0, "B2": 4.2}
real_records = pytest.mark.skipif(not RECORDS.is_dir(), reason=f"the recorded channels {RECORDS} are not here")


def test_expected_periodogram_is_that_of_the_sampled_correlation():
    rate_hz, count, f0, decay = 50.0, 500, 5.0, 0.3
    duration_s = count / rate_hz
    lags = np.arange(1 - count, count)
    r = (1.0 - np.abs(lags) / count) * np.exp(-decay * np.abs(lags) / rate_hz) * np.cos(2 * np.pi * f0 * lags / rate_hz)
    f = f0 + np.linspace(-0.5, 0.5, 11)
    direct = (np.cos(2 * np.pi * f[:, None] * lags / rate_hz) @ r) / rate_hz
    assert np.allclose(expected_peak(f, f0, decay, duration_s), direct, rtol=0.03, atol=0.01)


def test_expected_periodogram_without_damping_is_the_window_of_the_record():
    f = np.array([5.0, 5.05, 5.1])
    assert np.allclose(expected_peak(f, 5.0, 1e-9, 10.0), 5.0 * np.sinc((f - 5.0) * 10.0) ** 2, atol=1e-3)


def test_uncertainty_law_gives_the_known_limits_of_120_s():
    f, damping = au_law(0.72, 0.005, 120.0)
    assert (f, damping) == (pytest.approx(0.0030, abs=1e-4), pytest.approx(0.61, abs=0.01))


def test_ambient_modes_are_found_within_their_intervals():
    deviations = []
    for seed in range(3):
        found = identify(*stationary(MODES, 120.0, 20.0, (5, 4), 0.2, 100 + seed))
        assert found.kind == "ambient"
        near = [[m for m in found.modes if abs(m.frequency_hz - f) < 0.02 * f] for f in MODES.values()]
        assert all(near)
        # 86 cycles leave the first mode's damping so uncertain that it may be told apart from a line, or not.
        assert all(any(m.valid for m in modes) for modes in near[1:])
        for f, modes in zip(MODES.values(), near, strict=True):
            for m in (m for m in modes if m.valid):
                deviations.append((m.frequency_hz - f) / m.frequency_sigma_hz)
                deviations.append((m.damping_ratio - DAMPING) / m.damping_ratio_sigma)
        assert sum(m.valid for modes in near for m in modes) == len(found.valid_modes)
    assert np.mean(np.abs(deviations) < 1.96) > 0.8


@pytest.mark.parametrize("kind", ["auto", "decay", "ambient"])
@pytest.mark.parametrize("channels", [1, 20])
@pytest.mark.requirement("WB-MOD-04")
def test_noise_holds_no_valid_mode(kind, channels):
    for seed in range(3):
        y = np.random.default_rng(seed).standard_normal((400, channels))
        for record in (y, np.cumsum(y, axis=0)):
            found = identify(np.arange(400) / 20.0, record, kind)
            assert found.valid_modes == []


@pytest.mark.parametrize("kind", ["auto", "decay", "ambient"])
def test_a_steady_line_is_a_harmonic(kind):
    time_s = np.arange(600) / 20.0
    noise = 0.1 * np.random.default_rng(0).standard_normal((600, 5))
    found = identify(time_s, np.sin(2 * np.pi * 0.9 * time_s)[:, None] + noise, kind)
    assert found.valid_modes == [] and "harmonic" in found.flags


@real_records
def test_the_slab_has_a_valid_mode_near_17_8_hz():
    channels = read_channels(RECORDS / "slab.npz")
    valid = identify(channels.time_s, channels.y).valid_modes
    assert any(17.6 <= m.frequency_hz <= 18.1 and 0.005 < m.damping_ratio < 0.02 for m in valid)


@real_records
@pytest.mark.parametrize("kind", ["auto", "decay", "ambient"])
def test_the_forced_lines_of_the_frame_are_not_valid_modes(kind):
    channels = read_channels(RECORDS / "shear_frame.npz")
    valid = identify(channels.time_s, channels.y, kind).valid_modes
    assert not any(abs(m.frequency_hz - line) < 0.05 for m in valid for line in (0.275, 0.55))
