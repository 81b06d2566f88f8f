"""Intervals that tell the truth: Cramer-Rao, Au's law for ambient response, coloured noise, time variation."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.beside import Beside, turning
from fsw.modal.realisation import frequency_and_damping
from fsw.modal.refinement import Fit, pole_directions
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Frequencies to either side of a mode's own at which a fit is weighed against what it leaves.
_HALF_BAND = 12
# A record is looked at in at most so many stretches, of one period or more, of at least so many samples.
_STRETCHES = 24
_LEAST_IN_STRETCH = 4
# A deviation of the damping beyond this share of it differs along its interval; how often its end is looked up.
_WIDE, _ENDS = 0.03, 2
_MOST_DAMPING = 0.3


def pole_to_modal(s: complex) -> FloatArray:
    """Derivatives (2, 2) of (frequency_hz, damping_ratio) by (Re s, Im s)."""
    a, w, r = s.real, s.imag, abs(s)
    return np.array([[a / (2.0 * np.pi * r), w / (2.0 * np.pi * r)], [-(w**2) / r**3, a * w / r**3]])


def modal_sigmas(poles: ComplexArray, information: FloatArray, noise: FloatArray) -> FloatArray:
    """Standard deviations (m, 2) of frequency in Hz and damping ratio.

    information (2 m, 2 m): Fisher information of (Re, Im) pairs for unit noise; noise (m,): the noise's
    power beside each mode.
    """
    covariance = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    slopes = np.array([pole_to_modal(complex(s)) for s in poles]).reshape(-1, 2, 2)
    own = np.arange(2 * len(poles)).reshape(-1, 2)
    spread = slopes @ covariance[own[:, :, None], own[:, None, :]] @ slopes.transpose(0, 2, 1)
    return np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0.0) * noise[:, None])


def at_upper_end(fit: Fit, sigmas: FloatArray, noise: FloatArray) -> FloatArray:
    """Deviations (m, 2) as the upper end of the damping's interval has them, where that is wide.

    A faster decay tells less of itself. Where noise feigns a slow one, the deviation at what was found is too small:
    what counts is how surprising the truth is, if it is the truth. noise (m,): see modal_sigmas.
    """
    frequency_hz, damping = frequency_and_damping(fit.poles)
    if not np.any(sigmas[:, 1] > _WIDE * np.abs(damping)):
        return sigmas
    signals = fit.residual + fit.span.basis @ fit.coefficients
    for _ in range(_ENDS):
        upper = np.clip(damping + 2.0 * sigmas[:, 1], 0.0, _MOST_DAMPING)
        poles = 2.0 * np.pi * frequency_hz * (-upper + 1j * np.sqrt(1.0 - upper**2))
        sigmas = np.maximum(sigmas, modal_sigmas(poles, fit.span.of(poles).fit(signals).information, noise))
    return sigmas


def au_law(frequency_hz: float, damping_ratio: float, duration_s: float) -> tuple[float, float]:
    """Least coefficients of variation of frequency and damping ratio from stationary response to white noise.

    Long data, wide band, high signal-to-noise ratio. Source: Au, 2014, uncertainty law in ambient modal
    identification.
    """
    cycles = frequency_hz * duration_s
    return (damping_ratio / (2.0 * np.pi * cycles)) ** 0.5, (2.0 * np.pi * damping_ratio * cycles) ** -0.5


def fit_coherence(time_s: FloatArray, fit: Fit, mode: int) -> float:
    """Share of the energy about a mode's frequency that its damped sinusoid explains, 0 to 1.

    The band is the mode's own width, at least 3 / T to either side: a frequency that wanders leaves its
    energy there.
    """
    along = fit.directions[mode]
    s = complex(fit.poles[mode])
    half = max(3.0 / float(time_s[-1]), abs(s.real) / np.pi)
    waves = turning(time_s, s.imag / (2.0 * np.pi) - half, half / _HALF_BAND, 2 * _HALF_BAND + 1)
    own = slice(2 * mode, 2 * mode + 2)
    explained = fit.span.basis[:, own] @ (fit.coefficients[own] @ along)
    model, rest = np.sum((waves @ np.stack([explained, fit.residual @ along], axis=1)) ** 2, axis=(0, 1))
    return float(model / (model + rest)) if model > 0.0 else 0.0


def departure(time_s: FloatArray, fit: Fit, mode: int) -> tuple[float, float]:
    """The largest oscillation at a mode's frequency that the fit leaves in any one stretch of the record.

    As a share of the mode's amplitude at the start, and in standard deviations of white noise of unit variance. A wing
    that is stopped, struck or held inside the record leaves its mark in one stretch, where an average would hide it.
    """
    along = fit.directions[mode]
    amplitude = float(np.hypot(*(fit.coefficients[2 * mode : 2 * mode + 2] @ along)))
    left, samples = in_stretches(time_s, (fit.residual @ along)[:, None], float(fit.poles[mode].imag))
    if amplitude <= 0.0 or len(samples) == 0:
        return 0.0, 0.0
    size = np.abs(left[:, 0])
    worst = int(np.argmax(size))
    return float(size[worst]) / amplitude, float(size[worst]) * float(np.sqrt(samples[worst])) / 2.0


def in_stretches(time_s: FloatArray, signals: FloatArray, omega: float) -> tuple[ComplexArray, NDArray[np.int64]]:
    """Complex amplitude (k, p) of an oscillation in each stretch of signals (T, p), and its samples (k,).

    omega: its circular frequency in rad/s.
    """
    length_s = max(2.0 * np.pi / omega, float(time_s[-1]) / _STRETCHES)
    sums, samples = _sums(time_s, np.ascontiguousarray(signals), omega, length_s)
    enough = samples >= _LEAST_IN_STRETCH
    return 2.0 * sums[enough] / samples[enough][:, None], samples[enough]


@kernel
def _sums(
    time_s: FloatArray, signals: FloatArray, omega: float, length_s: float
) -> tuple[ComplexArray, NDArray[np.int64]]:
    """Sums (k, p) of signals (T, p) turned back, over each stretch that has samples, and how many these are."""
    sums, samples = np.zeros((len(time_s), signals.shape[1]), np.complex128), np.zeros(len(time_s), np.int64)
    place, last = -1, -1.0
    for t in range(len(time_s)):
        stretch = np.floor((time_s[t] - time_s[0]) / length_s)
        if stretch != last:
            place, last = place + 1, stretch
        turn = np.exp(-1j * omega * time_s[t])
        for k in range(signals.shape[1]):
            sums[place, k] += signals[t, k] * turn
        samples[place] += 1
    return sums[: place + 1], samples[: place + 1]


def frequency_change(time_s: FloatArray, fit: Fit, mode: int, around: Beside) -> tuple[float, float]:
    """Change of a mode's frequency in Hz while it can be seen, and its standard deviation.

    The score test of a linear frequency ramp: the residual is projected on the model's derivative by the
    ramp, outside all that the model can already do. "While it can be seen": three time constants, or the
    record.
    """
    modes = len(fit.poles)
    s = complex(fit.poles[mode])
    X = fit.coefficients[2 * mode : 2 * mode + 2]
    E, ramp = fit.tangent, np.stack([X[1], -X[0]])
    # All is done in products of few columns: the ramp's waves outside of the span, and the tangent.
    waves = 0.5 * time_s[:, None] ** 2 * fit.span.basis[:, 2 * mode : 2 * mode + 2]
    waves -= fit.orthonormal @ (fit.orthonormal.T @ waves)
    pull = E.T @ waves @ ramp
    # What the poles' own derivatives can explain of it is removed.
    directions = pole_directions(fit.coefficients, modes).reshape(modes, 2, 2, -1)
    score = (directions * pull.reshape(modes, 1, 2, -1)).sum(axis=(2, 3)).ravel()
    share = np.linalg.lstsq(fit.information, score, rcond=1e-14)[0]
    taken = (share.reshape(modes, 2, 1, 1) * directions).sum(axis=1).reshape(2 * modes, -1)
    energy = float(np.vdot(waves.T @ waves @ ramp, ramp) - 2.0 * np.vdot(pull, taken))
    energy += float(np.vdot(fit.span.gram @ taken, taken))
    if energy <= 0.0:
        return 0.0, np.inf
    met = np.vdot(waves.T @ fit.residual, ramp) - np.vdot(E.T @ fit.residual, taken)
    rate = float(met) / energy
    noise = around.power(around.seen - rate * (around.waves @ waves @ ramp - around.waves @ E @ taken))
    seen_s = min(float(time_s[-1]), 3.0 / max(-s.real, 1e-12))
    to_hz = seen_s / (2.0 * np.pi)
    return rate * to_hz, (noise / energy) ** 0.5 * to_hz
