"""Commands: each one with its effect, each refusal by its code, and noise that changes nothing."""

import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fault_parts import GOOD, limit
from flight_parts import Footage, flying, small
from hypothesis import given
from hypothesis import strategies as st

from fault.modes import Cause
from fault.protection import Protection
from fsw.commands.handlers import Handlers, tables_in
from fsw.commands.replies import A_TICK, DUMPS_A_TICK, PLACES, Replies
from fsw.executive.entry import Diagnostics
from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.tables.bank import TableBank
from fsw.tables.flight import load_flight
from fsw.tasks.command import CommandTask
from fsw.tasks.publish import Outlets
from fsw.tasks.state import Pair, State
from hal.bus import Payload
from telemetry.board import EventRecord
from telemetry.can_codec import decode_frame
from telemetry.commands import (
    COMMAND_ID,
    COMMANDS,
    TABLE_DATA_ID,
    UPLINK_IDS,
    Command,
    Piece,
    Request,
    decode_uplink,
    encode_command,
    encode_piece,
)
from telemetry.dictionary import (
    ACK_PACKET,
    ACK_RESULT,
    CMP,
    COMMANDS_ACCEPTED,
    COMMANDS_REJECTED,
    DUMP_OFFSET,
    DUMP_PACKET,
    DUMP_SIZE,
    DUMP_WORDS,
    TIMING_PACKET,
    CommandResult,
    FlightMode,
    TableFault,
)
from telemetry.events import EVENT_BY_NUMBER, TableNumber, TaskNumber

ACCEPTED, BAD = CommandResult.ACCEPTED, CommandResult.BAD_ARGUMENT
LIMITS = [limit(CMP, number=7, high_red=None, low_red=0.5, response="degrade", latch="latched")]
TOML = b"[vision]\nleast_cells = 20\n"


class Bus:
    """Both ends of a bus, in memory."""

    def __init__(self) -> None:
        self.up: list[tuple[int, bytes]] = []
        self.down: list[tuple[int, bytes]] = []

    def send(self, can_id: int, data: Payload, time_ns: int) -> bool:
        self.down.append((can_id, bytes(data)))
        return True

    def receive(self) -> tuple[int, bytes] | None:
        return self.up.pop(0) if self.up else None


class Tasks:
    """An executive that knows three tasks."""

    tasks = ("acquire", "identify", "black_box")

    def __init__(self) -> None:
        self.switched: list[tuple[str, bool]] = []

    def switch(self, task: str, on: bool) -> bool:
        if task in self.tasks:
            self.switched.append((task, on))
        return task in self.tasks

    def diagnostics(self, task: str) -> Diagnostics:
        assert task in self.tasks
        return Diagnostics(9, 1, 2, 3, 1.5, 1.0, 2.0, 1.6, 0.1, 0.3, tuple(range(16)), tuple(range(16)))


class Ground:
    """The command task with all that it acts on, and somebody who commands it."""

    def __init__(self, mode: FlightMode = FlightMode.TRACK) -> None:
        image = np.zeros((4, 4), np.uint8)
        self.state = State(None, Pair(image, image), Ring(4, (), np.int64), Displacements(4, 1))  # type: ignore[arg-type]
        for point, value in GOOD.items():
            self.state.board.set(point, value)
        self.state.mode = mode
        self.protection, self.bank = Protection(LIMITS), TableBank(load_flight(), lambda schedule: 0)
        self.protection.begin(self.state.board)
        self.tasks, self.replies, self.bus = Tasks(), Replies(), Bus()
        self.done: list[object] = []
        handlers = Handlers(
            self.state, lambda: self.tasks, self.protection, self.bank, self.replies,
            lambda: self.done.append("reset"), self.done.append, lambda: self.done.append("restart"),
        )  # fmt: skip
        self.task = CommandTask(self.state, self.bus, handlers, self.bank, self.replies, arm_ticks=10)
        self.task.init()
        self.tick = self.sequence = 0
        self.events: list[EventRecord] = []

    def send(self, command: int, selector: int = 0, value: int = 0, again: bool = False) -> tuple[CommandResult, int]:
        self.sequence = self.sequence if again else (self.sequence + 1) % 256
        return self.frame(COMMAND_ID, encode_command(Request(command, selector, value, self.sequence)))

    def frame(self, can_id: int, data: bytes) -> tuple[CommandResult, int]:
        """What one frame is answered, in its event and on the wire."""
        self.tick += 1
        self.state.begin(self.tick, 0)
        self.bus.up.append((can_id, data))
        self.task.run(self.tick, 0)
        new = list(self.state.take_events())
        self.events += new
        answers = [[board.get(point) for point in packet.points] for packet, board in self.replies.due() if
                   packet is ACK_PACKET]  # fmt: skip
        assert len(new) == len(answers) == 1
        event = EVENT_BY_NUMBER[new[0].number].name
        result = CommandResult(int(answers[0][1]))
        assert event == ("COMMAND_ACCEPTED" if result is ACCEPTED else "COMMAND_REJECTED")
        return result, int(answers[0][3])

    def upload(self, content: bytes) -> None:
        assert self.send(Command.TABLE_LOAD, TableNumber.VISION, len(content))[0] is ACCEPTED
        for chunk in range(-(-len(content) // 4)):
            piece = Piece(chunk, content[4 * chunk : 4 * chunk + 4].ljust(4, b"\0"))
            self.task.take(TABLE_DATA_ID, encode_piece(piece, chunk % 256), self.tick)

    @property
    def counts(self) -> tuple[int, int]:
        board = self.state.board
        return int(board.get(COMMANDS_ACCEPTED)), int(board.get(COMMANDS_REJECTED))

    def digest(self) -> tuple[object, ...]:
        """All that commands may change, but for the counters."""
        state = np.zeros(self.protection.size)
        self.protection.save(state)
        images = [bytes(copy.image) for s in self.bank.stores.values() for c in range(3) if (copy := s.copy(c))]  # type: ignore[arg-type]
        upload = self.bank.upload
        return (
            state.tobytes(), images, upload.number, upload.length, upload.content, upload.missing, self.bank.pending,
            list(self.tasks.switched), list(self.done), self.state.causes, self.state.mode, self.task.desk.armed,
            self.replies.dumping,
        )  # fmt: skip


@pytest.mark.requirement("WB-CMD-01")
def test_each_command_does_what_it_says() -> None:
    ground = Ground()
    assert ground.send(Command.NOOP) == (ACCEPTED, 0)
    ground.send(Command.RESET_COUNTERS)
    ground.send(Command.STOP_RECORDING)
    ground.send(Command.START_RECORDING)
    assert ground.done == ["reset", False, True]
    ground.send(Command.DISABLE_TASK, TaskNumber.IDENTIFY)
    ground.send(Command.ENABLE_TASK, TaskNumber.IDENTIFY)
    ground.send(Command.ENABLE_TASK, TaskNumber.ACQUIRE)
    assert ground.tasks.switched == [("identify", False), ("identify", True), ("acquire", True)]
    ground.upload(TOML)
    assert ground.send(Command.TABLE_VALIDATE, TableNumber.VISION, zlib.crc32(TOML)) == (ACCEPTED, 0)
    assert ground.send(Command.TABLE_ACTIVATE, 0, 0b10) == (ACCEPTED, 0)
    assert ground.bank.at_boundary()[0] == (TableNumber.VISION,)
    assert ground.send(Command.TABLE_ROLL_BACK, 0, 0b10) == (ACCEPTED, 0)
    assert ground.send(Command.TABLE_ABORT, TableNumber.VISION) == (ACCEPTED, 0)
    assert ground.bank.pending is None
    assert ground.send(Command.ENABLE_LIMIT, 0, 7) == (ACCEPTED, 0)
    assert ground.counts[1] == 0
    assert ground.events[0].arguments[:3] == (Command.NOOP, 0, 0)
    told = [record.arguments[:3] for record in ground.events if record.arguments[0] == Command.TABLE_VALIDATE]
    assert told == [(Command.TABLE_VALIDATE, TableNumber.VISION, zlib.crc32(TOML))]


@pytest.mark.requirement("WB-CMD-01")
def test_a_limit_that_is_switched_off_has_no_response_until_it_is_on_again() -> None:
    ground = Ground()
    watch = ground.protection._limits.find(7)
    assert watch is not None and watch.on
    ground.send(Command.ARM, Command.DISABLE_LIMIT, 7)
    ground.send(Command.FIRE, Command.DISABLE_LIMIT, 7)
    assert not watch.on and ground.task.desk.armed is None
    ground.send(Command.ENABLE_LIMIT, 0, 7)
    assert watch.on is True


@pytest.mark.requirement("WB-CMD-02")
def test_each_refusal_has_its_code() -> None:
    ground = Ground()
    assert ground.send(99)[0] is CommandResult.UNKNOWN_COMMAND
    assert ground.send(0)[0] is CommandResult.UNKNOWN_COMMAND
    assert ground.send(Command.NOOP, 1)[0] is BAD
    assert ground.send(Command.NOOP, 0, 1)[0] is BAD
    assert ground.send(Command.SET_MODE, FlightMode.HOLD)[0] is BAD
    assert ground.send(Command.ENABLE_TASK, 12)[0] is BAD
    assert ground.send(Command.CLEAR_FAULT, 0, 1000)[0] is BAD
    assert ground.send(Command.TABLE_ACTIVATE, 0, 64)[0] is BAD
    assert ground.send(Command.TABLE_ACTIVATE, 0, 0)[0] is BAD
    assert ground.send(Command.TABLE_LOAD, TableNumber.LIMITS, 65536)[0] is BAD
    assert ground.send(Command.TABLE_LOAD, TableNumber.LIMITS, 65535) == (
        CommandResult.TABLE_FAULT, TableFault.TOO_LONG,
    )  # fmt: skip
    assert ground.send(Command.TABLE_VALIDATE, TableNumber.VISION, 5) == (
        CommandResult.TABLE_FAULT, TableFault.NOTHING_UPLOADED,
    )  # fmt: skip
    assert ground.send(Command.TABLE_ACTIVATE, 0, 2) == (CommandResult.NOTHING_LOADED, TableFault.NOTHING_LOADED)
    assert ground.send(Command.TABLE_ROLL_BACK, 0, 2)[0] is CommandResult.NOTHING_LOADED
    assert ground.send(Command.DISABLE_TASK, TaskNumber.ACQUIRE)[0] is CommandResult.CRITICAL_TASK
    assert ground.send(Command.ENABLE_TASK, TaskNumber.MATCH)[0] is CommandResult.NO_SUCH_ITEM
    assert ground.send(Command.DUMP_DIAGNOSTICS, TaskNumber.MATCH)[0] is CommandResult.NO_SUCH_ITEM
    assert ground.send(Command.CLEAR_FAULT, 0, 8)[0] is CommandResult.NO_SUCH_ITEM
    assert ground.send(Command.ENABLE_LIMIT, 0, 8)[0] is CommandResult.NO_SUCH_ITEM
    assert ground.frame(COMMAND_ID, b"\1")[0] is CommandResult.WRONG_LENGTH
    assert ground.frame(COMMAND_ID, bytes(8))[0] is CommandResult.WRONG_CRC
    assert ground.frame(TABLE_DATA_ID, encode_piece(Piece(3, b"abcd"), 1)) == (BAD, 3)
    assert ground.counts == (0, 22)


MODES: dict[str, dict[FlightMode, Cause | CommandResult]] = {
    "ACQUIRE": {FlightMode.INHIBITED: Cause.ENABLE, FlightMode.ACQUIRE: Cause.ENABLE},
    "TEST": {FlightMode.INHIBITED: Cause.TEST_BEGIN, FlightMode.TEST: Cause.TEST_BEGIN},
    "INHIBITED": {mode: Cause.INHIBIT for mode in FlightMode} | {FlightMode.TEST: Cause.TEST_END},
}


@pytest.mark.requirement("WB-CMD-03")
@pytest.mark.parametrize("mode", FlightMode)
@pytest.mark.parametrize("wanted", MODES)
def test_a_mode_is_commanded_only_where_the_mode_machine_follows(wanted: str, mode: FlightMode) -> None:
    ground = Ground(mode)
    ground.state.causes = Cause.LOCK_LOST  # something else that happens in the same tick
    result, detail = ground.send(Command.SET_MODE, FlightMode[wanted])
    cause = MODES[wanted].get(mode)
    if cause is None:
        assert (result, detail, ground.state.causes) == (CommandResult.WRONG_MODE, mode, Cause.LOCK_LOST)
    else:
        assert (result, detail, ground.state.causes) == (ACCEPTED, 0, cause | Cause.LOCK_LOST)


@pytest.mark.requirement("WB-CMD-04")
def test_a_fault_is_cleared_only_when_its_cause_is_gone() -> None:
    ground = Ground()
    board = ground.state.board
    board.set(CMP, 0.2)
    ground.protection.step(board, 1, Cause.LOCK_FOUND, True, False)
    assert ground.protection.level(7) == 2
    assert ground.send(Command.CLEAR_FAULT, 0, 7)[0] is CommandResult.CAUSE_PRESENT
    board.set(CMP, 0.9)
    ground.protection.step(board, 2, Cause(0), True, False)
    assert ground.protection.level(7) == 2
    assert ground.send(Command.CLEAR_FAULT, 0, 7)[0] is ACCEPTED
    ground.protection.step(board, 3, Cause(0), True, False)
    assert ground.protection.level(7) == 0


@pytest.mark.requirement("WB-CMD-05")
def test_what_is_dangerous_is_done_only_armed_with_the_same_value_and_in_time() -> None:
    ground = Ground()
    refused = CommandResult.NOT_ARMED
    assert ground.send(Command.RESTART)[0] is refused
    assert ground.send(Command.FIRE, Command.RESTART)[0] is refused
    assert ground.send(Command.ARM, Command.NOOP)[0] is BAD
    assert ground.send(Command.ARM, Command.DISABLE_LIMIT, 0)[0] is BAD
    assert ground.send(Command.ARM, Command.DISABLE_LIMIT, 7)[0] is ACCEPTED
    assert ground.send(Command.FIRE, Command.DISABLE_LIMIT, 8)[0] is refused
    assert ground.send(Command.FIRE, Command.RESTART, 7)[0] is refused
    assert ground.send(Command.FIRE, Command.DISABLE_LIMIT, 7)[0] is ACCEPTED
    assert ground.send(Command.FIRE, Command.DISABLE_LIMIT, 7)[0] is refused
    assert ground.send(Command.ARM, Command.RESTART)[0] is ACCEPTED
    ground.tick += 9
    assert ground.send(Command.FIRE, Command.RESTART)[0] is ACCEPTED
    assert ground.done == ["restart"]
    assert ground.send(Command.ARM, Command.RESTART)[0] is ACCEPTED
    ground.tick += 10
    assert ground.send(Command.FIRE, Command.RESTART)[0] is refused
    assert ground.done == ["restart"]


@pytest.mark.requirement("WB-CMD-06")
def test_the_same_command_twice_is_answered_the_same_and_done_once() -> None:
    ground = Ground()
    assert ground.send(Command.RESET_COUNTERS) == ground.send(Command.RESET_COUNTERS, again=True) == (ACCEPTED, 0)
    assert ground.done == ["reset"]
    ground.send(Command.ARM, Command.RESTART)
    assert ground.send(Command.FIRE, Command.RESTART) == ground.send(Command.FIRE, Command.RESTART, again=True)
    assert ground.done == ["reset", "restart"]
    assert ground.send(99) == ground.send(99, again=True)
    assert ground.counts == (5, 2)
    ground.send(Command.RESET_COUNTERS)
    assert ground.done == ["reset", "restart", "reset"]


@pytest.mark.requirement("WB-CMD-07")
def test_a_table_comes_down_as_it_is_in_memory_a_few_pieces_a_tick() -> None:
    ground = Ground()
    assert ground.send(Command.TABLE_DUMP, TableNumber.IDENTIFY)[0] is ACCEPTED
    assert ground.replies.dumping
    image, taken = bytes(ground.bank.stores[TableNumber.IDENTIFY].active.image), bytearray()
    ground = Ground()
    ground.replies.dump(TableNumber.IDENTIFY, image)
    assert ground.send(Command.TABLE_DUMP, TableNumber.VISION)[0] is CommandResult.BUSY
    ground = Ground()
    ground.replies.dump(TableNumber.IDENTIFY, image)
    while pieces := [
        (packet, [board.get(p) for p in DUMP_WORDS], board.get(DUMP_OFFSET), board.get(DUMP_SIZE))
        for packet, board in ground.replies.due()
    ]:
        assert len(pieces) <= DUMPS_A_TICK
        for packet, words, offset, size in pieces:
            assert (packet, offset, size) == (DUMP_PACKET, len(taken), len(image))
            taken += b"".join(int(word).to_bytes(6, "little") for word in words)
    assert bytes(taken[: len(image)]) == image and not any(taken[len(image) :])


@pytest.mark.requirement("WB-CMD-07")
def test_a_tasks_timing_comes_down() -> None:
    ground = Ground()
    ground.replies.add(ACK_PACKET, (1, 0, 1, 0))
    ground.bus.up.append((COMMAND_ID, encode_command(Request(Command.DUMP_DIAGNOSTICS, TaskNumber.IDENTIFY, 0, 9))))
    ground.bus.up.append((0x300, b"for somebody else"))
    ground.task.run(1, 0)
    answers = [(packet, [board.get(point) for point in packet.points]) for packet, board in ground.replies.due()]
    assert [packet for packet, _ in answers] == [ACK_PACKET, TIMING_PACKET, ACK_PACKET]
    assert answers[1][1][:6] == [TaskNumber.IDENTIFY, 9, 1, 2, 3, 1.5]


@pytest.mark.requirement("WB-CMD-07")
def test_answers_beyond_the_queue_are_counted_and_the_rest_waits_for_the_next_tick() -> None:
    replies = Replies()
    for sequence in range(PLACES + 3):
        replies.acknowledge(1, 0, sequence % 256, 0)
    assert replies.lost == 3
    assert len(list(replies.due())) == A_TICK
    assert sum(1 for _ in iter(lambda: list(replies.due()), [])) == -(-(PLACES - A_TICK) // A_TICK)


def noise(draw: np.random.Generator, good: list[bytes]) -> tuple[int, bytes]:
    """A frame of random bytes, a good one with a damaged CRC or length, or a good one with random arguments."""
    can_id = int(draw.choice(UPLINK_IDS))
    match int(draw.integers(5)):
        case 0:
            return can_id, draw.bytes(int(draw.integers(0, 9)))
        case 1:
            data = bytearray(good[int(draw.integers(len(good)))])
            data[int(draw.integers(8))] ^= 1 << int(draw.integers(8))
            return COMMAND_ID, bytes(data)
        case 2:
            return COMMAND_ID, good[int(draw.integers(len(good)))][: int(draw.integers(8))]
        case 3:
            return TABLE_DATA_ID, encode_piece(Piece(int(draw.integers(20)), draw.bytes(4)), int(draw.integers(256)))
        case _:
            number, selector = int(draw.integers(0, 24)), int(draw.integers(0, 24))
            value = int(draw.integers(1 << int(draw.integers(1, 33))))
            return COMMAND_ID, encode_command(Request(number, selector, value, int(draw.integers(256))))


@pytest.mark.requirement("WB-CMD-08")
def test_a_hundred_thousand_frames_of_noise_raise_nothing_and_change_nothing_that_they_may_not() -> None:
    draw, ground, frames = np.random.default_rng(2026), Ground(), 100_000
    good = [encode_command(Request(c, next(iter(COMMANDS[c].selector), 0), COMMANDS[c].value[0], 1)) for c in Command]
    seen: Counter[str] = Counter()
    board = ground.state.board
    for point in (COMMANDS_ACCEPTED, COMMANDS_REJECTED):
        board.set(point, 0)
    accepted = rejected = 0
    for tick in range(frames):
        before = ground.digest() if tick % 7 == 0 else None
        count = board.get(COMMANDS_REJECTED)
        ground.task.take(*noise(draw, good), tick)
        refused = board.get(COMMANDS_REJECTED) > count
        rejected, accepted = rejected + refused, accepted + (not refused)
        if refused and before is not None:
            assert ground.digest() == before
        for record in ground.state.take_events():
            seen[EVENT_BY_NUMBER[record.number].name] += 1
        list(ground.replies.due())
    assert accepted + rejected == frames
    assert accepted > 1000 and rejected > 50_000
    assert ground.state.events.critical == 0


@pytest.mark.requirement("WB-CMD-08")
@given(
    number=st.integers(0, 255), selector=st.integers(0, 255), value=st.integers(0, 2**32 - 1),
    sequence=st.integers(0, 255), chunk=st.integers(0, 65535), data=st.binary(min_size=4, max_size=4),
)  # fmt: skip
def test_every_single_flipped_bit_of_a_frame_is_refused(
    number: int, selector: int, value: int, sequence: int, chunk: int, data: bytes
) -> None:
    request, piece = Request(number, selector, value, sequence), Piece(chunk, data)
    assert decode_uplink(COMMAND_ID, encode_command(request)) == request
    assert decode_uplink(TABLE_DATA_ID, encode_piece(piece, sequence)) == piece
    for can_id, frame in ((COMMAND_ID, encode_command(request)), (TABLE_DATA_ID, encode_piece(piece, sequence))):
        for bit in range(64):
            flipped = bytearray(frame)
            flipped[bit // 8] ^= 1 << bit % 8
            assert decode_uplink(can_id, bytes(flipped)) is CommandResult.WRONG_CRC
        other = COMMAND_ID + TABLE_DATA_ID - can_id
        assert decode_uplink(other, frame) is CommandResult.WRONG_CRC


@pytest.mark.requirement("WB-CMD-01")
def test_a_set_of_tables_has_a_bit_for_each() -> None:
    assert tables_in(0b101001) == [TableNumber.SCHEDULE, TableNumber.LIMITS, TableNumber.EXECUTIVE]


@pytest.mark.requirement("WB-CMD-09")
def test_in_flight_commands_come_over_the_bus_and_are_answered_in_the_same_tick(tmp_path: Path) -> None:
    bus = Bus()
    with flying(Footage(small(0.4)), tmp_path, 20, outlets=Outlets(bus=bus)) as app:
        app.step()
        frames = [Request(Command.NOOP, 0, 0, s) for s in range(20)]
        bus.up += [(COMMAND_ID, encode_command(request)) for request in frames]
        bus.down.clear()
        app.step()
        assert len(bus.up) == 4
        heard = [decode_frame(*frame) for frame in bus.down]
        assert [values[ACK_RESULT] for _, _, values in heard if ACK_RESULT in values] == [0] * 16
        bus.up[:0] = [(COMMAND_ID, encode_command(Request(Command.SET_MODE, FlightMode.INHIBITED, 0, 77)))]
        app.step()
        assert app.state.mode is FlightMode.INHIBITED
        bus.up += [(COMMAND_ID, encode_command(Request(Command.RESET_COUNTERS, 0, 0, 78)))]
        bus.up += [(COMMAND_ID, encode_command(Request(Command.STOP_RECORDING, 0, 0, 79)))]
        app.step()
        assert app.executive.counts("match").runs == 1 and not app._publish.recording
        bus.up += [(COMMAND_ID, encode_command(Request(Command.ARM, Command.RESTART, 0, 80)))]
        bus.up += [(COMMAND_ID, encode_command(Request(Command.FIRE, Command.RESTART, 0, 81)))]
        assert app.restart_cause is None
        app.step()
        assert app.restart_cause is not None
