"""`wingbeat replay black_box_001.mcap`: make the decisions of a black box again, and compare them to the bit."""

import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from fault.limits import Limit, faults_in
from fault.modes import Cause
from fault.protection import Protection
from fault.watch import Bank
from fsw.black_box import BlackBox
from hal.store import FileStore
from telemetry.black_box_file import ROW_EVENTS, Header, decision, read_black_box
from telemetry.board import OFFSET, Board
from telemetry.dictionary import POINTS
from telemetry.events import event_text
from wingbeat.errors import InputError

DECISIONS = "decisions.jsonl"


class Replayed(NamedTuple):
    """Decisions made again, one a tick, and where they first differ from the recorded ones; empty if nowhere."""

    decisions: list[dict[str, Any]]
    difference: str


def replay_black_box(path: Path, out: Path | None = None) -> Replayed:
    """Make all decisions of this file again; with `out`, write them to decisions.jsonl in that folder.

    Raises InputError: see read_black_box; limits or a state that cannot be; a folder that cannot be written.
    """
    header, rows = read_black_box(path)
    limits, shadow = (_limits(header, name, path) for name in ("limits", "shadow"))
    if Protection(limits, shadow).size != rows.dtype["state"].shape[0]:
        raise InputError("has states of another size than its limits need", path, "use the version that wrote it")
    decisions, first = [], ""
    try:
        for recorded, replayed in zip(rows, decide_again(limits, shadow, rows), strict=True):
            differs = difference(recorded, replayed)
            first = first or differs
            decisions.append(decision(replayed) | {"reproduced": not differs})
    except (ValueError, OverflowError):
        tick = int(rows["tick"][len(decisions)])
        raise InputError(f"tick {tick}: holds numbers that protection cannot have", path, "is it damaged?") from None
    if out is not None:
        FileStore(out).write(DECISIONS, b"".join(json.dumps(made).encode() + b"\n" for made in decisions))
    return Replayed(decisions, first)


def decide_again(limits: Sequence[Limit], shadow: Sequence[Limit], rows: NDArray[np.void]) -> Iterator[np.void]:
    """The rows (ticks,) as this protection makes them, each one good until the next.

    It starts from the first row's state, and goes on by itself; what it is given is the board before each decision,
    the causes, and what commands changed between the ticks: limits switched, and clearings granted.
    """
    protection, board = Protection(limits, shadow), Board()
    state = rows["state"][0].copy()
    commanded = commanded_places(limits, shadow, protection.size)
    box = BlackBox(limits, shadow, ticks=1, after_ticks=0)
    box.on = False
    for row in rows:
        state[commanded] = row["state"][commanded]
        protection.restore(state)
        np.copyto(board.values, row["before"])
        tick, causes = int(row["tick"]), Cause(int(row["causes"]))
        new_frame, new_estimate = bool(row["new_frame"]), bool(row["new_estimate"])
        box.before(tick, int(row["time_ns"]), board, causes, new_frame, new_estimate, protection)
        box.after(board, protection.step(board, tick, causes, new_frame, new_estimate))
        protection.save(state)
        yield box.newest


def commanded_places(limits: Sequence[Limit], shadow: Sequence[Limit], size: int) -> list[int]:
    """Where in a protection's state (size,) commands write: of each limit, whether it is off, and is to be cleared.

    The states of the limits stand behind all else in it, and those of the shadow limits behind them.
    """
    bank = Bank(limits)
    start = size - Bank(shadow).size - bank.size
    places: list[int] = []
    for watch in bank.watches:
        places += (start, start + 1)
        start += watch.size
    return places


def difference(recorded: np.void, replayed: np.void) -> str:
    """The first difference of two rows, in words; empty if they are the same to the bit."""
    if recorded.tobytes() == replayed.tobytes():
        return ""
    tick = int(recorded["tick"])
    for name, what in _NUMBERS:
        for place, (was, now) in enumerate(zip(recorded[name], replayed[name], strict=True)):
            if was.tobytes() != now.tobytes():
                which = _point(place) if name != "state" else f"number {place}"
                return f"tick {tick}: {which} of {what} is {now:.17g}, recorded was {was:.17g}"
    return f"tick {tick}: raised {_events(replayed)}, recorded was {_events(recorded)}"


_NUMBERS = (("state", "the state before it"), ("after", "the board after it"))


def _point(place: int) -> str:
    """The point, and its slot if it has several, at this place of the board."""
    point = next(point for point in reversed(POINTS) if OFFSET[point.name] <= place)
    return point.name if point.slots == 1 else f"{point.name}[{place - OFFSET[point.name]}]"


def _events(row: np.void) -> str:
    """The events of a row in words."""
    count = min(int(row["raised"]), ROW_EVENTS)
    raised = zip(row["event"].tolist(), row["argument"].tolist(), strict=True)
    texts = [event_text(number, arguments) for number, arguments in islice(raised, count)]
    return "; ".join(texts) or "nothing"


def _limits(header: Header, name: str, path: Path) -> list[Limit]:
    """The limits that the header holds."""
    try:
        limits = msgspec.convert(header.get(name), list[Limit])
    except msgspec.ValidationError as error:
        raise InputError(f"{name}: {error}", path, "use the version that wrote it") from None
    if problem := faults_in(limits):
        raise InputError(problem, path, "use the version that wrote it")
    return limits
