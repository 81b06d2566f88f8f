"""The damping of a stationary response, from the flanks of its peak.

They tell how strong the force is, and with it the height of the peak tells the damping: in 10 half-power widths it is
known with 1.17 times the deviation of the uncertainty law, in 30 with 1.06 times (Au 2014, B_zeta). A force that is
stronger to one side of the peak than to the other shifts the frequency, and the more the wider the band, but not the
damping: so the frequency is left as it is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.modal.ambient import Peak
from fsw.modal.clustering import Candidate
from fsw.modal.stationary_groups import Refined
from fsw.modal.stationary_likelihood import band_of, half_band_hz
from fsw.modal.stationary_model import Modes
from fsw.modal.stationary_posterior import decay_rate_of

FloatArray = NDArray[np.float64]

# Flanks reach so many half-power widths, at most this share of the frequency; and no farther than to this share of the
# noise beside the peak, which is seen too high from nearby.
_WIDTHS, _SHARE, _STANDS = 30.0, 0.15, 0.06
# A band that is not so much wider than the one that the mode is known from tells nothing new.
_WIDER = 1.2
# What another damping than the peak's, by more than so many of its deviations, tells of is not this mode.
_DEVIATIONS = 3.0


def with_flanks(entry: Refined, peak: Peak, signal: FloatArray, rate_hz: float, found: Sequence[Candidate]) -> Refined:
    """A mode with the damping that its flanks tell, where they stand above the noise and clear of other modes.

    signal (T,): the mode alone. found: all modes.
    """
    candidate, duration_s = entry.candidate, len(signal) / rate_hz
    f, damping = candidate.frequency_hz, candidate.damping_ratio
    free_hz = [
        abs(other.frequency_hz - f) - half_band_hz(other.frequency_hz, other.damping_ratio, duration_s)
        for other in found
        if other is not candidate
    ]
    # A peak falls with the square of the distance.
    widths = min(_WIDTHS, float(np.sqrt(peak.rise / _STANDS)))
    reach_hz = min(widths * damping * f, _SHARE * f, *free_hz)
    if reach_hz < _WIDER * half_band_hz(f, damping, duration_s):
        return entry
    band = band_of(signal[:, None], rate_hz, f - reach_hz, f + reach_hz)
    omega = 2.0 * np.pi * f
    start = np.array([f]), np.array([omega * damping]), np.array([0.5 * peak.variance])
    rate, sigma = decay_rate_of(band, Modes(*start, np.ones((1, 1)), peak.floor / band.duration_s))
    if abs(rate / omega - damping) > _DEVIATIONS * entry.damping_sigma:
        return entry
    pole = replace(candidate.pole, s=complex(-rate, candidate.pole.s.imag))
    better = replace(candidate, pole=pole, damping_ratio=rate / omega)
    return replace(entry, candidate=better, damping_sigma=sigma / omega)
