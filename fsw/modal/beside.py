"""The noise beside a mode: what the residual of a fit holds at frequencies near it, where the fit takes nothing out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.refinement import Fit
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Frequencies beside a mode, in units of 1 / T, at which the residual tells the noise: near enough to feel
# its colour, but not the line itself, which the fit has emptied.
REACH = 11
# A frequency of which the fit leaves less than this share of white noise tells nothing.
_CLEAR = 0.3
# Of the two tangents of a pole, one that is shorter than the other by the root of this is none.
_ROUNDING = 1e-15
# The noise beside one mode in one direction is few samples: it is drawn towards that of all coordinates by
# so many.
_PRIOR_SAMPLES = 10.0


@kernel
def turning(time_s: FloatArray, first_hz: float, step_hz: float, count: int) -> FloatArray:
    """Cosines and sines (2, count, T) at so many frequencies, evenly apart."""
    waves = np.empty((2, count, len(time_s)))
    for t in range(len(time_s)):
        wave, turn = np.exp(2j * np.pi * first_hz * time_s[t]), np.exp(2j * np.pi * step_hz * time_s[t])
        for k in range(count):
            waves[0, k, t], waves[1, k, t] = wave.real, wave.imag
            wave *= turn
    return waves


@dataclass(frozen=True)
class Beside:
    """Frequencies beside a mode, 1 / T apart, at which the residual of a fit tells the noise.

    waves (2 n, T): cosines and sines there; left_of_all, left_of_own (n,): of their energy, what lies outside of the
    fit's span, and outside of the tangent of the mode's own pole as well; along (p,): direction of the mode's motion;
    seen (2 n, p): products with the residual.
    """

    waves: FloatArray
    left_of_all: FloatArray
    left_of_own: FloatArray
    along: FloatArray
    seen: FloatArray

    def power(self, seen: FloatArray) -> float:
        """Power of what is seen there (2 n, p), along the mode's direction: 1 for white noise of unit variance."""
        return _power(self.left_of_all, self.left_of_own, self.along, seen, self.waves.shape[1])

    @property
    def noise(self) -> float:
        """Power of the residual."""
        return self.power(self.seen)


@kernel
def _power(
    left_of_all: FloatArray, left_of_own: FloatArray, along: FloatArray, seen: FloatArray, samples: int
) -> float:
    count, width = len(left_of_all), len(along)
    energy, all_left, own, clear = 0.0, 0.0, 0.0, 0
    for i in range(count):
        cosine, sine = 0.0, 0.0
        for k in range(width):
            energy += seen[i, k] ** 2 + seen[count + i, k] ** 2
            cosine += seen[i, k] * along[k]
            sine += seen[count + i, k] * along[k]
        all_left += left_of_all[i]
        if left_of_own[i] > _CLEAR * samples:
            own += (cosine**2 + sine**2) / left_of_own[i]
            clear += 1
    overall = energy / width / max(all_left, 1e-300)
    return (own + _PRIOR_SAMPLES * overall) / (clear + _PRIOR_SAMPLES)


def beside(time_s: FloatArray, fit: Fit, mode: int) -> Beside:
    """The frequencies beside one mode of a fit.

    What the fit takes out of white noise at these frequencies (drift and other modes near by) is put back in
    expectation. True stamps: a plain sum of exponentials needs no even grid.
    """
    duration_s, own = float(time_s[-1]), slice(2 * mode, 2 * mode + 2)
    frequency_hz = abs(fit.poles[mode]) / (2.0 * np.pi)
    first = max(int(np.floor(-frequency_hz * duration_s)) + 1, -REACH)
    along = fit.directions[mode]
    count = 2 * len(fit.poles), fit.orthonormal.shape[1]
    waves, met = _met_beside(time_s, frequency_hz, first, fit.columns)
    of_all, of_own = _left_beside(met, len(time_s), *count, 2 * mode, np.ascontiguousarray(fit.span.gram[own, own]))
    return Beside(waves, of_all, of_own, along, np.ascontiguousarray(met[:, sum(count) :]))


@kernel
def _met_beside(
    time_s: FloatArray, frequency_hz: float, first: int, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Cosines and sines (2 n, T) beside a frequency, from the first to the last step of 1 / T, and what they meet of
    columns (T, c).
    """
    waves = turning(time_s, frequency_hz + first / time_s[-1], 1.0 / time_s[-1], REACH + 1 - first)
    chosen = np.empty((2 * (REACH - 2 - first), len(time_s)))
    row = 0
    for part in range(2):
        for k in range(REACH + 1 - first):
            if abs(first + k) > 1:
                chosen[row] = waves[part, k]
                row += 1
    return chosen, chosen @ columns


@kernel
def _left_beside(
    met: FloatArray, samples: int, tangents: int, spanned: int, own: int, gram: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of the energy of waves: what is left outside of a fit's span, and outside of a mode's own tangent as well.

    met (2 n, tangents + spanned + p): products with the tangents, the mode's own two from the column own on, and with
    the span; gram (2, 2): of the own ones.
    """
    count = len(met) // 2
    of_all, of_own = np.empty(count), np.empty(count)
    # Their principal axis, and what is at right angles to it.
    middle, half = 0.5 * (gram[0, 0] + gram[1, 1]), np.hypot(0.5 * (gram[0, 0] - gram[1, 1]), gram[0, 1])
    longer = middle + half
    shorter = (gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2) / longer if longer > 0.0 else 0.0
    angle = 0.5 * np.arctan2(2.0 * gram[0, 1], gram[0, 0] - gram[1, 1])
    cosine, sine = np.cos(angle), np.sin(angle)
    for i in range(count):
        taken, pulled = 0.0, 0.0
        for row in (i, count + i):
            for k in range(tangents, tangents + spanned):
                taken += met[row, k] ** 2
            a, b = met[row, own], met[row, own + 1]
            if longer > 0.0:
                pulled += (cosine * a + sine * b) ** 2 / longer
            if shorter > _ROUNDING * longer:
                pulled += (cosine * b - sine * a) ** 2 / shorter
        of_all[i] = max(samples - taken, 0.0)
        of_own[i] = max(of_all[i] - pulled, 0.0)
    return of_all, of_own


def noise_beside(time_s: FloatArray, fit: Fit, modes: Sequence[int] | None = None) -> FloatArray:
    """Power (m,) of the residual beside the frequency of each mode (default: all), along the direction it moves in."""
    chosen = range(len(fit.poles)) if modes is None else modes
    return np.array([beside(time_s, fit, j).noise for j in chosen])
