"""Rows of what spoils records: dropped frames, jitter, moving frequencies, lamps, aliases, and pairs."""

from collections.abc import Callable, Sequence

import numpy as np

from fsw.modal.pipeline import identify
from fsw.modal.result import ModalResult
from sim.bench.modal_bounds import cramer_rao
from sim.bench.modal_broken import BREAKS, broken, misleads
from sim.bench.modal_records import DAMPING, DECAYS, FloatArray, free_decay, moving, published
from sim.bench.table import Row

_LAMP_HZ, _LAMP_MM = 1.7, 0.8
_MODES = DECAYS["D2"][0]


def cases(runs: int, seed: int) -> list[Callable[[], Sequence[Row]]]:
    """One case a disturbance; each is one row."""
    seeds = range(seed, seed + runs)
    return [
        lambda: [_against_clean("10 % of frames dropped", _dropped, seeds)],
        lambda: [_against_clean("jitter of 10 ms", _jittered, seeds)],
        lambda: [_share("ramp of -3 % in 20 s", "time_varying", lambda s: _ramp(s, -0.03), seeds)],
        lambda: [_share("steady, 20 s", "time_varying", lambda s: _ramp(s, 0.0), seeds)],
        lambda: [_share("ambient, ramp of -3 % in 120 s", "time_varying", lambda s: _ambient_ramp(s, -0.03), seeds)],
        lambda: [_share("ambient, steady", "time_varying", lambda s: _ambient_ramp(s, 0.0), seeds)],
        lambda: [_share("lamp at 1.7 Hz", "harmonic", _lamp, seeds)],
        lambda: [_share("4.2 Hz at 8 frames a second", "near_nyquist", _alias, seeds)],
        *(
            lambda kind=kind, motion=motion: [_broken(kind, motion, seeds)]
            for motion in ("decay", "ambient")
            for kind in BREAKS
        ),
    ]


def _dropped(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    keep = rng.uniform(size=len(time_s)) > 0.1
    keep[0] = True
    return time_s[keep]


def _jittered(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    moved = time_s + rng.uniform(-0.01, 0.01, len(time_s))
    return moved - moved[0]


def _against_clean(
    case: str, change: Callable[[FloatArray, np.random.Generator], FloatArray], seeds: Sequence[int]
) -> Row:
    """Errors of D2 with disturbed but true time stamps, over those of the clean record."""
    errors: dict[str, list[FloatArray]] = {"clean": [], "changed": []}
    missed = spurious = 0
    for seed in seeds:
        records = {
            "clean": published("D2", seed),
            "changed": published("D2", seed, lambda t, s=seed: change(t, np.random.default_rng([s, 1]))),
        }
        bound = cramer_rao(records["clean"])
        for name, record in records.items():
            valid = identify(record.time_s, record.noisy).valid_modes
            for j, f in enumerate(record.frequency_hz):
                near = [mode for mode in valid if abs(mode.frequency_hz - f) < 0.02 * f]
                missed += name == "changed" and not near
                if near:
                    error = np.array([near[0].frequency_hz - f, near[0].damping_ratio - DAMPING]) / bound[j]
                    errors[name].append(np.abs(error))
            spurious += name == "changed" and len(valid) > len(record.frequency_hz)
    clean, changed = (np.sqrt(np.mean(np.array(errors[name]) ** 2, axis=0)) for name in ("clean", "changed"))
    return {
        "table": "robust",
        "method": "wingbeat",
        "case": case,
        "records": len(seeds),
        "frequency_error_over_clean": float(changed[0] / clean[0]),
        "damping_error_over_clean": float(changed[1] / clean[1]),
        "missed": int(missed),
        "spurious_a_record": spurious / len(seeds),
    }


def _share(case: str, flag: str, made: Callable[[int], tuple[ModalResult, float]], seeds: Sequence[int]) -> Row:
    """How often a record raises a flag, and how often a mode that should carry it is called valid."""
    raised = misleading = 0
    for seed in seeds:
        found, hz = made(seed)
        raised += flag in found.flags or any(flag in mode.flags for mode in found.modes)
        misleading += any(abs(mode.frequency_hz - hz) < 0.02 * hz for mode in found.valid_modes)
    return {
        "table": "robust",
        "method": "wingbeat",
        "case": case,
        "records": len(seeds),
        "flag": flag,
        "raised_percent": 100.0 * raised / len(seeds),
        "misleading": misleading,
    }


def _broken(kind: str, motion: str, seeds: Sequence[int]) -> Row:
    """How often a record that breaks is cut, misleads, and still gives all of its modes."""
    cut = misleading = whole = 0
    for seed in seeds:
        record = broken(kind, motion, seed)
        found = identify(record.time_s, record.y)
        cut += "cut_at_break" in found.flags
        misleading += misleads(record.frequency_hz, found)
        whole += len(found.valid_modes) == len(record.frequency_hz)
    return {
        "table": "robust",
        "method": "wingbeat",
        "case": f"{motion} {kind} in the middle",
        "records": len(seeds),
        "flag": "cut_at_break",
        "raised_percent": 100.0 * cut / len(seeds),
        "misleading": misleading,
        "all_modes_percent": 100.0 * whole / len(seeds),
    }


def _ramp(seed: int, change: float) -> tuple[ModalResult, float]:
    """All frequencies move by a share of themselves; none of them may then be valid."""
    time_s = np.arange(400) / 20.0
    record = free_decay(_MODES, time_s, (5, 4), 0.2, seed, change)
    return identify(time_s, record.noisy), (_MODES["B1"] if change else np.inf)


def _ambient_ramp(seed: int, change: float) -> tuple[ModalResult, float]:
    """The same of a stationary response, of even seeds without and of odd ones with the close pair."""
    time_s, y = moving(("A1", "A2")[seed % 2], seed, change)
    return identify(time_s, y), (_MODES["T1"] if change else np.inf)


def _lamp(seed: int) -> tuple[ModalResult, float]:
    record = published("D2", seed)
    line = _LAMP_MM * np.cos(2.0 * np.pi * _LAMP_HZ * record.time_s + seed)
    return identify(record.time_s, record.noisy + line[:, None] * np.linspace(0.2, 1.0, 20)), _LAMP_HZ


def _alias(seed: int) -> tuple[ModalResult, float]:
    time_s = np.arange(160) / 8.0
    record = free_decay({"B1": 0.72, "B2": 4.2}, time_s, (5, 4), 0.2, seed)
    return identify(time_s, record.noisy), 8.0 - 4.2
