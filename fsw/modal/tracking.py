"""Which mode is which, from one estimate to the next: a mode keeps its number."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fsw.modal.indicators import shape_assurance
from fsw.modal.result import ComplexArray, Mode

SAME_FREQUENCY = 0.005
"""Share by which a mode's frequency may differ from one estimate to the next, whatever its shape."""
SAME_MODE = 0.1
"""Share by which it may differ if the shape is the same: fuel spent or a hinge that gives moves all frequencies."""
SAME_SHAPE = 0.9
"""Least shape assurance of one shape, seen twice."""
DEVIATIONS = 3.0
"""Standard deviations of both estimates that are no difference."""
PATIENCE = 60
"""Estimates in a row without a mode that leave its slot free; of what was never clean, one."""
# What is added to a pair's distance in frequency, 0 to 1, if its shapes are at right angles, if the mode has flags, and
# if only the shape speaks for it.
_OTHER_SHAPE, _FLAGGED, _MOVED = 2.0, 0.5, 4.0


@dataclass(frozen=True)
class Holder:
    """The mode that a slot belongs to, as it was last seen.

    shape (M,), NaN where a channel was not used; clean: it was once without a flag; absent: estimates in a row without
    it.
    """

    frequency_hz: float
    frequency_sigma_hz: float
    shape: ComplexArray
    clean: bool
    absent: int = 0


Holders = tuple[Holder | None, ...]


def assign_slots(modes: Sequence[Mode], holders: Holders) -> tuple[tuple[int, ...], Holders]:
    """Slots of the modes (in order of frequency), and who holds them from now on.

    modes: no more than there are slots, their shapes (M,) over the same channels in each estimate. A mode that is like
    the holder of a slot takes that slot, the likest pair first; another one takes the lowest free slot, or if there is
    none that of the holder which has been absent for longest. An estimate without modes says nothing of any.
    """
    if not modes:
        return (), holders
    slots = _kept(modes, holders)
    after: list[Holder | None] = [
        None if holder is None else replace(holder, absent=holder.absent + 1) for holder in holders
    ]
    for j, slot in slots.items():
        after[slot] = _seen(modes[j], holders[slot])
    for slot, holder in enumerate(after):
        if holder is not None and holder.absent >= (PATIENCE if holder.clean else 1):
            after[slot] = None
    for j, mode in enumerate(modes):
        if j not in slots:
            slots[j] = min(range(len(after)), key=lambda slot: _wanted(after[slot]))
            after[slots[j]] = _seen(mode, None)
    return tuple(slots[j] for j in range(len(modes))), tuple(after)


def _kept(modes: Sequence[Mode], holders: Holders) -> dict[int, int]:
    """Slot of each mode that is like a holder: the likest pair first, no mode and no slot twice."""
    pairs = []
    for slot, holder in enumerate(holders):
        if holder is not None:
            for j, mode in enumerate(modes):
                cost = _difference(mode, holder)
                if cost is not None:
                    pairs.append((cost, j, slot))
    slots: dict[int, int] = {}
    for _, j, slot in sorted(pairs):
        if j not in slots and slot not in slots.values():
            slots[j] = slot
    return slots


def _difference(mode: Mode, holder: Holder) -> float | None:
    """How unlike a mode and a holder are; None: they are not one mode."""
    apart = abs(mode.frequency_hz - holder.frequency_hz)
    farthest = SAME_MODE * holder.frequency_hz
    sigma_hz = math.hypot(mode.frequency_sigma_hz, holder.frequency_sigma_hz)
    near = min(max(SAME_FREQUENCY * holder.frequency_hz, DEVIATIONS * sigma_hz), farthest)
    assurance = _assurance(mode.shape, holder.shape)
    if apart <= near:
        shape = 0.0 if assurance is None else _OTHER_SHAPE * (1.0 - assurance)
        return apart / near + shape + (_FLAGGED if mode.flags else 0.0)
    if apart <= farthest and assurance is not None and assurance >= SAME_SHAPE and not mode.flags:
        return apart / farthest + _MOVED
    return None


def _assurance(a: ComplexArray, b: ComplexArray) -> float | None:
    """Shape assurance over the channels that both have; None if there are none."""
    there = np.isfinite(a) & np.isfinite(b)
    return shape_assurance(a[there], b[there]) if there.any() else None


def _seen(mode: Mode, before: Holder | None) -> Holder:
    """Who holds the slot of a mode. A shape that was clean is not lost to one that is not."""
    clean = not mode.flags
    shape = before.shape if before is not None and before.clean and not clean else mode.shape
    return Holder(mode.frequency_hz, mode.frequency_sigma_hz, shape, clean or (before is not None and before.clean))


def _wanted(holder: Holder | None) -> tuple[bool, int]:
    """Order in which a new mode takes slots: free ones from the lowest, then the one that was left longest ago."""
    return (False, 0) if holder is None else (True, -holder.absent)
