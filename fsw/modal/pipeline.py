"""Modal identification of recorded channels: one function from samples to modes with intervals and validity."""

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fsw.modal.autoregression import predict
from fsw.modal.channels import Channels, amplitude_spectrum
from fsw.modal.clustering import Pole
from fsw.modal.coordinates import Coordinates, principal_coordinates
from fsw.modal.correlation import fixed_window, spectral
from fsw.modal.decay import LEAST_SAMPLES
from fsw.modal.forced import identify_forced
from fsw.modal.free_modes import identify_decay
from fsw.modal.gates import PAIR_DEVIATIONS, PAIR_RESOLUTIONS
from fsw.modal.kind import may_fall_freely, random_may_fall
from fsw.modal.paper import identify_as_paper
from fsw.modal.pieces import telling_piece
from fsw.modal.realisation import frequency_and_damping
from fsw.modal.result import Diagram, Kind, ModalResult, Mode, Options, Record
from fsw.modal.stationary_force import is_steady
from fsw.modal.stationary_modes import identify_ambient
from fsw.modal.subspace import Subspace
from wingbeat.errors import InputError

FloatArray = NDArray[np.float64]

# Flags of a mode that the noise may have made.
_UNSEEN = {"weak", "incoherent", "imprecise"}
# The noise's covariance between the coordinates is estimated from the record: so many samples for each of them.
_SAMPLES_OF_A_COORDINATE = 8
# Longest piece, and most channels, that the spectrum for the report is made of.
_SPECTRUM_SAMPLES, _SPECTRUM_CHANNELS = 4096, 128


def identify(
    time_s: FloatArray,
    y: Channels,
    kind: Literal["auto", "decay", "ambient"] = "auto",
    options: Options | None = None,
    u: FloatArray | None = None,
    overwrite: bool = False,
    known: Subspace | None = None,
    whole: bool = False,
    after_break: bool = False,
) -> ModalResult:
    """Modes of a record of vibration, each with its interval, its indicators and whether to believe it.

    time_s (T,) in s, increasing, gaps and jitter allowed; y (T, M) in any unit, NaN = missing. kind: a free decay, the
    stationary response to unknown noise, or decided from the data. u (T, inputs): inputs that were measured, such as
    wheel torque; the modes are then those of the plant alone. whole: the record does not break, or its breaks were
    found by what was known before. Else, and without u, a record that breaks is cut: the modes, its extent and the flag
    cut_at_break are those of the piece that tells most. after_break: the motion broke where the record begins, or
    before; what shook the wing then may shake it still, so a stationary response is believed only if its force is
    steady noise. overwrite: y (contiguous) may be used up, which saves memory; what may be cut is kept. y in single
    precision stays so. known: what an identification of a record that overlaps with this one gave, which saves time.
    Deterministic. Raises InputError for arrays that do not fit.
    Source: section 5 of the paper (Eq. 31-41), refined by maximum likelihood.
    """
    settings = options or Options()
    time_s, y = _checked(time_s, y)
    most = max(min(settings.coordinates, len(time_s) // _SAMPLES_OF_A_COORDINATE), 1)
    may_be_cut = u is None and not whole
    coordinates = principal_coordinates(time_s, y, most, overwrite and not may_be_cut, known)
    predicted = predict(coordinates) if may_be_cut else None
    piece = telling_piece(predicted)
    if piece is not None:
        first = int(np.argmax(coordinates.kept))
        begin, end = np.searchsorted(time_s, time_s[first] + piece)
        cut = identify(time_s[begin:end], y[begin:end], kind, settings, after_break=after_break or bool(begin > first))
        begin_s = float(time_s[begin] - time_s[0]) + cut.record.begin_s
        return replace(cut, flags=sorted({*cut.flags, "cut_at_break"}), record=replace(cut.record, begin_s=begin_s))
    count = len(coordinates.time_s)
    if count < LEAST_SAMPLES or coordinates.signals.shape[1] == 0:
        extent = float(time_s[-1] - time_s[0])
        record = Record(extent, count, coordinates.rate_hz)
        flags = ["not_observable"] + (["short_record"] if count < LEAST_SAMPLES else [])
        return ModalResult([], flags, record, "ambient" if kind == "ambient" else "decay")
    modes: list[Mode] = []
    poles: list[Pole] = []
    decided: Kind = "ambient"
    is_decay = falls = False
    if u is not None:
        free, _, _ = identify_decay(coordinates, fixed_window, settings, surely=True)
        modes, poles = identify_forced(coordinates, _inputs(u, coordinates), free, settings)
        decided = "decay"
    elif settings.method != "refined":
        modes, poles = identify_as_paper(coordinates, settings)
        decided = "decay" if kind == "decay" else "ambient"
    elif kind == "decay" or may_fall_freely(coordinates, settings):
        correlation = spectral if settings.correlation == "spectral" else fixed_window
        modes, poles, is_decay = identify_decay(coordinates, correlation, settings, surely=kind == "decay")
        falls = is_decay and any(mode.valid for mode in modes)
        sure = falls or (is_decay and not random_may_fall(modes, coordinates))
        decided = "decay" if kind == "decay" or (kind == "auto" and sure) else "ambient"
    if decided == "ambient" and settings.method == "refined" and u is None:
        correlation = fixed_window if settings.correlation == "fixed_window" else spectral
        driven, of_driven = identify_ambient(coordinates, correlation, settings)
        if kind == "auto" and is_decay and not any(mode.valid for mode in driven):
            decided = "decay"  # of which the one is no better than the other
        else:
            modes, poles = driven, of_driven
        # Whatever the caller said, a stationary response does not fall; and what the blows of a loose panel feign is
        # another frequency each time.
        doubted = after_break and decided == "ambient" and any(mode.valid for mode in modes)
        if falls or (doubted and not is_steady(predicted or predict(coordinates))):
            modes = [mode.flagged("not_exponential") for mode in modes]
    modes = _pairs_flagged(sorted(modes, key=lambda mode: mode.frequency_hz))
    record = Record(float(coordinates.time_s[-1]), count, coordinates.rate_hz)
    flags, diagram = _record_flags(modes, record.duration_s), _diagram(coordinates, poles)
    return ModalResult(modes, flags, record, decided, diagram, coordinates.subspace)


def _checked(time_s: FloatArray, y: Channels) -> tuple[FloatArray, Channels]:
    time_s = np.asarray(time_s, dtype=np.float64)
    y = np.asarray(y)
    y = y if y.dtype == np.float32 else np.asarray(y, dtype=np.float64)
    y = y[:, None] if y.ndim == 1 else y
    if time_s.ndim != 1 or y.ndim != 2 or len(time_s) != len(y):
        raise InputError(f"time_s {time_s.shape} and y {y.shape} do not fit", "y", "give one row of y for each time")
    if len(time_s) < 2 or y.shape[1] == 0:
        raise InputError("there are no samples", "y", "record at least a few seconds")
    if not np.all(np.isfinite(time_s)) or not np.all(np.diff(time_s) > 0.0):
        raise InputError("time does not increase from sample to sample", "time_s", "sort the samples by time")
    return time_s, np.where(np.isinf(y), np.nan, y) if np.isinf(y).any() else y


def _inputs(u: FloatArray, coordinates: Coordinates) -> FloatArray:
    """Measured inputs (T, inputs) at the stamps that were kept. Raises InputError where they do not fit."""
    u = np.asarray(u, dtype=np.float64)
    u = u[:, None] if u.ndim == 1 else u
    if u.ndim != 2 or len(u) != len(coordinates.kept) or not np.all(np.isfinite(u)):
        raise InputError(f"u {u.shape} does not fit, or has gaps", "u", "give each input a number at every time")
    return u[coordinates.kept]


def _pairs_flagged(modes: list[Mode]) -> list[Mode]:
    """Modes in order of frequency; those that cannot be told from their neighbour by frequency are flagged."""
    for j, (a, b) in enumerate(pairwise(modes)):
        sigma_hz = float(np.hypot(a.frequency_sigma_hz, b.frequency_sigma_hz))
        if a.valid and b.valid and b.frequency_hz - a.frequency_hz < PAIR_DEVIATIONS * sigma_hz:
            modes[j], modes[j + 1] = a.flagged("close_pair"), b.flagged("close_pair")
    return modes


def _record_flags(modes: list[Mode], duration_s: float) -> list[str]:
    """What holds for the record: nothing seen above the noise, or a flag of a mode that matters."""
    seen = [mode for mode in modes if _UNSEEN.isdisjoint(mode.flags)]
    largest = max((mode.amplitude for mode in modes if mode.amplitude > 0.0), default=0.0)
    flags = [] if seen else ["not_observable"]
    valid = [mode.frequency_hz for mode in modes if mode.valid or "close_pair" in mode.flags]
    if any(b - a < PAIR_RESOLUTIONS / duration_s for a, b in pairwise(valid)):
        flags.append("close_pair")
    for flag in ("time_varying", "short_record", "harmonic", "near_nyquist"):
        if any(
            flag in mode.flags and "incoherent" not in mode.flags and not mode.amplitude <= 0.02 * largest
            for mode in modes
        ):
            flags.append(flag)
    return flags


def _diagram(coordinates: Coordinates, poles: list[Pole]) -> Diagram:
    """Stabilisation diagram and root mean square spectrum over the channels, as amplitudes in the channels' unit.

    Of many channels some, evenly chosen, must do.
    """
    width = coordinates.channels.shape[1]
    some = np.linspace(0, width - 1, min(width, _SPECTRUM_CHANNELS)).astype(np.int64)
    pieces = coordinates.channels[:_SPECTRUM_SAMPLES, some]
    frequency_hz, damping = frequency_and_damping(np.array([p.s for p in poles], np.complex128))
    return Diagram(
        order=np.array([p.order for p in poles], np.int64),
        frequency_hz=frequency_hz,
        damping_ratio=damping,
        stable=np.array([p.stable for p in poles], np.bool_),
        spectrum_hz=np.asarray(np.fft.rfftfreq(len(pieces), 1.0 / coordinates.rate_hz), np.float64),
        spectrum=amplitude_spectrum(pieces),
    )
