"""What flying asks of the identification: single precision, little memory, nothing lost by either."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.modal.channels import Scaled, amplitude_spectrum, chosen
from fsw.modal.coordinates import principal_coordinates
from fsw.modal.gaps import filled
from fsw.modal.pipeline import identify
from fsw.modal.subspace import Subspace
from sim.bench.modal_on_board import kept
from sim.bench.modal_records import ON_BOARD, flight, free_decay


def _on_board(seconds, seed):
    modes, rate_hz, points, noise_mm = ON_BOARD
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    return time_s, free_decay(modes, time_s, points, noise_mm, seed, axes=slice(0, 3)).noisy


@pytest.mark.requirement("WB-MOD-09")
@pytest.mark.parametrize("record", [_on_board(6.0, 1), flight(300, 1, noise_mm=0.004)], ids=["918 channels", "quiet"])
def test_single_precision_moves_nothing_by_more_than_a_hundredth_of_its_sigma(record):
    time_s, y = record
    double, single = identify(time_s, y), identify(time_s, y.astype(np.float32))
    assert double.valid_modes and [m.flags for m in double.modes] == [m.flags for m in single.modes]
    for a, b in zip(double.valid_modes, single.valid_modes, strict=True):
        assert abs(a.frequency_hz - b.frequency_hz) < 0.01 * a.frequency_sigma_hz
        assert abs(a.damping_ratio - b.damping_ratio) < 0.01 * a.damping_ratio_sigma


def test_using_up_the_record_changes_nothing_but_the_record():
    time_s, y = flight(200, 3)
    y[50:60] = np.nan  # ticks and a channel that are left out
    y[:, 7] = np.nan
    before = y.copy()
    plain = identify(time_s, y)
    assert np.array_equal(y, before, equal_nan=True)
    used = identify(time_s, y, overwrite=True, whole=True)
    assert not np.array_equal(y, before, equal_nan=True)
    for a, b in zip(plain.modes, used.modes, strict=True):
        assert (a.frequency_hz, a.damping_ratio, a.flags) == (b.frequency_hz, b.damping_ratio, b.flags)
        assert np.array_equal(a.shape, b.shape, equal_nan=True)


@pytest.mark.requirement("WB-MOD-09")
@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_all_that_history_and_identification_hold_is_less_than_five_megabytes(missing):
    row = kept(1, missing)
    assert row["state_mb"] < 5.0 and row["push_cpu_ms"] < 0.1


@settings(deadline=None)
@given(st.integers(1, 90), st.integers(1, 40), st.integers(0, 100))
def test_rows_and_columns_chosen_in_place_are_those_of_a_copy(ticks, width, seed):
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((ticks, width)).astype(np.float32)
    rows, columns = rng.uniform(size=ticks) < 0.7, rng.uniform(size=width) < 0.7
    expected = y[np.ix_(rows, columns)]
    assert np.array_equal(chosen(y, rows, columns), expected)
    packed = chosen(y, rows, columns, overwrite=True)
    assert np.array_equal(packed, expected) and np.shares_memory(packed, y) == (packed.size > 0)


@given(st.integers(1, 90), st.integers(1, 70), st.integers(0, 100))
def test_products_by_blocks_are_those_of_the_whole(ticks, width, seed):
    rng = np.random.default_rng(seed)
    y, scale = rng.standard_normal((ticks, width)), rng.uniform(0.5, 2.0, width)
    V, Q = rng.standard_normal((width, 3)), rng.standard_normal((ticks, 3))
    scaled = Scaled(y, scale)
    assert np.allclose(scaled.times(V), y / scale @ V) and np.allclose(scaled.transposed_times(Q), (y / scale).T @ Q)
    assert np.allclose(scaled.dense(), y / scale)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_spectrum_shows_a_sine_at_its_amplitude(kind):
    t = np.arange(400) / 20.0
    y = 3.0 * np.sin(2.0 * np.pi * 2.0 * t)[:, None] * np.ones(70)
    spectrum = amplitude_spectrum(y.astype(kind))
    assert spectrum[40] == pytest.approx(3.0, rel=1e-3) and spectrum[45:].max() < 1e-3


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_gaps_are_filled_by_least_squares_on_what_is_there(kind):
    rng = np.random.default_rng(2)
    ticks, width, rank = 30, 50, 3
    V, _ = np.linalg.qr(rng.standard_normal((width, rank)))
    scale, a = 1e-4 * rng.uniform(0.5, 2.0, width), 1e4 * rng.standard_normal((ticks, rank))
    true = a @ V.T * scale
    present = rng.uniform(size=true.shape) < 0.8
    present[3] = False  # a tick that tells nothing
    y = np.where(present, true, np.nan).astype(kind)
    record = filled(np.arange(30.0), y)
    assert record.y is y and not np.isnan(y).any()
    for _ in range(6):  # each round leaves a small share of what the means were off by
        record.through(scale, signals := y / scale @ V, V)
    rest = np.arange(ticks) != 3
    off = y[rest] - true[rest]
    off -= off.mean(axis=0)  # what a constant takes, the mean takes
    assert np.abs(off).max() < (1e-5 if kind is np.float32 else 1e-6)
    assert np.allclose(signals, y / scale @ V, atol=0.05)
    assert np.array_equal(record.samples, present.sum(axis=0))
    y = y.astype(np.float64)
    assert np.allclose(record.total, y.sum(axis=0)) and np.allclose(record.energy, np.sum(y**2, axis=0))


def test_the_first_guess_of_a_gap_is_linear_in_time_and_constant_at_the_ends():
    stamps = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    y = np.array([[np.nan, 1.0], [3.0, np.nan], [np.nan, np.nan], [9.0, 5.0], [np.nan, 5.0]])
    expected = np.array([[3.0, 1.0], [3.0, 2.0], [5.0, 3.0], [9.0, 5.0], [9.0, 5.0]])
    assert np.allclose(filled(stamps, y).y, expected - expected.mean(axis=0))


def _slid(record, seconds, known=None):
    """Results of a record's pieces of 6 s, a second apart, each begun with what the one before knew."""
    time_s, y = record
    rate_hz = ON_BOARD[1]
    results = []
    for k in range(seconds):
        piece = slice(round(k * rate_hz), round(k * rate_hz) + round(6.0 * rate_hz))
        results.append(identify(time_s[: piece.stop - piece.start], y[piece].astype(np.float32), known=known))
        known = results[-1].subspace
    return results


@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_what_is_known_of_the_record_before_changes_the_result_by_less_than_its_sigma(missing):
    time_s, y = _on_board(10.0, 3)
    y[np.random.default_rng(3).uniform(size=y.shape) < missing] = np.nan
    for warm, k in zip(_slid((time_s, y), 4), range(4), strict=True):
        cold = identify(time_s[:276], y[round(k * 46.0) :][:276].astype(np.float32))
        assert len(cold.valid_modes) == 4
        for a, b in zip(warm.valid_modes, cold.valid_modes, strict=True):
            assert abs(a.frequency_hz - b.frequency_hz) < 0.5 * b.frequency_sigma_hz
            assert a.frequency_sigma_hz == pytest.approx(b.frequency_sigma_hz, rel=0.1)
            assert a.amplitude == pytest.approx(b.amplitude, rel=0.05)


@pytest.mark.parametrize(("seed", "noise_mm"), [(2, 3e-4), (4, 1e-4)])
def test_begun_with_what_was_known_a_record_that_grows_has_no_other_modes_though_noise_is_little(seed, noise_mm):
    """What the gaps' guesses are off by must not be left in the directions, where it would look like modes; nor may
    one channel be told by a direction of its own, for its gaps would then be told by nothing.
    """
    time_s, y = flight(300, seed, noise_mm=noise_mm, echo=0.0)
    known = None
    for ticks in range(30, 301, 10):
        piece = (y[:ticks] - np.nanmean(y[:ticks], axis=0)).astype(np.float32)
        result = identify(time_s[:ticks], piece, overwrite=True, whole=True, known=known)
        known = result.subspace
        assert all(min(abs(m.frequency_hz - hz) for hz in (0.7146, 2.31, 4.37)) < 0.02 for m in result.modes)


def test_a_mode_that_nothing_known_tells_of_is_found_in_the_first_record_that_has_it():
    modes, rate_hz, points, noise_mm = ON_BOARD
    time_s = np.arange(round(6.0 * rate_hz)) / rate_hz
    two = {name: modes[name] for name in ("B1", "IP")}
    known = identify(time_s, free_decay(two, time_s, points, noise_mm, 4, axes=slice(0, 3)).noisy).subspace
    found = identify(time_s, free_decay(modes, time_s, points, noise_mm, 5, axes=slice(0, 3)).noisy, known=known)
    assert [m.frequency_hz for m in found.valid_modes] == pytest.approx(list(modes.values()), rel=2e-3)


def test_of_fewer_channels_the_known_is_used_and_of_others_it_is_not():
    time_s, y = _on_board(6.0, 6)
    known = identify(time_s, y).subspace
    fewer = np.arange(y.shape[1]) % 7 > 0
    part = known.of(fewer)
    assert np.allclose(part.directions.T @ part.directions, np.eye(12)) and part.live.shape == (fewer.sum(),)
    assert np.array_equal(part.among(fewer).live, fewer)
    same = identify(time_s, y[:, fewer], known=part)
    assert [m.frequency_hz for m in same.valid_modes] == pytest.approx(list(ON_BOARD[0].values()), rel=2e-3)
    stranger = known.of(fewer).among(fewer)  # does not know the rest
    alone, begun = identify(time_s, y), identify(time_s, y, known=stranger)
    assert [m.frequency_hz for m in alone.modes] == [m.frequency_hz for m in begun.modes]


def _with_patches(seed, noise):
    """Ten seconds of three modes in 600 channels, a patch of ten of them missing in step with the first mode."""
    rng = np.random.default_rng(seed)
    time_s, place = np.arange(150) / 15.0, np.linspace(0.0, np.pi, 600)
    clean = sum(
        a * np.outer(np.cos(2.0 * np.pi * f * time_s + rng.uniform(0.0, 6.0)), np.cos((i + 1) * place))
        for i, (a, f) in enumerate(((10.0, 0.715), (1.0, 2.31), (1.0, 4.37)))
    )
    gaps = rng.uniform(size=clean.shape) < 0.02
    for tick in (15, 36, 57, 78):
        gaps[tick : tick + 3, 100:110] = True
    noisy = clean + noise * rng.standard_normal(clean.shape)
    return time_s, clean - clean.mean(axis=0), np.where(gaps, np.nan, noisy), gaps


def _error_in_gaps(coordinates, clean, gaps):
    filled_in = coordinates.channels - coordinates.channels.mean(axis=0)
    return float(np.sqrt(np.mean((filled_in - clean)[gaps] ** 2)))


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_of_the_first_guess_stays_in_the_gaps_of_a_quiet_record(seed, noise):
    time_s, clean, y, gaps = _with_patches(seed, noise)
    assert _error_in_gaps(principal_coordinates(time_s, y, 12), clean, gaps) < 0.7 * noise


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_known_begins_a_record_with_gaps_and_leaves_no_guess_in_them(seed):
    """A direction that lies in the gaps, as one that followed a guess does, beside a first one that is off there."""
    noise = 1e-3
    time_s, clean, y, gaps = _with_patches(seed, noise)
    alone = principal_coordinates(time_s, y, 12)
    directions = alone.subspace.directions.copy()
    directions[100:110, 0] *= 0.9
    directions[:, 3] = 0.01 * directions[:, 3]
    directions[100:110, 3] += 1.0 / np.sqrt(10.0)
    known = Subspace(alone.subspace.live, np.linalg.qr(directions)[0], alone.subspace.scale)
    begun = principal_coordinates(time_s, y, 12, known=known)
    assert not np.array_equal(alone.signals, begun.signals)
    assert _error_in_gaps(begun, clean, gaps) < 0.7 * noise
