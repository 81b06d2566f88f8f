"""What a fit leaves: whether it may hold a mode that the likelihood would keep, and so is worth another search.

A search by subspaces costs as much as all the rest of an identification. Matched filters tell beforehand whether there
is anything to find: coarsely, of steady and falling sinusoids on a grid, and finely where the coarse ones are tall.
"""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from fsw.modal.beside import turning
from fsw.modal.refinement import Fit

FloatArray = NDArray[np.float64]

# A steady sinusoid and one that falls are looked for, by exponents times T; what falls at another pace, or lies between
# two frequencies of the grid, has at least two thirds of its own peak. A closer look is worth it at this share of what
# a mode must have beyond the noise's mean.
_FALLS, _COARSE = (0.0, 4.0), 0.5
# The closer look: paces, steps of frequency to either side in units of 1 / T, and the share that is worth a search.
# With more tall places than can be looked at there is a mode.
_PACES, _STEP, _STEPS, _FINE = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0), 0.125, 2, 0.8
_MOST_PLACES = 12
# Of a sinusoid of which the fit spans nearly all, at least this share is counted as outside.
_LEAST_OUTSIDE = 0.05


def may_hold_a_mode(left: FloatArray, fit: Fit, least: float) -> bool:
    """Whether a mode of the statistic that is asked for, or nearly, may be in a whitened residual.

    left (N, p): the fit's residual on an even grid; least: statistic that a mode's amplitudes must have.
    """
    noise = 2.0 * left.shape[1]  # mean of the statistic where there is no mode
    places = set()
    for fall in _FALLS:
        window = np.exp(-fall * np.arange(len(left)) / len(left))
        statistic = 2.0 * _powers(left * window[:, None]) / float(window @ window)
        places |= set(map(int, np.flatnonzero(statistic > noise + _COARSE * (least - noise))))
    enough = noise + _FINE * (least - noise)
    if len(places) > _MOST_PLACES:
        return True
    return any(_statistic(fit, 0.5 * place) > enough for place in sorted(places))


def _statistic(fit: Fit, cycles: float) -> float:
    """The largest statistic of a sinusoid outside the fit's span, near so many cycles over the record."""
    time_s = fit.span.time_s
    count = 2 * _STEPS + 1
    waves = turning(time_s, (cycles - _STEP * _STEPS) / float(time_s[-1]), _STEP / float(time_s[-1]), count)
    falls = np.exp(-np.outer(_PACES, time_s) / float(time_s[-1]))
    falling = (waves[:, :, None] * falls).reshape(-1, len(time_s))
    power = np.sum(falls**2, axis=1)
    met = falling @ np.hstack([fit.orthonormal, fit.residual])
    spanned, seen = np.split(met**2, [fit.orthonormal.shape[1]], axis=1)
    spanned, seen = (part.sum(axis=1).reshape(2, count, len(_PACES)).sum(axis=0) for part in (spanned, seen))
    return float(np.max(2.0 * seen / np.maximum(power - spanned, _LEAST_OUTSIDE * power)))


def tallest(signals: FloatArray) -> float:
    """Largest power over frequency, summed over the coordinates of an even grid (N, p)."""
    return float(np.max(_powers(signals), initial=0.0))


def _powers(signals: FloatArray) -> FloatArray:
    """Power (N + 1,) at 0, 1 / 2 T, 1 / T, ..., summed over the coordinates (N, p); below 1.5 / T, drift, it is 0."""
    spectrum = scipy.fft.rfft(signals, 2 * len(signals), axis=0)
    power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=1)
    power[:3] = 0.0
    return np.asarray(power, np.float64)
