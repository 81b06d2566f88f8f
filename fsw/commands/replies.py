"""Answers on their way down: packets on demand, in a bounded queue; publish sends a few of them a tick."""

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice

from telemetry.board import Board
from telemetry.declaration import Packet
from telemetry.dictionary import ACK_PACKET, DUMP_PACKET, DUMP_WORDS
from telemetry.mavlink_uplink import Answered

PLACES = 64
"""Answers that wait. Full: the newest one is not taken, and that is counted."""
A_TICK = 20
"""Answers that are sent in one tick, at most: sixteen commands have theirs."""
DUMPS_A_TICK = 2
LISTED_A_TICK = 4
"""Parameters of a list that are sent in one tick."""
WORD_BYTES = 6
PIECE_BYTES = WORD_BYTES * len(DUMP_WORDS)


class Replies:
    """Acknowledgements and timings, in order; and one table at a time on its way down, in pieces.

    Answers to a MAVLink line have a queue of their own; a list of all parameters goes down a few a tick.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._waiting: deque[tuple[Packet, tuple[float, ...]]] = deque(maxlen=PLACES)
        self._answers: deque[Answered] = deque(maxlen=PLACES)
        self._list: Iterator[Answered] = iter(())
        self._board = Board()
        self._table, self._image, self._at = 0, b"", 0

    def add(self, packet: Packet, values: Sequence[float]) -> None:
        """Queue a packet; values: of its points, in order."""
        if len(self._waiting) == PLACES:
            self.lost += 1
        else:
            self._waiting.append((packet, tuple(values)))

    def acknowledge(self, command: float, result: int, sequence: float, detail: int) -> None:
        """Queue the answer to a command."""
        self.add(ACK_PACKET, (command, result, sequence, detail))

    def answer(self, answer: Answered) -> None:
        """Queue an answer to the MAVLink line."""
        if len(self._answers) == PLACES:
            self.lost += 1
        else:
            self._answers.append(answer)

    def show_all(self, answers: Iterator[Answered]) -> None:
        """Answer with a list, a few a tick; it takes the place of one that is under way."""
        self._list = answers

    def answers(self) -> Iterator[Answered]:
        """What is to be sent on the MAVLink line in this tick."""
        for _ in range(min(A_TICK, len(self._answers))):
            yield self._answers.popleft()
        yield from islice(self._list, LISTED_A_TICK)

    @property
    def dumping(self) -> bool:
        """A table is on its way down."""
        return self._at < len(self._image)

    def dump(self, table: int, image: bytes | bytearray) -> bool:
        """Send this image from the next tick on; False while another one is on its way."""
        if self.dumping:
            return False
        self._table, self._image, self._at = table, bytes(image), 0
        return True

    def due(self) -> Iterator[tuple[Packet, Board]]:
        """What is to be sent in this tick; the board holds the packet's values until the next one is taken."""
        for _ in range(min(A_TICK, len(self._waiting))):
            yield self._filled(*self._waiting.popleft())
        for _ in range(DUMPS_A_TICK):
            if not self.dumping:
                break
            piece = self._image[self._at : self._at + PIECE_BYTES].ljust(PIECE_BYTES, b"\0")
            words = [int.from_bytes(piece[i : i + WORD_BYTES], "little") for i in range(0, PIECE_BYTES, WORD_BYTES)]
            values = (self._table, self._at, len(self._image), *words)
            self._at += PIECE_BYTES
            yield self._filled(DUMP_PACKET, tuple(map(float, values)))

    def _filled(self, packet: Packet, values: tuple[float, ...]) -> tuple[Packet, Board]:
        for point, value in zip(packet.points, values, strict=True):
            self._board.set(point, value)
        return packet, self._board
