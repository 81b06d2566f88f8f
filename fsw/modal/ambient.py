"""Evidence for a mode in a stationary response: its peak in the periodogram against what is beside it.

The expected periodogram is that of an exponentially decaying correlation seen through a record of finite
length, in closed form: leakage is part of the model, so neither a short record nor a steady line passes for
damping.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.beside import turning
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Rounds of fitting variance and floor, weighted by the model of the round before.
_ROUNDS = 12
# Half width of the band: so many half-power widths, at least so many bins, at most this share of the
# frequency.
_WIDTHS, _BINS, _SHARE = 10.0, 16.0, 0.45


@dataclass(frozen=True)
class Peak:
    """What a periodogram says of a mode: variance of its response, floor of the density beside it
    (two-sided, per Hz).

    gain: twice the log likelihood ratio against a smooth, sloping spectrum. rise: the peak's density over
    the floor. line_share: the variance that one steady sinusoid explains, over that of the band.
    """

    variance: float
    floor: float
    gain: float
    rise: float
    line_share: float


@kernel
def expected_peak(frequency_hz: FloatArray, centre_hz: float, decay_rate: float, duration_s: float) -> FloatArray:
    """Expected two-sided periodogram (k,) in 1/Hz of a unit-variance process with correlation exp(-a |tau|)
    cos(w tau).

    decay_rate a in 1/s; duration T in s. The integral over tau from -T to T of (1 - |tau| / T) times the
    correlation: exact leakage.
    """
    value = np.empty(len(frequency_hz))
    for k in range(len(frequency_hz)):
        x = complex(decay_rate, 2.0 * np.pi * (frequency_hz[k] - centre_hz)) * duration_s
        integral = 0.5 - x / 6.0 if abs(x) < 1e-3 else 1.0 / x - (1.0 - np.exp(-x)) / x**2
        value[k] = duration_s * integral.real
    return value


def weigh_peak(signal: FloatArray, rate_hz: float, frequency_hz: float, damping_ratio: float) -> Peak | None:
    """Variance, floor and evidence of a resonance in one signal (T,), by the Whittle likelihood.

    None if the band about the frequency holds too few bins.
    """
    count = len(signal)
    duration_s = count / rate_hz
    decay_rate = 2.0 * np.pi * damping_ratio * frequency_hz
    half_hz = float(np.clip(_WIDTHS * damping_ratio * frequency_hz, _BINS / duration_s, _SHARE * frequency_hz))
    grid_hz = np.fft.rfftfreq(count, 1.0 / rate_hz)
    band = (np.abs(grid_hz - frequency_hz) <= half_hz) & (grid_hz > 0.5 / duration_s) & (grid_hz < 0.499 * rate_hz)
    if np.count_nonzero(band) < 5:
        return None
    f = grid_hz[band]
    periodogram = (np.abs(np.fft.rfft(signal)) ** 2 / (rate_hz * count))[band] + 1e-300
    shape = expected_peak(f, frequency_hz, decay_rate, duration_s)
    floor = float(np.mean(np.sort(periodogram)[: max(len(f) // 4, 2)]))
    variance = 2.0 * float(np.sum(periodogram)) / duration_s
    variance, floor = _shared_out(periodogram, shape, variance, floor)
    model = variance * shape + floor
    loss = float(np.sum(np.log(model) + periodogram / model))
    top = variance * float(expected_peak(np.array([frequency_hz]), frequency_hz, decay_rate, duration_s)[0])
    energy = 2.0 * float(np.sum(np.maximum(periodogram - floor, 0.0))) / duration_s
    return Peak(
        variance=variance,
        floor=floor,
        gain=2.0 * (_smooth_loss(f, periodogram) - loss),
        rise=top / floor,
        line_share=_line_variance(signal, rate_hz, frequency_hz) / max(energy, 1e-300),
    )


@kernel
def _shared_out(periodogram: FloatArray, shape: FloatArray, variance: float, floor: float) -> tuple[float, float]:
    """Variance and floor of two exponential spectra by expectation-maximisation: each bin's power is shared out by the
    model of the round before.
    """
    for _ in range(_ROUNDS):
        peak = variance * shape
        share, ratio = peak / (peak + floor), periodogram / (peak + floor)
        variance *= np.sum(share * ratio) / np.sum(share)
        floor *= np.sum((1.0 - share) * ratio) / np.sum(1.0 - share)
    return variance, floor


@kernel
def _smooth_loss(f: FloatArray, periodogram: FloatArray) -> float:
    """Whittle loss of a spectrum without peaks: a power law over the band, of the right mean."""
    along, level = np.log(f) - np.mean(np.log(f)), np.log(periodogram)
    line = np.exp(np.mean(level) + along * (along @ level) / (along @ along))
    line = line * np.mean(periodogram / line)
    return np.sum(np.log(line) + periodogram / line)


def _line_variance(signal: FloatArray, rate_hz: float, centre_hz: float) -> float:
    """Variance of the best steady sinusoid within a bin of a frequency."""
    count = len(signal)
    time_s = np.arange(count) / rate_hz
    bin_hz = rate_hz / count
    lines = np.sum((turning(time_s, centre_hz - bin_hz, 0.125 * bin_hz, 17) @ signal) ** 2, axis=0)
    return float(2.0 * np.max(lines) / count**2)
