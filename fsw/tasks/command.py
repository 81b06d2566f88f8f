"""command: what the ground asks for, checked, carried out and answered. The first task of a tick."""

from fsw.commands.desk import Desk
from fsw.commands.ground_link import GroundLink
from fsw.commands.handlers import Answer, Handlers
from fsw.commands.replies import Replies
from fsw.tables.bank import TableBank
from fsw.tasks.state import State
from hal.bus import Bus
from hal.link import Link
from telemetry.commands import UPLINK_IDS, Command, Piece, Request, decode_uplink
from telemetry.dictionary import CommandResult

A_TICK = 16
"""Frames that are taken in one tick from each line, at most; more wait on it."""
NAN = float("nan")


class CommandTask:
    """Takes frames from the bus, and messages from the link. Each one that is addressed to it counts once, as accepted
    or as rejected.

    A command has one event and one answer besides. The frame that came last, again, is answered as before, and is
    not carried out again. A rejected one changes nothing but the counters. Pieces of a table have no event and no
    answer of their own if they fit: TABLE_VALIDATE answers for all of them.
    """

    name = "command"

    def __init__(
        self,
        state: State,
        bus: Bus | None,
        handlers: Handlers,
        bank: TableBank,
        replies: Replies,
        arm_ticks: int,
        link: Link | None = None,
    ) -> None:
        self._bus, self._bank, self._replies = bus, bank, replies
        self.desk = Desk(state, handlers, arm_ticks)
        self.ground = GroundLink(state, link, self.desk, bank, replies)
        self._last: tuple[Request, Answer] | None = None

    def init(self) -> None:
        """The counters start at 0."""
        self.desk.init()

    def run(self, tick: int, time_ns: int) -> None:
        """Take what waits on the bus and on the link."""
        self._from_bus(tick)
        self.ground.run(tick, A_TICK)

    def _from_bus(self, tick: int) -> None:
        if self._bus is None:
            return
        for _ in range(A_TICK):
            frame = self._bus.receive()
            if frame is None:
                return
            if frame[0] in UPLINK_IDS:
                self.take(*frame, tick)

    def take(self, can_id: int, data: bytes, tick: int) -> None:
        """One frame under an identifier of ours."""
        asked = decode_uplink(can_id, data)
        if isinstance(asked, CommandResult):
            self._reject(NAN, NAN, NAN, Answer(asked))
        elif isinstance(asked, Piece):
            self._piece(asked)
        else:
            self._request(asked, tick)

    def _piece(self, piece: Piece) -> None:
        if self._bank.upload.put(piece.chunk, piece.data):
            self.desk.count(accepted=True)
        else:
            self._reject(Command.TABLE_LOAD, NAN, NAN, Answer(CommandResult.BAD_ARGUMENT, piece.chunk))

    def _request(self, request: Request, tick: int) -> None:
        if self._last is not None and self._last[0] == request:
            answer = self._last[1]
        else:
            answer = self.desk.carry_out(request, tick)
            self._last = request, answer
        if answer.result is not CommandResult.ACCEPTED:
            self._reject(request.number, request.selector, request.sequence, answer)
            return
        self.desk.accept(request)
        self._replies.acknowledge(request.number, answer.result, request.sequence, answer.detail)

    def _reject(self, number: float, selector: float, sequence: float, answer: Answer) -> None:
        self.desk.reject(number, selector, answer)
        self._replies.acknowledge(number, answer.result, sequence, answer.detail)
