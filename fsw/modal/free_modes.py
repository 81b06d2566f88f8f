"""Modes of a free decay: the fit turned into frequencies, intervals, shapes and flags."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.beside import beside, noise_beside
from fsw.modal.candidates import Correlation
from fsw.modal.channels import Channels, transposed_times
from fsw.modal.clustering import Pole
from fsw.modal.coordinates import Coordinates
from fsw.modal.decay import Settled, find_decay, onset
from fsw.modal.gates import (
    EARLY_CYCLES,
    EARLY_SAMPLES,
    EARLY_SHARE,
    LEAST_DECAY,
    common_flags,
    decay_flags,
    departs,
    differs,
    varies,
    weak_flags,
)
from fsw.modal.kind import convincing
from fsw.modal.realisation import frequency_and_damping
from fsw.modal.refinement import Fit, refine
from fsw.modal.result import Mode, Options, normalised
from fsw.modal.uncertainty import (
    at_upper_end,
    departure,
    fit_coherence,
    frequency_change,
    modal_sigmas,
)
from fsw.modal.weighting import weighting_loss

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# What explains less than this share of the energy about its frequency is a patch on the fit, not a mode.
_NO_MODE = 0.5
# Deviations that the worst stretch of a decay exceeds by chance in one case of 22; how far what lasts as long as the
# mode pulls its pole.
_BY_CHANCE, _PULL = 2.5, 2.0
# Flags of a motion that is no sum of steady decays.
UNSTEADY = {"time_varying", "not_exponential"}


def identify_decay(
    coordinates: Coordinates, correlation: Correlation, options: Options, surely: bool = False
) -> tuple[list[Mode], list[Pole], bool]:
    """Modes of a free decay, poles for the stabilisation diagram, and whether it is a free decay at all.

    Of a record that is none there are no modes, unless it is surely one by what the caller knows.
    """
    start = onset(coordinates.time_s, coordinates.signals)
    time_s = coordinates.time_s[start:] - coordinates.time_s[start]
    signals = coordinates.signals[start:]
    decay, diagram = find_decay(time_s, signals, coordinates.rate_hz, correlation, options)
    fit = decay.fit
    count = len(fit.poles)
    frequency_hz, damping = frequency_and_damping(fit.poles)
    loss = weighting_loss(len(time_s) - len(fit.triangle), decay.coupled)
    departures = [departure(time_s, fit, j) for j in range(count)]
    coherence = np.array([fit_coherence(time_s, fit, j) for j in range(count)])
    shares = np.array([share for share, _ in departures])
    falling = np.array([total_decay(s, time_s) > LEAST_DECAY for s in fit.poles], np.bool_)
    is_decay = convincing(time_s, signals, coordinates.rate_hz, fit, coherence, shares, falling)
    if not (is_decay or surely):
        return [], diagram, False
    noise, moves = np.empty(count), np.zeros(count, np.bool_)
    chosen = np.flatnonzero(coherence > _NO_MODE)
    for j in range(count):
        around = beside(time_s, fit, j)
        noise[j] = around.noise
        moves[j] = j in chosen and varies(*frequency_change(time_s, fit, j, around), float(frequency_hz[j]))
    sigmas = at_upper_end(fit, modal_sigmas(fit.poles, fit.information, loss * noise), loss * noise)
    for j, found in enumerate(departures):
        sigmas[j] = widened(sigmas[j], *found, fit.poles[j], time_s)
    shapes = channel_shapes(fit.orthonormal, fit.triangle, coordinates.channels[start:], count)
    amplitude = np.max(np.abs(shapes), axis=1, initial=0.0)
    modes = []
    for j in map(int, chosen):
        flags = _flags(j, time_s, decay, frequency_hz, damping, sigmas, coherence, amplitude, coordinates.rate_hz)
        if moves[j]:
            flags.append("time_varying")
        if amplitude[j] < options.minimum_amplitude:
            flags.append("weak")
        if departs(*departures[j]):
            flags.append("not_exponential")
        steady = "time_varying" not in flags
        modes.append(
            Mode(
                frequency_hz=float(frequency_hz[j]),
                frequency_sigma_hz=float(sigmas[j, 0]),
                damping_ratio=float(damping[j]) if steady else np.nan,
                damping_ratio_sigma=float(sigmas[j, 1]) if steady else np.nan,
                amplitude=float(amplitude[j]),
                amplitude_coherence=decay.known[j].pole.coherence,
                singular_value=decay.known[j].pole.singular_value,
                shape=normalised(shapes[j], coordinates.live),
                valid=not flags,
                flags=sorted(set(flags)),
            )
        )
    modes = doubted(modes)
    if any(mode.valid for mode in modes):
        agrees = early_part_agrees(time_s, signals, fit, options.drift_degree)[chosen]
        pairs = zip(modes, agrees, strict=True)
        modes = doubted([mode if agree else mode.flagged("not_exponential") for mode, agree in pairs])
    return modes, diagram, is_decay


def doubted(modes: list[Mode]) -> list[Mode]:
    """The same modes; where the strongest is no steady decay, none is.

    A hinge that loosens or a wing that is struck changes all modes at once. A weak one that had died out before keeps
    its old frequency in the record, and nothing in its own fit tells that it holds no longer.
    """
    strongest = max(modes, key=lambda mode: mode.amplitude, default=None)
    if strongest is None or UNSTEADY.isdisjoint(strongest.flags):
        return modes
    return [mode.flagged("not_exponential") for mode in modes]


def early_part_agrees(time_s: FloatArray, signals: FloatArray, fit: Fit, drift_degree: int) -> NDArray[np.bool_]:
    """Whether each mode (m,) is the same in the first part of the record as in the whole of it.

    A wing that is stopped, struck or held inside the record has a fine decay before, and a compromise as a whole: the
    fit's own residual would only call it noisy. Modes that the first part is too short for are not judged.
    """
    agrees = np.ones(len(fit.poles), np.bool_)
    part = int(EARLY_SHARE * len(time_s))
    if part < EARLY_SAMPLES or part <= 2 * (2 * len(fit.poles) + drift_degree + 1):
        return agrees
    early = refine(time_s[:part], signals[:part], fit.poles, drift_degree)
    modal, whole = (np.stack(frequency_and_damping(poles), axis=1) for poles in (early.poles, fit.poles))
    off = np.abs(modal - whole)
    doubtful = differs(off, np.zeros_like(off), modal) & (modal[:, 0] * time_s[part - 1] >= EARLY_CYCLES)
    if doubtful.any():
        noise = np.ones(len(agrees))
        noise[doubtful] = noise_beside(time_s[:part], early, np.flatnonzero(doubtful).tolist())
        agrees = ~(doubtful & differs(off, modal_sigmas(early.poles, early.information, noise), modal))
    return agrees


def widened(sigmas: FloatArray, share: float, deviations: float, s: complex, time_s: FloatArray) -> FloatArray:
    """Deviations (2,) of frequency in Hz and damping of a mode with this departure, beyond what noise makes of it.

    Forces that go on driving the wing leave a mark at the mode's own frequency, where no noise is measured. What is
    left there is as slow as the mode: it pulls the pole by 2 a of its share of the amplitude (the fit's slope by s is
    t exp(-a t), less what the amplitude takes of it), or as much of 1 / T in a short record.
    """
    beyond = share * float(np.sqrt(max(1.0 - (_BY_CHANCE / max(deviations, 1e-12)) ** 2, 0.0)))
    off = _PULL * beyond / min(float(time_s[-1]), 1.0 / max(-s.real, 1e-12))
    return np.hypot(sigmas, [off / (2.0 * np.pi), off / abs(s)])


def total_decay(s: complex, time_s: FloatArray) -> float:
    """Logarithm of the fall of a mode's amplitude over the record."""
    return float(-s.real * time_s[-1])


def _flags(
    j: int,
    time_s: FloatArray,
    decay: Settled,
    frequency_hz: FloatArray,
    damping: FloatArray,
    sigmas: FloatArray,
    coherence: FloatArray,
    amplitude: FloatArray,
    rate_hz: float,
) -> list[str]:
    duration_s = float(time_s[-1])
    f, zeta = float(frequency_hz[j]), float(damping[j])
    flags = common_flags(f, float(sigmas[j, 0]), zeta, decay.known[j].pole.coherence, rate_hz, duration_s)
    flags += decay_flags(zeta, sigmas[j], f, duration_s, float(coherence[j]))
    flags += weak_flags(j, list(frequency_hz), list(sigmas[:, 0]), list(amplitude))
    return flags


def channel_shapes(orthonormal: FloatArray, triangle: FloatArray, channels: Channels, modes: int) -> ComplexArray:
    """Complex amplitudes (modes, L) at time 0 of each mode in each channel, by linear least squares."""
    X = np.linalg.solve(triangle, transposed_times(channels, orthonormal).T)
    return (X[0 : 2 * modes : 2] - 1j * X[1 : 2 * modes : 2]).astype(np.complex128)
