"""The gates between a fitted mode and a valid one. Each names what is wrong; a mode without a name is valid."""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from fsw.modal.ambient import Peak

FloatArray = NDArray[np.float64]

# The highest frequency believed, as a share of the rate: above, a mode may be the alias of one beyond half
# the rate.
NYQUIST_SHARE = 0.4
LARGEST_DAMPING = 0.2
# Share of energy about the frequency that the mode must explain, and least amplitude coherence of its pole.
LEAST_FIT_COHERENCE = 0.9
LEAST_AMPLITUDE_COHERENCE = 0.8
# What any stretch of a decay may leave unexplained, as a share of the mode's amplitude at the start.
LARGEST_DEPARTURE = 0.05
DEPARTURE_DEVIATIONS = 3.5
# The first part of a decay, fitted alone, must say what the whole says: so large a part, of at least so many samples
# and cycles; differences below these shares do not matter.
EARLY_SHARE = 0.6
EARLY_SAMPLES = 24
EARLY_CYCLES = 1.5
EARLY_FREQUENCY = 0.002
EARLY_DAMPING = 0.1
EARLY_DEVIATIONS = 5.0
# A line whose amplitude falls by less than this share over the record may as well be forced.
LEAST_DECAY = 0.05
# Damping must stand so many deviations above zero, and both intervals must be this narrow.
DAMPING_DEVIATIONS = 3.0
LARGEST_FREQUENCY_SIGMA = 0.01
LARGEST_DECAY_FREQUENCY_SIGMA = 0.005
LARGEST_AMBIENT_DAMPING_SIGMA = 1.75
# A frequency that moves by more than this share of itself within the record is not one frequency.
LARGEST_CHANGE = 0.005
CHANGE_DEVIATIONS = 4.0
LEAST_CYCLES = 2.0
# Perspective and bending make weak copies of strong modes at sums, differences and multiples of their frequencies;
# copies of higher order are weaker still.
COMBINATION_AMPLITUDE = 0.03
HIGH_COMBINATION_AMPLITUDE = 0.01
COMBINATION_FREQUENCY = 0.003
LEAST_RELATIVE_AMPLITUDE = 5e-3
# Modes nearer than this many 1 / T stand apart by their shapes alone; nearer than so many deviations, not at all.
PAIR_RESOLUTIONS = 2.0
PAIR_DEVIATIONS = 3.0
# A steady sinusoid that explains so much of an ambient peak means that something drives it there: surely, or unless
# the likelihood is sure of a decay; and one that is as likely as a mode. Of a mode of 2.7 time constants a sinusoid
# explains more than 0.9 by chance in 1 case of 60, more than 0.97 in 1 of 5000. It is as likely as a mode by chance in
# 1 case of 1000, but then leaves more of the peak than a line does: that leaves noise, which holds half as much over
# the floor as a peak of LINE_NOISE times the floor.
CERTAIN_LINE_SHARE = 0.97
LARGEST_LINE_SHARE = 0.9
LEAST_LINE_GAIN, SURE_LINE_GAIN = 4.0, 10.0
LEAST_LINE_SHARE = 0.8
LINE_NOISE = 16.0
# The same ratio against a free decay: what one explains better is no stationary response. By chance one is as likely
# as a mode in 1 case of 2000.
LEAST_FALL_GAIN = -10.0
# Twice the log likelihood ratio that an ambient peak must gain over a smooth spectrum, if it appears in so many orders
# and if it does not, and its least height over the floor beside it.
LEAST_GAIN = 20.0
LEAST_ORDERS = 4
FEW_ORDERS_GAIN = 60.0
LEAST_RISE = 5.0


def common_flags(
    frequency_hz: float,
    frequency_sigma_hz: float,
    damping_ratio: float,
    coherence: float,
    rate_hz: float,
    duration_s: float,
) -> list[str]:
    """Flags that hold for decays and ambient response alike."""
    flags = []
    if frequency_hz > NYQUIST_SHARE * rate_hz:
        flags.append("near_nyquist")
    if frequency_hz * duration_s < LEAST_CYCLES:
        flags.append("short_record")
    if coherence < LEAST_AMPLITUDE_COHERENCE:
        flags.append("incoherent")
    if not frequency_sigma_hz < LARGEST_FREQUENCY_SIGMA * frequency_hz:
        flags.append("imprecise")
    if damping_ratio > LARGEST_DAMPING:
        flags.append("overdamped")
    return flags


def decay_flags(
    damping_ratio: float, sigmas: FloatArray, frequency_hz: float, duration_s: float, fit_coherence: float
) -> list[str]:
    """Flags of a free decay: steady lines, growth, damping that cannot be told from none, a poor fit.

    sigmas (2,): of frequency in Hz and of damping ratio.
    """
    damping_ratio_sigma = float(sigmas[1])
    flags = []
    # A decay is known at once or not at all: red noise gives wide fits that last for a few cycles.
    if not sigmas[0] < LARGEST_DECAY_FREQUENCY_SIGMA * frequency_hz:
        flags.append("imprecise")
    decay = 2.0 * np.pi * frequency_hz * damping_ratio * duration_s
    if damping_ratio < -DAMPING_DEVIATIONS * damping_ratio_sigma and decay < -LEAST_DECAY:
        flags.append("growing")
    elif decay < LEAST_DECAY:
        flags.append("harmonic")
    elif damping_ratio < DAMPING_DEVIATIONS * damping_ratio_sigma:
        flags.append("imprecise")
    if fit_coherence < LEAST_FIT_COHERENCE:
        flags.append("not_exponential")
    return flags


def differs(off: FloatArray, sigma: FloatArray, modal: FloatArray) -> NDArray[np.bool_]:
    """Whether two estimates of each mode (m,) differ by more than matters and more than noise can feign.

    off, sigma, modal (m, 2): differences, deviations and values of frequency in Hz and of damping ratio.
    """
    matters = np.abs(modal) * (EARLY_FREQUENCY, EARLY_DAMPING)
    return np.asarray(np.any(off > np.fmax(matters, EARLY_DEVIATIONS * sigma), axis=1))


def departs(share: float, deviations: float) -> bool:
    """Whether a stretch of the record is too far from the fitted decay, by more than noise can feign."""
    return share > LARGEST_DEPARTURE and deviations > DEPARTURE_DEVIATIONS


def ambient_flags(
    damping_ratio: float, damping_sigma: float, peak: Peak, line_gain: float, fall_gain: float, orders: int
) -> list[str]:
    """Flags of a mode in stationary response: a steady line, a decay, damping unknown, a peak that noise makes as well.

    line_gain, fall_gain: twice the log likelihood ratio of the mode against a steady line, and against a free decay.
    orders: that the mode appears in.
    """
    flags = []
    if fall_gain < LEAST_FALL_GAIN:
        flags.append("not_exponential")
    explains = peak.line_share > min(LEAST_LINE_SHARE, peak.rise / (peak.rise + LINE_NOISE))
    line = (line_gain < LEAST_LINE_GAIN and explains) or peak.line_share > CERTAIN_LINE_SHARE
    if line or (peak.line_share > LARGEST_LINE_SHARE and line_gain < SURE_LINE_GAIN):
        flags.append("harmonic")
    if not damping_sigma < LARGEST_AMBIENT_DAMPING_SIGMA * damping_ratio:
        flags.append("imprecise")
    enough = LEAST_GAIN if orders >= LEAST_ORDERS else FEW_ORDERS_GAIN
    if peak.gain < enough or peak.rise < LEAST_RISE:
        flags.append("weak")
    return flags


def varies(change_hz: float, sigma_hz: float, frequency_hz: float) -> bool:
    """Whether a frequency changes within the record, by more than matters and more than noise can feign."""
    return abs(change_hz) > max(LARGEST_CHANGE * frequency_hz, CHANGE_DEVIATIONS * sigma_hz)


def weak_flags(
    index: int, frequency_hz: Sequence[float], sigma_hz: Sequence[float], amplitude: Sequence[float]
) -> list[str]:
    """Flags of a mode that may be the echo of stronger ones: "combination" at m f_a +- n f_b, "weak" near
    the measurement's linearity.

    All sequences (m,): the record's modes in the same order.
    """
    largest = max(amplitude)
    flags = []
    if amplitude[index] < LEAST_RELATIVE_AMPLITUDE * largest:
        flags.append("weak")
    parents = [j for j, a in enumerate(amplitude) if amplitude[index] < COMBINATION_AMPLITUDE * a]
    others = [j for j, a in enumerate(amplitude) if a > 2.0 * amplitude[index] and j != index]
    f = frequency_hz[index]

    def meets(combined_hz: float, tolerance_hz: float) -> bool:
        return abs(f - combined_hz) < max(COMBINATION_FREQUENCY * f, 3.0 * (sigma_hz[index] + tolerance_hz))

    strongest = [j for j in parents if amplitude[index] < HIGH_COMBINATION_AMPLITUDE * amplitude[j]]
    multiples = any(meets(n * frequency_hz[j], n * sigma_hz[j]) for j in parents for n in (2, 3))
    multiples |= any(meets(n * frequency_hz[j], n * sigma_hz[j]) for j in strongest for n in range(4, 9))
    sums = any(
        meets(abs(m * frequency_hz[a] + n * frequency_hz[b]), abs(m) * sigma_hz[a] + abs(n) * sigma_hz[b])
        for a, b in combinations_with_replacement(sorted({*parents, *others}), 2)
        if a in parents or b in parents
        for m, n in ((1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2))
    )
    if multiples or sums:
        flags.append("combination")
    return flags
