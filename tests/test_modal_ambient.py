"""Identification of stationary response, forced lines, noise, and the real records."""

from pathlib import Path

import numpy as np
import pytest
import scipy.signal

from fsw.channels import read_channels
from fsw.modal.ambient import Peak, expected_peak
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.gates import ambient_flags
from fsw.modal.pipeline import identify
from fsw.modal.stationary_drift import CHANGES, drift_profile, moves
from fsw.modal.stationary_modes import modal_filter
from fsw.modal.stationary_start import begin_with_a_blow, start_gain
from fsw.modal.uncertainty import au_law
from sim.bench.modal_records import AMBIENT, DAMPING, DECAYS, free_decay, moving, pole, stationary

RECORDS = Path(__file__).parents[2] / "shared" / "data" / "records"
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


@pytest.fixture(scope="module")
def steady():
    """Per case what is identified of some steady responses."""
    return {case: [identify(*stationary(*AMBIENT[case], seed)) for seed in range(500, 504)] for case in AMBIENT}


@pytest.mark.parametrize("case", AMBIENT)
def test_ambient_modes_are_all_found_within_their_intervals_and_nothing_else(steady, case):
    hz = list(AMBIENT[case][0].values())
    deviations = []
    for found in steady[case]:
        assert found.kind == "ambient"
        near = [[m for m in found.modes if abs(m.frequency_hz - f) < 0.02 * f] for f in hz]
        assert all(near)
        # 86 cycles leave the first modes' damping so uncertain that they may be told apart from a line, or not.
        assert all(any(m.valid for m in modes) for f, modes in zip(hz, near, strict=True) if f > 1.0)
        for f, modes in zip(hz, near, strict=True):
            for m in (m for m in modes if m.valid):
                deviations.append((m.frequency_hz - f) / m.frequency_sigma_hz)
                deviations.append((m.damping_ratio - DAMPING) / m.damping_ratio_sigma)
        assert sum(m.valid for modes in near for m in modes) == len(found.valid_modes) <= len(hz)
    assert len(deviations) >= 2 * len(steady[case]) * (len(hz) - 0.5)
    assert np.mean(np.abs(deviations) < 1.96) > 0.8


@pytest.mark.parametrize("kind", ["auto", "decay", "ambient"])
@pytest.mark.parametrize("channels", [1, 20])
@pytest.mark.requirement("WB-MOD-04")
def test_noise_holds_no_valid_mode(kind, channels):
    for seed in range(2):
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


@pytest.mark.parametrize("case", ["A1", "A2"])
@pytest.mark.parametrize("change", [-0.03, 0.03])
def test_frequencies_that_move_within_a_stationary_response_are_flagged_and_have_no_damping(case, change):
    found = identify(*moving(case, 31, change))
    assert found.kind == "ambient" and "time_varying" in found.flags
    assert found.valid_modes == []
    assert all(np.isnan(mode.damping_ratio) for mode in found.modes if "time_varying" in mode.flags)


# Each was struck by one gate or another: as begun with a blow, as moving, as a line, as a free decay (twice), as seen
# in too few orders (thrice), or as imprecise beside its own piece.
@pytest.mark.parametrize(
    ("case", "seed"),
    [
        *(("A1", seed) for seed in (20122, 9143, 5197, 30048, 30075, 30172, 30188)),
        *(("A2", seed) for seed in (20122, 9089, 20090, 30062)),
    ],
)
def test_chance_does_not_strike_right_modes(case, seed):
    valid = identify(*stationary(*AMBIENT[case], seed)).valid_modes
    assert len(valid) == len(AMBIENT[case][0])
    for f, mode in zip(sorted(AMBIENT[case][0].values()), valid, strict=True):
        assert abs(mode.frequency_hz - f) < 4.0 * mode.frequency_sigma_hz
        assert abs(mode.damping_ratio - DAMPING) < 4.0 * mode.damping_ratio_sigma


@pytest.mark.parametrize(
    ("gain", "share", "rise", "line"),
    [
        (1.0, 0.95, 400.0, True),
        (1.0, 0.6, 15.0, True),
        (1.0, 0.65, 45.0, False),
        (1.0, 0.75, 400.0, False),
        (50.0, 0.98, 400.0, True),
    ],
)
def test_a_line_explains_the_peak_but_for_noise(gain, share, rise, line):
    flags = ambient_flags(0.005, 0.002, Peak(1.0, 1.0, 100.0, rise, share), gain, 50.0, 8)
    assert flags == (["harmonic"] if line else [])


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_a_free_decay_under_a_random_force_is_no_stationary_response(strength):
    modes, _, rate_hz, points, noise_mm = AMBIENT["A2"]
    for seed in (1, 3):
        time_s, driven = stationary(modes, 125.0, rate_hz, points, 0.0, seed)
        found = identify(time_s, free_decay(modes, time_s, points, noise_mm, seed).noisy + strength * driven, "ambient")
        assert found.modes and not found.valid_modes
        assert any(mode.flags == ["not_exponential"] for mode in found.modes)


def gain_of_start(blow: float, seed: int) -> float:
    """Of a mode of 3 Hz and 0.5 % that is driven to unit deviation for 120 s, and struck at the start."""
    step = np.exp(pole(3.0) / 20.0)
    pushes = np.random.default_rng(seed).standard_normal((2, 3400)).T @ (1.0, 1j) * np.sqrt(1.0 - abs(step) ** 2)
    pushes[1000] += blow
    response = scipy.signal.lfilter([1.0], [1.0, -step], pushes)[1000:].real
    signal = response + 0.05 * np.random.default_rng([seed, 1]).standard_normal(2400)
    return start_gain(signal, 20.0, 3.0, DAMPING, 2.0 * 0.05**2 / 2400)


def test_a_response_that_begins_with_a_blow_is_told_from_one_that_begins_by_chance():
    without = [gain_of_start(0.0, seed) for seed in range(60)]
    # Chance gains about as much as a chi-square of two degrees of freedom: mean 2, a tenth above 2 ln 10.
    assert 1.0 < np.mean(without) < 3.5 and 0.03 < np.mean(np.array(without) > 2.0 * np.log(10.0)) < 0.25
    assert not any(begin_with_a_blow([gain]) for gain in without)
    assert not any(begin_with_a_blow(without[k : k + 4]) for k in range(0, 60, 4))
    assert all(begin_with_a_blow([gain_of_start(8.0, seed)]) for seed in range(4))
    weak = [gain_of_start(5.0, seed) for seed in range(4)]
    assert begin_with_a_blow(weak), "together they tell what each of them may leave open"


@pytest.mark.parametrize("case", ["A1", "A2"])
def test_frequencies_of_a_steady_response_do_not_move(steady, case):
    for found in (*steady[case], identify(*moving(case, 33, 0.0))):
        assert not any("time_varying" in mode.flags for mode in found.modes)


def test_a_frequency_that_moves_is_most_likely_with_its_own_change():
    time_s = np.arange(6000) / 20.0
    step = np.exp(-0.1 / 20.0)
    for change in (-0.04, 0.0, 0.02):
        phase = 2.0 * np.pi * 3.0 * (time_s + change * (time_s**2 / 600.0 - time_s / 2.0))
        found = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            pushes = rng.standard_normal((2, 9000))
            envelope = scipy.signal.lfilter([1.0], [1.0, -step], pushes[0] + 1j * pushes[1])[3000:]
            signal = (envelope * np.exp(1j * phase)).real + 0.5 * rng.standard_normal(6000)
            profile = drift_profile(signal, 20.0, 3.0, 0.1 / (6.0 * np.pi), 0.25 / 6000 / 100.0)
            found.append(CHANGES[int(np.argmax(profile))])
            assert moves([profile]) == (change < 0.0) or change > 0.0
        assert np.mean(found) == pytest.approx(change, abs=0.005)


def test_what_is_far_too_damped_to_vibrate_is_no_mode():
    _, _, rate_hz, points, _ = DECAYS["D2"]
    time_s = np.arange(1600) / rate_hz
    walk = np.cumsum(np.random.default_rng(17506).standard_normal(1600)) / 40.0
    decay = free_decay(DECAYS["D2"][0], time_s, points, 0.2, 17506).noisy
    found = identify(time_s, decay + 100.0 * walk[:, None] * np.linspace(0.2, 1.0, 20))
    assert all(mode.frequency_hz < 0.5 * rate_hz for mode in found.modes)


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


def candidate(frequency_hz: float, shape: list[float]) -> Candidate:
    s = 2j * np.pi * frequency_hz
    return Candidate(Pole(2, s, np.array(shape, np.complex128), 1.0, 1.0, True), 3, frequency_hz, 0.0)


@pytest.mark.parametrize("neighbours", [[[0.8, 0.6]], [[0.0, 1.0]], [[0.8, 0.6], [0.8, 0.61], [0.0, 1.0]]])
def test_a_mode_passes_whole_whatever_its_neighbours_shapes_are(neighbours):
    own = candidate(1.0, [0.8, 0.6])
    near = [candidate(1.05, shape) for shape in neighbours]
    weights = modal_filter(own, [own, *near])
    assert weights @ [0.8, 0.6] == pytest.approx(1.0)
    if len(near) == 1 and neighbours[0][0] == 0.0:
        assert weights @ [0.0, 1.0] == pytest.approx(0.0, abs=1e-12)
