"""Identification of free decays: at the Cramer-Rao bound, none missed, none spurious, and never misleading."""

import numpy as np
import pytest

from fsw.modal.indicators import shape_assurance
from fsw.modal.pipeline import identify
from fsw.modal.refinement import project, refine
from fsw.modal.result import Options, to_contract
from fsw.modal.uncertainty import at_upper_end, modal_sigmas
from sim.bench.modal_bounds import cramer_rao
from sim.bench.modal_records import (
    AMBIENT,
    DAMPING,
    DECAYS,
    ON_BOARD,
    flight,
    free_decay,
    grid,
    pole,
    published,
    shapes,
    stationary,
)
from wingbeat.errors import InputError

D2 = DECAYS["D2"][0]
SEEDS = {"D1": 10, "D2": 6, "D3": 4}


def record_of(case, seed):
    record = published(case, seed)
    return record.time_s, record.noisy


@pytest.fixture(scope="module")
def runs():
    """Per case: errors over bound (seeds, modes, 2), errors over own sigma, numbers of valid modes."""
    table = {}
    for case, seeds in SEEDS.items():
        over_bound, over_sigma = [], []
        for seed in range(seeds):
            record = published(case, 100 + seed)
            found = identify(record.time_s, record.noisy)
            assert found.kind == "decay"
            assert [m.valid for m in found.modes] == [True] * len(record.frequency_hz), (case, seed, found.modes)
            truth = np.array([[f, DAMPING] for f in record.frequency_hz])
            error = np.array([[m.frequency_hz, m.damping_ratio] for m in found.modes]) - truth
            sigma = np.array([[m.frequency_sigma_hz, m.damping_ratio_sigma] for m in found.modes])
            over_bound.append(error / cramer_rao(record))
            over_sigma.append(error / sigma)
        table[case] = np.array(over_bound), np.array(over_sigma)
    return table


@pytest.mark.requirement("WB-MOD-01")
def test_no_mode_is_missed_none_is_spurious_and_errors_are_near_the_cramer_rao_bound(runs):
    pooled = np.concatenate([bound.ravel() for bound, _ in runs.values()])
    assert np.median(np.abs(pooled)) / 0.674 < 1.25
    for bound, _ in runs.values():
        assert np.max(np.abs(bound)) < 4.5


@pytest.mark.requirement("WB-MOD-02")
def test_intervals_of_95_per_cent_cover_about_95_per_cent(runs):
    pooled = np.concatenate([sigma.ravel() for _, sigma in runs.values()])
    assert 0.89 <= np.mean(np.abs(pooled) < 1.96) <= 0.99
    assert 0.8 < np.sqrt(np.mean(pooled**2)) < 1.25


def test_cramer_rao_bound_of_one_slowly_damped_line_is_the_textbook_value():
    # 24 sigma^2 / (a^2 N T^2): the variance of a real sinusoid's angular frequency, over many cycles.
    time_s = np.arange(2000) / 50.0
    record = free_decay({"B1": 5.0}, time_s, (2, 2), 0.1, 1, damping=1e-7)
    power = np.sum((record.amplitude_mm[:, None] * record.shape) ** 2)
    textbook = np.sqrt(24.0 * 0.1**2 / (power * len(time_s) * time_s[-1] ** 2)) / (2.0 * np.pi)
    assert cramer_rao(record)[0, 0] == pytest.approx(textbook, rel=0.01)


def test_information_of_a_fit_to_the_truth_is_the_cramer_rao_bound():
    record = published("D3", 1)
    poles = np.array([pole(f) for f in record.frequency_hz])
    fit = project(record.time_s, record.clean / record.noise_mm, poles, 0)
    assert np.allclose(modal_sigmas(poles, fit.information, np.ones(4)), cramer_rao(record), rtol=0.01)


def test_a_weak_decay_is_as_unsure_as_the_faster_one_that_it_may_be():
    time_s, rate, draw = np.arange(1200) / 20.0, pole(3.0), np.random.default_rng(8)
    clean = np.exp(rate * time_s).real[:, None] * np.array([1.0, 0.5])
    noise = draw.standard_normal(clean.shape)
    for sharpness, wider in ((40.0, 1.0), (0.8, 1.1)):
        fit = refine(time_s, sharpness * clean + noise, np.array([rate]), 0)
        found = modal_sigmas(fit.poles, fit.information, np.ones(1))
        share = found[0, 1] / (-fit.poles[0].real / abs(fit.poles[0]))
        upper = at_upper_end(fit, found, np.ones(1))
        # All of the decay lies in the record: its deviation grows like the damping's power 3 / 2.
        end = 1.0 if wider == 1.0 else (1.0 + 2.0 * share) ** 1.5
        assert upper[0, 1] / found[0, 1] >= wider
        assert end * 0.8 < upper[0, 1] / found[0, 1] < end * 1.4


def test_refinement_finds_the_exact_poles_of_a_noise_free_record_with_gaps_and_jitter():
    rng = np.random.default_rng(0)
    time_s = np.sort(rng.uniform(0.0, 20.0, 300))
    time_s -= time_s[0]
    clean = free_decay(D2, time_s, (5, 4), 0.0, 1).clean
    start = np.array([pole(0.722, 0.01), pole(3.01, 0.003), pole(4.18, 0.01)])
    fit = refine(time_s, clean, start, 2)
    assert np.allclose(fit.poles, [pole(f) for f in D2.values()], rtol=1e-9)


def test_information_of_the_fit_is_the_curvature_of_the_cost():
    time_s, noisy = record_of("D2", 3)
    fit = refine(time_s, noisy, np.array([pole(f) for f in D2.values()]), 1)
    step = 1e-5
    for k, move in enumerate((step, 1j * step)):
        moved = [project(time_s, noisy, fit.poles + sign * move * np.eye(3)[0], 1).cost for sign in (-1, 1)]
        assert (sum(moved) - 2 * fit.cost) / (2 * step**2) == pytest.approx(fit.information[k, k], rel=0.03)


@pytest.mark.parametrize("case", ["D1", "D2", "D4"])
def test_rounds_of_refinement_that_are_left_out_would_move_no_pole(case, monkeypatch):
    time_s, noisy = record_of(case, 5)
    found = identify(time_s, noisy).modes
    monkeypatch.setattr("fsw.modal.decay._STANDING", 0.0)
    monkeypatch.setattr("fsw.modal.decay._REFINEMENTS", 8)
    for mode, settled in zip(found, identify(time_s, noisy).modes, strict=True):
        assert abs(mode.frequency_hz - settled.frequency_hz) < 0.03 * settled.frequency_sigma_hz
        assert abs(mode.damping_ratio - settled.damping_ratio) < 0.03 * settled.damping_ratio_sigma
        assert mode.flags == settled.flags


@pytest.mark.requirement("WB-MOD-03")
def test_dropped_frames_and_jitter_cost_nothing_with_true_time_stamps():
    rng = np.random.default_rng(4)
    time_s = np.arange(600) / 20.0
    time_s = time_s[rng.uniform(size=600) > 0.1]
    time_s = time_s - time_s[0] + rng.uniform(0.0, 0.02, len(time_s))
    noisy = free_decay(D2, time_s, (5, 4), 0.2, 9).noisy
    noisy[rng.uniform(size=noisy.shape) < 0.003] = np.nan
    found = identify(time_s, noisy).modes
    assert [m.valid for m in found] == [True] * 3
    assert np.allclose([m.frequency_hz for m in found], list(D2.values()), rtol=1.5e-4)
    assert np.allclose([m.damping_ratio for m in found], DAMPING, rtol=0.05)


def test_shapes_and_amplitudes_are_those_of_the_record():
    time_s, noisy = record_of("D2", 5)
    form = shapes(*grid(5, 4))
    noisy[:, 7] = np.nan
    found = identify(time_s, noisy).modes
    for mode, name, amplitude in zip(found, ("B1", "T1", "B2"), (20.0, 3.0, 2.0), strict=True):
        assert np.isnan(mode.shape[7])
        rest = np.delete(np.arange(20), 7)
        assert shape_assurance(mode.shape[rest], form[name][2][rest].astype(complex)) > 0.998
        assert mode.amplitude == pytest.approx(amplitude, rel=0.1)


@pytest.mark.parametrize(("ticks", "limits"), [(75, (3e-3, 0.2)), (300, (2e-4, 0.03)), (900, (2e-4, 0.03))])
def test_flight_records_give_three_modes_and_no_echo_of_them(ticks, limits):
    found = identify(*flight(ticks, 7))
    valid = found.valid_modes
    assert len(valid) == 3 and not found.flags
    assert valid[0].frequency_hz == pytest.approx(0.7146, rel=limits[0])
    assert valid[0].damping_ratio == pytest.approx(0.006, rel=limits[1])
    assert np.allclose([m.frequency_hz for m in valid[1:]], [2.31, 4.37], rtol=1e-3)
    assert np.allclose([m.damping_ratio for m in valid[1:]], [0.009, 0.008], rtol=0.1)


@pytest.mark.requirement("WB-MOD-04")
def test_strong_echoes_at_multiples_and_sums_are_named_and_not_valid():
    found = identify(*flight(300, 3, echo=6e-3))
    assert len(found.valid_modes) == 3
    assert any("combination" in m.flags for m in found.modes)


@pytest.mark.parametrize("amplitude", [0.0, 3e-5])
@pytest.mark.parametrize("ticks", [75, 300])
def test_a_quiet_wing_is_not_observable(ticks, amplitude):
    found = identify(*flight(ticks, 11, amplitude_mm=(amplitude,) * 3))
    assert found.valid_modes == [] and "not_observable" in found.flags


def test_least_amplitude_of_interest_can_be_set():
    found = identify(*flight(75, 7, amplitude_mm=(0.3, 0.03, 0.03)), options=Options(minimum_amplitude=0.1))
    assert [round(m.frequency_hz, 1) for m in found.valid_modes] == [0.7]


@pytest.mark.requirement("WB-MOD-04")
def test_a_frequency_that_moves_is_flagged_and_its_damping_withheld():
    time_s = np.arange(400) / 20.0
    for seed in range(2):
        moving = identify(time_s, free_decay(D2, time_s, (5, 4), 0.2, seed, change=-0.03).noisy)
        assert "time_varying" in moving.flags and moving.valid_modes == []
        assert to_contract(moving)["modes"][0]["damping_ratio"] is None
        steady = identify(time_s, free_decay(D2, time_s, (5, 4), 0.2, seed).noisy)
        assert "time_varying" not in steady.flags


@pytest.mark.requirement("WB-MOD-04")
def test_a_lamp_line_is_a_harmonic_and_leaves_the_modes_alone():
    time_s, noisy = record_of("D2", 2)
    lamp = 0.8 * np.cos(2.0 * np.pi * 1.7 * time_s)[:, None] * np.linspace(0.2, 1.0, 20)
    found = identify(time_s, noisy + lamp)
    assert [m.flags for m in found.modes if abs(m.frequency_hz - 1.7) < 0.01] == [["harmonic"]]
    assert np.allclose([m.frequency_hz for m in found.valid_modes], [0.72, 3.0, 4.2], rtol=3e-4)


@pytest.mark.requirement("WB-MOD-04")
def test_a_mode_that_may_be_an_alias_is_not_valid():
    time_s = np.arange(160) / 8.0
    found = identify(time_s, free_decay({"B1": 0.72, "B2": 4.2}, time_s, (5, 4), 0.2, 3).noisy)
    assert [m.frequency_hz for m in found.valid_modes] == pytest.approx([0.72], rel=1e-3)
    assert found.modes[-1].flags == ["near_nyquist"] and "near_nyquist" in found.flags


@pytest.mark.requirement("WB-MOD-04")
def test_drift_is_no_mode():
    time_s, noisy = record_of("D2", 2)
    drift = (0.5 * time_s - 0.02 * time_s**2)[:, None] * np.linspace(0.2, 1.0, 20)
    assert [round(m.frequency_hz, 2) for m in identify(time_s, noisy + drift).modes] == [0.72, 3.0, 4.2]


@pytest.mark.requirement("WB-MOD-02")
def test_a_random_force_under_a_free_decay_widens_the_intervals():
    modes, _, rate_hz, points, noise_mm = AMBIENT["A2"]
    deviations, wider = [], []
    for seed in range(5):
        time_s, driven = stationary(modes, 80.0, rate_hz, points, 0.0, seed)
        record = free_decay(modes, time_s, points, noise_mm, seed)
        found, alone = (identify(time_s, y, "decay").valid_modes for y in (record.noisy + 0.03 * driven, record.noisy))
        assert [round(mode.frequency_hz, 2) for mode in found] == list(modes.values())
        for mode, quiet, f in zip(found, alone, modes.values(), strict=True):
            deviations.append((mode.frequency_hz - f) / mode.frequency_sigma_hz)
            deviations.append((mode.damping_ratio - DAMPING) / mode.damping_ratio_sigma)
            wider.append(mode.damping_ratio_sigma / quiet.damping_ratio_sigma)
    assert np.mean(np.abs(deviations) < 1.96) > 0.85 and np.max(np.abs(deviations)) < 4.0
    assert np.max(wider) > 5.0, "without it some would be off by far more than their intervals"


def test_drift_in_a_short_record_costs_neither_accuracy_nor_honesty():
    over_bound, over_sigma = {"still": [], "drifting": []}, []
    for seed in range(1200, 1220):
        record = published("D1", seed)
        x = 2.0 * record.time_s / record.time_s[-1] - 1.0
        rng = np.random.default_rng([seed, 7])
        slope, bend = 2.0 + 0.6 * rng.standard_normal(record.noisy.shape[1]), rng.standard_normal()
        drift = {"still": np.zeros_like(record.noisy), "drifting": np.outer(x, slope) + bend * (x**2)[:, None]}
        for name, errors in over_bound.items():
            (mode,) = identify(record.time_s, record.noisy + drift[name]).valid_modes
            error = np.array([mode.frequency_hz - record.frequency_hz[0], mode.damping_ratio - DAMPING])
            errors.append(error / cramer_rao(record)[0])
            over_sigma.append(error / [mode.frequency_sigma_hz, mode.damping_ratio_sigma])
    rms = {name: np.sqrt(np.mean(np.square(errors), axis=0)) for name, errors in over_bound.items()}
    assert (rms["drifting"] < 1.15 * rms["still"]).all()
    assert 0.9 < np.mean(np.abs(over_sigma) < 1.96) < 0.99


def test_quiet_before_the_strike_is_left_out():
    noisy = published("D2", 2).noisy
    quiet = 0.2 * np.random.default_rng(0).standard_normal((150, 20))
    found = identify(np.arange(750) / 20.0, np.vstack([quiet, noisy]))
    assert found.kind == "decay" and len(found.valid_modes) == 3
    assert found.valid_modes[0].damping_ratio == pytest.approx(DAMPING, rel=0.02)


def test_one_channel_is_enough():
    time_s, noisy = record_of("D2", 6)
    assert np.allclose(
        [m.frequency_hz for m in identify(time_s, noisy[:, -1]).valid_modes], [0.72, 3.0, 4.2], rtol=1e-3
    )


def test_same_input_gives_the_same_bytes():
    time_s, record = flight(75, 1)
    first, second = (identify(time_s, record.copy()) for _ in range(2))
    assert to_contract(first) == to_contract(second)
    assert first.diagram.frequency_hz.tobytes() == second.diagram.frequency_hz.tobytes()
    assert first.modes[0].shape.tobytes() == second.modes[0].shape.tobytes()


def test_diagram_shows_stable_poles_and_a_peak_at_the_modes():
    time_s, noisy = record_of("D2", 1)
    diagram = identify(time_s, noisy).diagram
    near = np.abs(diagram.frequency_hz - 3.0) < 0.03
    assert np.count_nonzero(near & diagram.stable) >= 5
    assert diagram.spectrum_hz[np.argmax(diagram.spectrum)] == pytest.approx(0.72, abs=0.04)


@pytest.mark.parametrize(
    ("time_s", "y"),
    [
        (np.arange(5.0), np.zeros((4, 2))),
        (np.array([0.0, 2.0, 1.0]), np.zeros((3, 2))),
        (np.zeros(0), np.zeros((0, 2))),
        (np.arange(5.0), np.zeros((5, 0))),
    ],
)
def test_arrays_that_do_not_fit_are_refused(time_s, y):
    with pytest.raises(InputError):
        identify(time_s, y)


@pytest.mark.parametrize("y", [np.zeros((100, 3)), np.full((100, 3), np.nan), np.ones((10, 3))])
def test_records_without_content_are_not_observable(y):
    found = identify(np.arange(len(y)) / 10.0, y)
    assert found.modes == [] and "not_observable" in found.flags


@pytest.mark.parametrize("kind", ["auto", "decay", "ambient"])
@pytest.mark.parametrize("channels", [1, 2, 40])
@pytest.mark.parametrize("samples", [2, 24, 25, 41])
def test_short_records_of_any_shape_are_taken(samples, channels, kind):
    rng = np.random.default_rng(samples)
    time_s = np.cumsum(rng.uniform(0.5, 1.5, samples))
    y = (
        0.1 * rng.standard_normal((samples, channels))
        + np.where(time_s > time_s[samples // 2], np.cos(time_s), 0.0)[:, None]
    )
    y[rng.uniform(size=y.shape) < 0.05] = np.nan
    found = identify(time_s, y, kind)
    assert all(np.isfinite(m.frequency_hz) for m in found.modes)


def test_a_pair_nearer_than_the_record_resolves_stands_apart_by_its_shapes_and_is_named():
    modes, rate_hz, _, noise_mm = ON_BOARD
    time_s = np.arange(round(6.0 * rate_hz)) / rate_hz
    record = free_decay(modes, time_s, (9, 8), noise_mm, 3, axes=slice(0, 3))
    found = identify(time_s, record.noisy)
    assert [round(mode.frequency_hz, 2) for mode in found.valid_modes] == [0.73, 0.76, 3.0, 4.2]
    assert "close_pair" in found.flags
    assert "close_pair" not in identify(*record_of("D2", 3)).flags


def test_a_pair_that_the_intervals_do_not_tell_apart_is_not_valid():
    time_s = np.arange(120) / 20.0
    record = free_decay({"B1": 0.73, "IP": 0.7301}, time_s, (5, 4), 0.5, 3)
    valid = identify(time_s, record.noisy).valid_modes
    assert len(valid) < 2
