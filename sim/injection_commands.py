"""Faults on the command line: noise, and tables that must never become active."""

from collections.abc import Sequence

from sim.injection import Injection, Stage
from sim.injection_memory import MomentFault
from telemetry.commands import TABLE_DATA_ID, UPLINK_IDS, Piece, decode_uplink, encode_piece
from telemetry.uplink import Frame, frames_of, request_of, upload_of

BAD_TABLES = (
    ("VISION", "[vision]\nleast_cells = -5\n"),  # out of its range
    ("VISION", "[vision]\nleast_celss = 12\n"),  # no such key
    ("IDENTIFY", "[identify]\nleast_ticks = 400\nhistory_ticks = 100\n"),  # against itself
    ("SCHEDULE", '[[schedule]]\ntask = "acquire"\nbudget_ms = 4.0\n'),  # the flight needs more tasks
    ("LIMITS", "[[limit]]\nnumber = 1\n"),  # half a row
    ("IDENTIFY", "[vision]\nleast_cells = 12\n"),  # another table
    ("EXECUTIVE", "no table at all"),
)
GOOD_TABLE = ("VISION", "[vision]\nleast_cells = 14\n")  # until it is damaged on its way


class CommandGarbage(Injection):
    """Frames of noise, and commands with one bit changed, a few in each tick."""

    LASTS = (1, 12)

    def before(self, stage: Stage, tick: int) -> None:
        if self.active(tick):
            for _ in range(int(self.draw.integers(1, 5))):
                stage.bus.uplink.append(self._noise() if self.draw.integers(2) else self._changed())

    def _noise(self) -> Frame:
        size = int(self.draw.integers(0, 9))
        return int(self.draw.choice(UPLINK_IDS)), self.draw.bytes(size)

    def _changed(self) -> Frame:
        """The command that would end the measuring, with a bit changed."""
        ((can_id, data),) = frames_of([request_of("SET_MODE", "INHIBITED")], int(self.draw.integers(256)))
        changed = bytearray(data)
        bit = int(self.draw.integers(8 * len(changed)))
        changed[bit // 8] ^= 1 << bit % 8
        return can_id, bytes(changed)


class TableGarbage(MomentFault):
    """A table that makes no sense, or one that was damaged on its way up; and the command to go by it all the same."""

    def happen(self, stage: Stage, tick: int) -> None:
        way = int(self.draw.integers(len(BAD_TABLES) + 2))
        damaged = way >= len(BAD_TABLES)
        name, text = GOOD_TABLE if damaged else BAD_TABLES[way]
        file = stage.store.folder / "upload.toml"
        file.write_text(text, encoding="utf-8")
        frames = upload_of("TABLE_LOAD", name, file)
        if damaged:
            frames = self._damaged(frames, lost=way > len(BAD_TABLES))
        stage.bus.uplink.extend([*frames, *frames_of([request_of("TABLE_ACTIVATE", value=0x3F)], len(frames))])

    def _damaged(self, frames: Sequence[Frame], lost: bool) -> list[Frame]:
        """One piece does not come, or two have changed places on the ground."""
        pieces = [place for place, (can_id, _) in enumerate(frames) if can_id == TABLE_DATA_ID]
        changed = list(frames)
        if lost:
            del changed[int(self.draw.choice(pieces))]
        else:
            _swap(changed, pieces[0], pieces[1])
        return changed


def _swap(frames: list[Frame], a: int, b: int) -> None:
    """Each of two pieces comes with the number of the other one."""
    first, second = decode_uplink(*frames[a]), decode_uplink(*frames[b])
    assert isinstance(first, Piece) and isinstance(second, Piece)
    frames[a] = (frames[a][0], encode_piece(Piece(first.chunk, second.data), frames[a][1][6]))
    frames[b] = (frames[b][0], encode_piece(Piece(second.chunk, first.data), frames[b][1][6]))
