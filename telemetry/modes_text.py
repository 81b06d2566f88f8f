"""Modes as a table for a terminal: each value with its 95 % interval, beside the truth where there is one."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

INTERVAL = 1.96  # standard deviations of a 95 % interval


def modes_table(modes: Mapping[str, Any], truth: Sequence[Mapping[str, float]] = ()) -> str:
    """Lines of text from the structure of modes.json.

    truth: {"frequency_hz", "damping_ratio"} of the modes that there are; each stands beside the nearest found one.
    """
    if not modes["modes"]:
        flags = ", ".join(modes["flags"]) or "the record is too short or too noisy"
        return f"no mode found ({flags})"
    head = f"{'frequency / Hz':>24} {'damping / %':>20} {'amplitude / mm':>15} {'coherence':>10}  state"
    lines = [head + ("   truth: Hz, %    error" if truth else "")]
    partner = partners(modes["modes"], truth)
    for number, mode in enumerate(modes["modes"]):
        state = "valid" if mode["valid"] else "not valid"
        if mode["flags"]:
            state += f" ({', '.join(mode['flags'])})"
        line = (
            f"{_interval(mode['frequency_hz'], mode['frequency_sigma_hz'], 1.0, 5):>24} "
            f"{_interval(mode['damping_ratio'], mode['damping_ratio_sigma'], 100.0, 4):>20} "
            f"{_value(mode['amplitude_mm'], '.3f'):>15} {_value(mode['amplitude_coherence'], '.4f'):>10}  {state}"
        )
        if number in partner:
            known = partner[number]
            f_error = 100.0 * (mode["frequency_hz"] / known["frequency_hz"] - 1.0)
            line += f"   {known['frequency_hz']:.5f} {100.0 * known['damping_ratio']:.3f}  {f_error:+.4f} % in f"
            if mode["damping_ratio"] is not None:
                z_error = 100.0 * (mode["damping_ratio"] / known["damping_ratio"] - 1.0)
                line += f", {z_error:+.2f} % in damping"
        lines.append(line)
    if modes["flags"]:
        lines.append(f"record: {', '.join(modes['flags'])}")
    return "\n".join(lines)


def partners(
    modes: Sequence[Mapping[str, Any]], truth: Sequence[Mapping[str, float]]
) -> dict[int, Mapping[str, float]]:
    """For each true mode the found one nearest in frequency, if it is within a tenth."""
    partner: dict[int, Mapping[str, float]] = {}
    for known in truth if modes else ():
        distance = [abs(mode["frequency_hz"] / known["frequency_hz"] - 1.0) for mode in modes]
        nearest = min(range(len(modes)), key=distance.__getitem__)
        if distance[nearest] < 0.1:
            partner[nearest] = known
    return partner


def _interval(value: float | None, sigma: float | None, scale: float, digits: int) -> str:
    if value is None:
        return "-"
    if sigma is None or not sigma > 0.0:
        return f"{value * scale:.{digits}f}"
    half = INTERVAL * sigma * scale
    places = min(max(digits, 1 - math.floor(math.log10(half))), 9)  # two digits of the interval, at least
    return f"{value * scale:.{places}f} +- {half:.{places}f}"


def _value(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
