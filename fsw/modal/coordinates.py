"""From many channels with gaps to a few principal coordinates, on true time stamps or on an even grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

from fsw.modal.channels import Channels, Scaled, chosen
from fsw.modal.gaps import Filled, filled, samples_of
from fsw.modal.subspace import Subspace, leading_singular, orthonormal

FloatArray = NDArray[np.float64]

# Directions in each round of filling gaps: the strong ones first, for weak ones would learn the guess's errors.
_FILLING = (1, 2, 4, 8)
# A channel counts if this share of its samples is there, and a tick if this share of the channels is.
_LEAST_SHARE = 0.5
# Half-band filter of the octaves: flat to 0.2 of the rate, silent above 0.3.
_HALF_BAND = np.sinc(0.5 * np.arange(-16, 17)) * np.kaiser(33, 6.0)
_HALF_BAND /= _HALF_BAND.sum()
# A level of fewer samples is not halved again.
_LEAST_SAMPLES = 400


@dataclass(frozen=True)
class Coordinates:
    """A record in principal coordinates.

    time_s (T,) true stamps from 0; signals (T, p); basis (L, p): channels[:, live] - mean = signals basis^T
    + noise; channels (T, L): the live channels without their mean, gaps filled; live (M,) bool; kept (T_in,)
    bool; rate_hz: the nominal rate; subspace: for the next record to begin with.
    """

    time_s: FloatArray
    signals: FloatArray
    basis: FloatArray
    channels: Channels
    live: NDArray[np.bool_]
    kept: NDArray[np.bool_]
    rate_hz: float
    subspace: Subspace | None = None


@dataclass(frozen=True)
class Level:
    """Evenly sampled signals (T, p) at one octave's rate, and the band of frequencies to look for there."""

    signals: FloatArray
    rate_hz: float
    band_hz: tuple[float, float]


def nominal_rate_hz(time_s: FloatArray) -> float:
    """Rate of the grid under stamps that may have gaps and jitter: the mean step over steps of one period."""
    steps = np.diff(time_s)
    typical = float(np.median(steps))
    whole = float(np.sum(np.maximum(np.rint(steps / typical), 1.0)))
    return whole / float(time_s[-1] - time_s[0])


def principal_coordinates(
    time_s: FloatArray, y: Channels, count: int, overwrite: bool = False, known: Subspace | None = None
) -> Coordinates:
    """Leading principal coordinates of a record, each channel scaled by its own noise.

    time_s (T,) increasing; y (T, M), NaN = missing; count: most coordinates; overwrite: y (contiguous) may be used up,
    which saves a copy. A channel or tick that is mostly missing is left out; what is missing elsewhere is filled from
    the other channels through the coordinates themselves. known: of a record that overlaps with this one.
    """
    samples = samples_of(y)
    live = (samples.of_channel > _LEAST_SHARE * len(y)) & samples.moves
    width = int(live.sum())
    there = samples.of_tick - np.count_nonzero(~np.isnan(y[:, ~live]), axis=1)
    complete = (there == width) & (width > 0)
    # With few channels nothing can be filled from neighbours: true stamps make it cheap to leave such ticks
    # out.
    kept = complete if width <= count and complete.mean() > 0.7 else there > _LEAST_SHARE * width
    stamps, y = time_s[kept], chosen(y, kept, live, overwrite)
    if y.size == 0 or len(stamps) < 2:
        none = np.zeros((len(stamps), 0))
        return Coordinates(stamps, none, none[:0], none, live & False, kept, 0.0)
    stamps = stamps - stamps[0]
    record = filled(stamps, y)
    if y.shape[1] <= count:
        scale = y.std(axis=0, dtype=np.float64)
        signals, basis, subspace = y / scale, np.diag(scale), None
    else:
        known = known.of(live) if known is not None and known.live[live].all() else None
        signals, V, scale = _project(record, count, known)
        basis, subspace = V * scale[:, None], Subspace(live, V, scale)
    return Coordinates(stamps, signals, basis, y, live, kept, nominal_rate_hz(stamps), subspace)


def _project(record: Filled, count: int, known: Subspace | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Signals (T, p), directions (L, p) and scale (L,) by principal components of channels of equal noise.

    Fills the gaps of the record. Passes over all channels are what costs: each round makes two, and the one that tells
    the noise begins the next round's iteration. What is known begins the first one's, and no more: directions may
    follow the guesses of the record that they come from, and a gap told through such a one keeps its guess for long.
    """
    y = record.y
    overall = max(float(np.sqrt(np.mean(record.energy) / len(y))), 1e-300)
    start, scale = (None, np.full(y.shape[1], overall)) if known is None else (known.start(count), known.scale)
    ranks = [*(rank for rank in _FILLING if rank < count and len(record.gaps)), count]
    for rank in ranks:
        left, signals, V = _fitted(record, scale, rank, count, start)
        # Left vectors of the signals first, and the others for what they do not tell.
        Q = orthonormal(np.hstack([signals, left[:, rank:]]))
        start = Scaled(y, scale).transposed_times(Q)
        seen = np.ascontiguousarray(start[:, :rank])
        record.through_channels(scale, seen, np.ascontiguousarray(Q[:, :rank]))
        start[:, :rank] = seen
        square = np.maximum(record.energy - scale**2 * np.sum(seen**2, axis=1), 0.0)
        # A channel of which a direction is made leaves nothing, and would be taken for the best: what is left is so
        # much of its noise as the directions do not take.
        noise = np.sqrt(square / record.samples / np.maximum(1.0 - np.sum(V**2, axis=1), 1e-6))
        # No channel may claim to be much better than the others: the fit would chase it.
        before, scale = scale, np.maximum(noise, max(0.3 * float(np.median(noise)), 1e-12 * overall))
        start *= (before / scale)[:, None]
    _, signals, V = _fitted(record, scale, count, count, start)
    return signals, V, scale


def _fitted(
    record: Filled, scale: FloatArray, rank: int, count: int, start: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left singular vectors (T, k), of them rank signals (T, rank), and directions (L, rank); fills the gaps."""
    U, s, Vt = leading_singular(Scaled(record.y, scale), count, start)
    signals, V = (np.ascontiguousarray(part) for part in (U[:, :rank] * s[:rank], Vt[:rank].T))
    record.through(scale, signals, V)
    return U, signals, V


def even_grid(stamps: FloatArray, signals: FloatArray, rate_hz: float) -> FloatArray:
    """Signals (N, p) on the even grid of the rate, by Akima's interpolation, which hardly overshoots."""
    count = round(float(stamps[-1] - stamps[0]) * rate_hz) + 1
    grid = stamps[0] + np.arange(count) / rate_hz
    if count == len(stamps) and float(np.max(np.abs(grid - stamps))) < 1e-3 / rate_hz:
        return signals
    inside = np.clip(grid, stamps[0], stamps[-1])
    return Akima1DInterpolator(stamps, signals, axis=0, method="makima")(inside)


def octaves(signals: FloatArray, rate_hz: float) -> list[Level]:
    """The record at its rate and at halved rates, each with the octave of frequencies that it resolves best.

    The filter drops its ends instead of padding them: a finite filter leaves the poles of a free decay where
    they are.
    """
    levels = []
    top = 0.5 * rate_hz
    while len(signals) >= _LEAST_SAMPLES:
        levels.append(Level(signals, rate_hz, (0.14 * rate_hz, top)))
        # Bands overlap, so that a mode whose poles scatter about an edge is whole in one of them.
        top = 0.17 * rate_hz
        signals = np.lib.stride_tricks.sliding_window_view(signals, len(_HALF_BAND), axis=0)[::2] @ _HALF_BAND
        rate_hz = 0.5 * rate_hz
    return [*levels, Level(signals, rate_hz, (0.0, top))]
