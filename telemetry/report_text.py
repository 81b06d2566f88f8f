"""Words and tables of the report: the verdict, the modes with their intervals, and what stands beside them."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from telemetry.dictionary import ModeFlag
from telemetry.events import named_text
from telemetry.modes_text import INTERVAL

Modes = Sequence[Mapping[str, Any]]
Truth = Mapping[int, Mapping[str, float]]

FLAG_WORDS = {
    "harmonic": "forced line: almost no damping",
    "time_varying": "frequency changes within the record",
    "near_nyquist": "too near half the frame rate",
    "not_observable": "the wing hardly moves",
    "short_record": "record too short",
    "incoherent": "not one coherent vibration",
    "weak": "not above the noise",
    "imprecise": "interval too wide",
    "overdamped": "more damping than a wing has",
    "growing": "grows instead of decaying",
    "not_exponential": "does not decay exponentially",
    "combination": "combination of other modes",
    "split": "one mode seen as two",
    "unconfirmed": "not found twice in a row",
    "close_pair": "beside another mode, nearer than the record resolves",
    "low_coherence": "amplitude coherence below its limit",
    "poor_scene": "scene or match below its limit",
    "stale": "too old",
    "late": "came too late",
    "held": "last good value, held",
    "saturated": "outside the range that can be sent",
    "other": "other",
}
MOST_EVENTS = 200
MOST_DIGITS = 6  # behind the point

PAPER = {"error_mm": 0.937, "frequency_error": 0.0282, "points": 3}
"""The source paper's own result: mean error against motion capture, error of the first frequency, points followed."""


@dataclass(frozen=True)
class Table:
    """Rows of text under a head; rows in `quiet` are shown pale."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    quiet: frozenset[int] = frozenset()


def words(flags: Iterable[str]) -> str:
    """Flags in words."""
    return "; ".join(FLAG_WORDS.get(flag, flag.replace("_", " ")) for flag in flags)


def interval(value: float | None, sigma: float | None, scale: float = 1.0) -> str:
    """Value and half width of its 95 % interval, rounded up to two digits; a dash where there is no value."""
    if value is None:
        return "–"
    if sigma is None or not sigma > 0.0:
        return f"{value * scale:.5g}"
    half = INTERVAL * sigma * scale
    digits = min(max(1 - math.floor(math.log10(half)), 0), MOST_DIGITS)
    half = math.ceil(half * 10**digits) / 10**digits
    return f"{value * scale:.{digits}f} ± {half:.{digits}f}"


def error(value: float, truth: float) -> str:
    """Relative error in per cent with its sign and two digits; what is next to nothing is called less than a bound."""
    percent = 100.0 * (value / truth - 1.0)
    if abs(percent) < 1e-4:
        return "< 0.0001 %"
    return f"{percent:+.{min(max(1 - math.floor(math.log10(abs(percent))), 0), 4)}f} %"


def verdict(modes: Mapping[str, Any], truth: Truth, measured: int | None) -> str:
    """One sentence: what may be believed. measured: ticks in which the wing was measured, None if not known."""
    valid = [(place, mode) for place, mode in enumerate(modes["modes"]) if mode["valid"]]
    if not valid:
        return f"No valid mode: {_why_none(modes, measured)}."
    place, first = valid[0]
    sentence = f"{len(valid)} valid modes, the lowest at " if len(valid) > 1 else "1 valid mode, at "
    sentence += f"{interval(first['frequency_hz'], first['frequency_sigma_hz'])} Hz"
    if place in truth:
        sentence += f" ({error(first['frequency_hz'], truth[place]['frequency_hz'])} from the truth)"
    held = modes.get("estimate", {}).get("held", False)
    return sentence + ("; held from an earlier estimate." if held else ".")


def _why_none(modes: Mapping[str, Any], measured: int | None) -> str:
    if measured == 0:
        return "the wing was not measured in any tick"
    if modes["modes"]:
        reasons = dict.fromkeys(flag for mode in modes["modes"] for flag in mode["flags"])
        return f"{len(modes['modes'])} found, none passes all gates ({words(reasons) or 'not confirmed'})"
    return words(modes["flags"]) or "no estimate was made; the record may be too short"


def modes_rows(modes: Modes, truth: Truth, unit: str) -> Table:
    """The modes with 95 % intervals; where a truth is known, it stands below with the error."""
    rows = [
        (
            str(place + 1),
            _beside(mode, truth, place, "frequency_hz", 1.0),
            _beside(mode, truth, place, "damping_ratio", 100.0),
            _figure(mode["amplitude_mm"], ".3f"),
            _figure(mode["amplitude_coherence"], ".4f"),
            ("valid" if mode["valid"] else "not valid") + (f": {words(mode['flags'])}" if mode["flags"] else ""),
        )
        for place, mode in enumerate(modes)
    ]
    head = ("mode", "frequency / Hz", "damping / %", f"amplitude / {unit}", "coherence", "state")
    return Table(head, rows, frozenset(n for n, mode in enumerate(modes) if not mode["valid"]))


def _beside(mode: Mapping[str, Any], truth: Truth, place: int, name: str, scale: float) -> str:
    """A value with its interval, and on the next line the truth."""
    sigma = mode["frequency_sigma_hz" if name == "frequency_hz" else f"{name}_sigma"]
    text = interval(mode[name], sigma, scale)
    if not truth:
        return text
    if place not in truth:
        return f"{text}\nno true mode near it"
    known = truth[place][name]
    text += f"\ntrue {known * scale:.6g}"
    return text if mode[name] is None or not known else f"{text}, error {error(mode[name], known)}"


def missed_sentence(true_modes: Modes, truth: Truth) -> str:
    """The true modes that were not found, in one sentence; empty if there are none."""
    found = [mode["frequency_hz"] for mode in truth.values()]
    missed = [f"{mode['frequency_hz']:.4f} Hz" for mode in true_modes if mode["frequency_hz"] not in found]
    return f" Not found: the true mode{'s' if len(missed) > 1 else ''} at {', '.join(missed)}." if missed else ""


def paper_rows(modes: Modes, truth: Truth, against: Mapping[str, float]) -> Table:
    """This run beside the figures of the source paper."""
    first = min(truth, key=lambda place: truth[place]["frequency_hz"], default=None)
    frequency = damping = "no valid mode"
    if first is not None and modes[first]["valid"]:
        frequency = error(modes[first]["frequency_hz"], truth[first]["frequency_hz"])
        ratio, known = modes[first]["damping_ratio"], truth[first]["damping_ratio"]
        damping = error(ratio, known) if ratio is not None and known else "not given"
    rows = [
        ("error of displacement", _figure(against.get("displacement_rms_mm"), ".4f", " mm rms"),
         f"{PAPER['error_mm']} mm mean"),
        ("error of the first frequency", frequency, f"{100 * PAPER['frequency_error']:.2f} %"),
        ("error of its damping", damping, "damping not identified"),
        ("modes identified", str(sum(bool(mode["valid"]) for mode in modes)), "1"),
        ("points followed", str(int(against.get("cells", 0))), str(PAPER["points"])),
    ]  # fmt: skip
    return Table(("", "this run, against its world's truth", "the paper, against motion capture"), rows)


def event_rows(events: Sequence[Mapping[str, Any]], start_s: float) -> tuple[Table, str]:
    """The events as sentences, the first MOST_EVENTS of them, and a sentence on how many there are."""
    rows = [
        (_seconds(e["time_s"], start_s), e["severity"].lower(), e["name"], _event_sentence(e))
        for e in events[:MOST_EVENTS]
    ]
    counts = Counter(event["severity"] for event in events)
    said = ", ".join(f"{count} {severity.lower()}" for severity, count in sorted(counts.items())) or "none"
    more = f" The first {MOST_EVENTS} are shown; all are in events.jsonl." if len(events) > MOST_EVENTS else ""
    quiet = frozenset(n for n, e in enumerate(events[:MOST_EVENTS]) if e["severity"] in ("INFO", "DIAGNOSTIC"))
    return Table(("time / s", "severity", "event", "what happened"), rows, quiet), f"Events: {said}.{more}"


def _event_sentence(event: Mapping[str, Any]) -> str:
    """What happened; flags are also put in words."""
    bits = event["arguments"].get("flags")
    names = [flag.name.lower() for flag in ModeFlag(int(bits)) if flag.name] if bits else []
    return named_text(event["event"], event["arguments"]) + (f" ({words(names)})" if names else "")


def timing_rows(cpu_ms: Mapping[str, Mapping[str, float | None]]) -> Table:
    """Thread-CPU time of each task."""
    rows = [
        (
            task,
            str(int(figures["runs"] or 0)),
            *(_figure(figures[name], ".2f") for name in ("mean", "p50", "p99", "max")),
        )
        for task, figures in cpu_ms.items()
    ]
    return Table(("task", "runs", "mean / ms", "50 % within / ms", "99 % within / ms", "largest / ms"), rows)


def drop_sentence(summary: Mapping[str, Any]) -> str:
    """What was lost on the way, in one sentence; what the summary does not tell is left out."""
    said = []
    if "ticks" in summary:
        measured = summary.get("ticks_measured")
        said.append(
            f"{summary['ticks']} ticks" + (f", the wing measured in {measured}" if measured is not None else "")
        )
    if "ticks_missed" in summary:
        said.append(f"{summary['ticks_missed']} missed")
    if "drops" in summary:
        drops = summary["drops"]
        causes = ", ".join(f"{count} {cause}" for cause, count in drops.items() if count)
        said.append(f"pairs dropped: {causes}" if causes else "no pair dropped")
    if "overruns" in summary:
        said.append(f"{summary['overruns']} overruns")
    return "; ".join(said) + "." if said else ""


def _seconds(time_s: float | None, start_s: float) -> str:
    return "–" if time_s is None else f"{time_s - start_s:.3f}"


def _figure(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else format(value, form) + unit
