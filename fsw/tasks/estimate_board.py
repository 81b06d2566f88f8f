"""An estimate on the board: each mode in its slot, and what the limits on estimates need."""

import math
from collections.abc import Sequence

from fsw.modal.result import Mode
from fsw.modal.tracking import SAME_MODE
from fsw.tasks.state import Estimate, State
from telemetry.dictionary import (
    AMPLITUDE_COHERENCE,
    AMPLITUDE_MM,
    DAMPING_RATIO,
    DAMPING_RATIO_SIGMA,
    ESTIMATE_FLAGS,
    ESTIMATE_TICK,
    ESTIMATE_TIME_US,
    FREQUENCY_HZ,
    FREQUENCY_JUMP,
    FREQUENCY_SIGMA_HZ,
    FREQUENCY_UNCERTAINTY,
    IDENTIFIED_FLAGS,
    MODE_COUNT,
    MODE_SLOTS,
    OBSERVABLE,
    RECORD_SAMPLES,
    flag_bits,
)

NAN = float("nan")


def show(state: State, estimate: Estimate, before: Estimate | None = None) -> None:
    """Put an estimate's values on the board; whether they are valid is for protect to say.

    before: the estimate delivered before, to which its frequencies are compared.
    """
    state.shown = estimate
    board, result = state.board, estimate.result
    board.set(ESTIMATE_TICK, estimate.tick)
    board.set(ESTIMATE_TIME_US, estimate.time_ns // 1000)
    board.set(MODE_COUNT, len(result.modes))
    board.set(RECORD_SAMPLES, result.record.samples)
    board.set(ESTIMATE_FLAGS, flag_bits(result.flags))
    board.set(OBSERVABLE, 0.0 if "not_observable" in result.flags else 1.0)
    for slot in range(MODE_SLOTS):
        mode = estimate.in_slot(slot)
        board.set(FREQUENCY_HZ, mode.frequency_hz if mode else NAN, slot)
        board.set(FREQUENCY_SIGMA_HZ, mode.frequency_sigma_hz if mode else NAN, slot)
        board.set(DAMPING_RATIO, mode.damping_ratio if mode else NAN, slot)
        board.set(DAMPING_RATIO_SIGMA, mode.damping_ratio_sigma if mode else NAN, slot)
        board.set(AMPLITUDE_MM, mode.amplitude if mode else NAN, slot)
        board.set(AMPLITUDE_COHERENCE, mode.amplitude_coherence if mode else NAN, slot)
        board.set(IDENTIFIED_FLAGS, flag_bits(mode.flags) if mode else NAN, slot)
        board.set(FREQUENCY_UNCERTAINTY, mode.frequency_sigma_hz / mode.frequency_hz if mode else NAN, slot)
        board.set(FREQUENCY_JUMP, frequency_jump(mode, predecessors(slot, estimate, before)) if mode else NAN, slot)


def predecessors(slot: int, estimate: Estimate, before: Estimate | None) -> list[Mode]:
    """Valid modes of the estimate before that the mode in a slot may have been: the one in that slot, or else those
    whose slots are empty now.
    """
    if before is None:
        return []
    own = before.in_slot(slot)
    if own is not None and own.valid:
        return [own]
    return [
        mode
        for mode, place in zip(before.result.modes, before.slots, strict=True)
        if mode.valid and place not in estimate.slots
    ]


def frequency_jump(mode: Mode, before: Sequence[Mode]) -> float:
    """Change of a frequency against the nearest of the modes before, beyond 3 sigma of both, as a share of it.

    0 where none of them may be the same mode.
    """
    near = [other for other in before if abs(other.frequency_hz - mode.frequency_hz) < SAME_MODE * mode.frequency_hz]
    if not near:
        return 0.0
    nearest = min(near, key=lambda other: abs(other.frequency_hz - mode.frequency_hz))
    sigma_hz = math.hypot(mode.frequency_sigma_hz, nearest.frequency_sigma_hz)
    return max(0.0, abs(mode.frequency_hz - nearest.frequency_hz) - 3.0 * sigma_hz) / mode.frequency_hz
