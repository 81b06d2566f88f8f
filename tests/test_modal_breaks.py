"""Where a record breaks, and what a gap in a part of the channels does: nothing."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from fsw.channels import read_channels
from fsw.modal import pipeline
from fsw.modal.autoregression import Predicted, predict
from fsw.modal.breaks import last_break
from fsw.modal.coordinates import Coordinates, principal_coordinates
from fsw.modal.pieces import telling_piece
from fsw.modal.pipeline import identify
from fsw.modal.result import Options
from fsw.tasks.identify import LONG_GAP_TICKS, UNCONFIRMED, cells_to_use, confirmed, pole_of
from sim.bench.modal_broken import BREAKS, broken, misleads
from sim.bench.modal_records import AMBIENT, flight, moving, published, stationary

FloatArray = NDArray[np.float64]
RECORDS = Path(__file__).parents[2] / "shared" / "data" / "records"
RATE_HZ = 15.0
HZ, DAMPING = np.array([0.7146, 4.427, 5.806]), np.array([0.006, 0.008, 0.009])
OMEGA = 2.0 * np.pi * HZ
POLES = list(-DAMPING * OMEGA + 1j * OMEGA * np.sqrt(1.0 - DAMPING**2))
AMPLITUDE_MM = np.array([20.0, 2.0, 3.0])
CHANNELS = 30


def motion(time_s: FloatArray, kick_s: float, kick_mm: float, seed: int) -> FloatArray:
    """Three modes in CHANNELS channels (T, M); velocities change at kick_s as by a blow of so many mm of each mode."""
    draw = np.random.default_rng(seed)
    shapes = draw.standard_normal((3, CHANNELS))
    phase = draw.uniform(0.0, 2.0 * np.pi, 3)
    waves = AMPLITUDE_MM * np.real(np.exp(np.outer(time_s, POLES) + 1j * phase))
    after = np.maximum(time_s - kick_s, 0.0)
    waves += kick_mm * AMPLITUDE_MM / 20.0 * np.imag(np.exp(np.outer(after, POLES)))
    return waves @ shapes + 0.02 * draw.standard_normal((len(time_s), CHANNELS))


@pytest.mark.requirement("WB-MOD-06")
@settings(max_examples=25, deadline=None)
@given(at=st.integers(40, 85), size=st.sampled_from([1.0, 5.0, 20.0]), seed=st.integers(0, 1000))
def test_a_kick_is_found_at_its_sample(at: int, size: float, seed: int) -> None:
    time_s = np.arange(90) / RATE_HZ
    start = last_break(time_s, motion(time_s, time_s[at] - 1e-6, size, seed), POLES)
    assert at <= start <= at + (1 if size > 1.0 else 4)  # a small kick shows as it grows


@pytest.mark.requirement("WB-MOD-06")
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), drop=st.floats(0.0, 0.2))
def test_a_free_motion_with_lost_frames_and_cells_has_no_break(seed: int, drop: float) -> None:
    draw = np.random.default_rng(seed)
    time_s = np.arange(120) / RATE_HZ + draw.uniform(-0.002, 0.002, 120)
    y = motion(time_s, 1e9, 0.0, seed)
    y[draw.random(y.shape) < 0.005] = np.nan
    kept = draw.random(120) >= drop
    assert last_break(time_s[kept], y[kept], POLES) == 0


@pytest.mark.requirement("WB-MOD-06")
def test_of_two_breaks_the_newest_counts_and_a_jump_of_all_points_is_one() -> None:
    time_s = np.arange(120) / RATE_HZ
    y = motion(time_s, time_s[40] - 1e-6, 20.0, 5)
    y[75:] += 1.0
    assert last_break(time_s, y, POLES) == 75


@pytest.mark.requirement("WB-MOD-06")
def test_ambient_response_has_no_break() -> None:
    draw = np.random.default_rng(3)
    for _ in range(20):
        pushes = draw.standard_normal((3, 300)) + 1j * draw.standard_normal((3, 300))
        waves = [lfilter([1.0], [1.0, -np.exp(s / RATE_HZ)], w).real for s, w in zip(POLES, pushes, strict=True)]
        y = np.array(waves).T @ draw.standard_normal((3, CHANNELS)) + 0.1 * draw.standard_normal((300, CHANNELS))
        assert last_break(np.arange(300) / RATE_HZ, y, POLES) == 0


@pytest.mark.requirement("WB-MOD-03")
@pytest.mark.parametrize("seed", range(4))
def test_cells_that_were_hidden_for_seconds_leave_no_mark(seed: int) -> None:
    time_s = np.arange(270) / RATE_HZ
    y = motion(time_s, 1e9, 0.0, seed)
    hidden = np.random.default_rng(seed).permutation(CHANNELS)[: CHANNELS * 2 // 5]
    y[np.ix_(np.arange(130, 175), hidden)] = np.nan
    found = identify(time_s, y, "decay").modes
    assert [mode.valid for mode in found] == [True] * 3
    for mode, hz, damping in zip(found, HZ, DAMPING, strict=True):
        assert abs(mode.frequency_hz - hz) < max(5.0 * mode.frequency_sigma_hz, 1e-5 * hz)
        assert abs(mode.damping_ratio - damping) < max(5.0 * mode.damping_ratio_sigma, 1e-3 * damping)


@pytest.mark.requirement("WB-MOD-07")
def test_a_mode_is_confirmed_by_one_that_was_found_before() -> None:
    time_s = np.arange(200) / RATE_HZ
    modes = identify(time_s, motion(time_s, 1e9, 0.0, 8), "decay").modes
    assert all(mode.flags == [UNCONFIRMED] and not mode.valid for mode in confirmed(modes, modes[:0]))
    assert confirmed(modes, modes) == modes
    once = confirmed(modes, modes[:1])
    assert [mode.valid for mode in once] == [True, False, False]
    assert confirmed(modes, once) == modes, "what was flagged for nothing but this confirms as well"
    for mode, pole in zip(modes, POLES, strict=True):
        assert abs(pole_of(mode) - pole) < 1e-3 * abs(pole)


@pytest.mark.requirement("WB-MOD-03")
def test_cells_hidden_for_long_are_left_out_while_enough_were_not() -> None:
    measured = np.ones((200, 10), bool)
    measured[50:66, 6:] = False  # 16 ticks: long, though seen in 92 % of all
    measured[100:115, 0] = False
    measured[::2, 1] = False  # seen in half
    assert cells_to_use(measured).tolist() == [0, 2, 3, 4, 5]
    measured[50:66, 3:] = False  # only two of nine are whole
    assert cells_to_use(measured).tolist() == [0, 2, 3, 4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize("hidden_from", [0, 20, 84])
def test_a_cell_is_left_out_for_its_longest_gap_wherever_it_is(hidden_from: int) -> None:
    measured = np.ones((100, 8), np.bool_)
    measured[hidden_from : hidden_from + LONG_GAP_TICKS, 1] = False
    measured[hidden_from : hidden_from + LONG_GAP_TICKS + 1, 2] = False
    measured[::10, 3] = False
    assert cells_to_use(measured).tolist() == [0, 1, 3, 4, 5, 6, 7]


# Seeds of records of which most mislead when they are not cut; of stopped decays and responses that are struck or jump
# hardly any does.
DECAYS = {"struck": (4, 9, 10), "stopped": (0, 1, 2), "held": (0, 12, 14), "jump": (0, 1, 15)}
RESPONSES = {"struck": (0,), "stopped": (2,), "held": (4, 13), "jump": (0,)}


@pytest.mark.requirement("WB-MOD-10")
@pytest.mark.parametrize("kind", BREAKS)
def test_a_decay_that_breaks_is_cut_and_gives_modes_that_are_right(kind: str) -> None:
    all_valid = 0
    for seed in DECAYS[kind]:
        record = broken(kind, "decay", seed)
        found = identify(record.time_s, record.y)
        assert not misleads(record.frequency_hz, found), seed
        if "cut_at_break" in found.flags:
            begin_s, end_s = found.record.begin_s, found.record.begin_s + found.record.duration_s
            assert end_s < record.break_s or begin_s >= record.break_s - 0.05
            all_valid += len(found.valid_modes) == len(record.frequency_hz)
    assert all_valid >= 2


@pytest.mark.requirement("WB-MOD-10")
def test_a_record_that_is_said_to_be_whole_is_not_cut() -> None:
    record = broken("struck", "decay", 4)
    found = identify(record.time_s, record.y, whole=True)
    assert "cut_at_break" not in found.flags and found.record.samples == len(record.time_s)


@pytest.mark.requirement("WB-MOD-10")
def test_a_record_that_may_be_cut_is_not_used_up() -> None:
    record = broken("struck", "decay", 4)
    y = record.y.copy()
    cut, kept = (identify(record.time_s, y, overwrite=overwrite) for overwrite in (True, False))
    assert np.array_equal(y, record.y) and "cut_at_break" in cut.flags
    assert [m.frequency_hz for m in cut.modes] == [m.frequency_hz for m in kept.modes]


@pytest.mark.requirement("WB-MOD-10")
@pytest.mark.parametrize("kind", BREAKS)
def test_a_response_to_noise_that_breaks_does_not_mislead(kind: str) -> None:
    for seed in RESPONSES[kind]:
        record = broken(kind, "ambient", seed)
        assert not misleads(record.frequency_hz, identify(record.time_s, record.y)), seed


@pytest.mark.requirement("WB-MOD-10")
def test_records_that_do_not_break_are_not_cut() -> None:
    draw = np.random.default_rng(1)
    records = [
        (r.time_s, r.noisy)
        for case in ("D1", "D2", "D3", "D4")
        for change in (
            lambda t: t,
            lambda t: t[draw.random(len(t)) > 0.1],
            lambda t: t + draw.uniform(0.0, 0.02, len(t)),
        )
        for r in (published(case, 5, change),)
    ]
    records += [(r.time_s, r.y) for seed in range(6) for r in (broken("none", ("decay", "ambient")[seed % 2], seed),)]
    records += [flight(450, 1), flight(450, 2, echo=6e-3), moving("A1", 1, -0.03)]
    if RECORDS.is_dir():
        records += [
            (c.time_s, c.y) for c in (read_channels(RECORDS / f"{name}.npz") for name in ("slab", "shear_frame"))
        ]
    for time_s, y in records:
        assert telling_piece(predict(principal_coordinates(time_s, y, Options().coordinates))) is None


def test_a_record_is_predicted_once_and_only_where_it_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    predicted: list[object] = []

    def counted(coordinates: Coordinates) -> Predicted | None:
        predicted.append(coordinates)
        return predict(coordinates)

    monkeypatch.setattr(pipeline, "predict", counted)
    modes, _, rate_hz, points, noise_mm = AMBIENT["A1"]
    record = stationary(modes, 60.0, rate_hz, points, noise_mm, 4)
    assert identify(*record, after_break=True).valid_modes and len(predicted) == 1
    assert identify(*record, whole=True, after_break=True).valid_modes and len(predicted) == 2
    assert identify(*record, whole=True).valid_modes and len(predicted) == 2
    noise = np.random.default_rng(4).standard_normal((600, 8))
    assert not identify(np.arange(600) / RATE_HZ, noise, whole=True, after_break=True).valid_modes
    assert len(predicted) == 2, "where nothing is believed, nothing is asked"


@pytest.mark.requirement("WB-MOD-10")
def test_of_two_blows_the_piece_that_tells_most_is_used() -> None:
    time_s = np.arange(900) / RATE_HZ
    y = motion(time_s, 10.0, 20.0, 4) + motion(time_s, 50.0, 20.0, 4)
    found = identify(time_s, y)
    assert "cut_at_break" in found.flags and len(found.valid_modes) == 3
    assert 9.9 < found.record.begin_s < 12.0 and 36.0 < found.record.duration_s < 40.1
    for mode, hz in zip(found.valid_modes, HZ, strict=True):
        assert abs(mode.frequency_hz - hz) < max(4.0 * mode.frequency_sigma_hz, 5e-4 * hz)
