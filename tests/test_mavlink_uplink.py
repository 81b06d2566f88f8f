"""Commands and parameters over MAVLink, made and read by pymavlink; noise changes nothing."""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from flight_parts import Footage, flying, small
from hypothesis import given, settings
from hypothesis import strategies as st
from test_commands import TOML, Ground

from fsw.commands.ground_link import AGAIN_TICKS
from fsw.commands.replies import LISTED_A_TICK
from fsw.commands.replies import PLACES as PLACES_OF_ANSWERS
from fsw.tables.flight import ExecutiveTable, IdentifyTable, VisionTable
from fsw.tables.parameters import INDEX_BY_NAME, LONGEST_NAME, PARAMETERS, find_parameters, parameter_value
from fsw.tasks.command import A_TICK, CommandTask
from fsw.tasks.publish import Outlets
from sim.lines import MemoryLink
from telemetry.commands import Command
from telemetry.dictionary import COMMANDS_ACCEPTED, COMMANDS_REJECTED, CommandResult, FlightMode, TableFault
from telemetry.events import EVENT_BY_NUMBER, TableNumber, TaskNumber
from telemetry.mavlink_dialect import COMMAND_BASE, PIECE_BYTES, PIECES, dialect
from telemetry.mavlink_packet import COMPONENT_ID, SYSTEM_ID, PacketFinder
from telemetry.mavlink_uplink import PLACES, answer_message

MAV: Any = dialect()
US = (SYSTEM_ID, COMPONENT_ID)
OTHER = 77


class Station(Ground):
    """A ground station with a MAVLink line to the command task."""

    def __init__(self, mode: FlightMode = FlightMode.TRACK) -> None:
        super().__init__(mode)
        self.link = MemoryLink()
        old = self.task
        self.task = CommandTask(
            self.state, None, old.desk._handlers, self.bank, self.replies, arm_ticks=10, link=self.link
        )  # fmt: skip
        self.task.init()
        self.mav = MAV.MAVLink(None, srcSystem=250, srcComponent=5)

    def packed(self, message: Any) -> bytes:
        packet: bytes = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return packet

    def command(self, number: int, *params: float, confirmation: int = 0, to: tuple[int, int] = US) -> bytes:
        values = (*params, *[0.0] * (7 - len(params)))
        return self.packed(MAV.MAVLink_command_long_message(*to, COMMAND_BASE + number, confirmation, *values))

    def hear(self, data: bytes = b"", ticks: int = 1) -> list[Any]:
        """Bytes on the line; the answers that come within so many ticks, through their own bytes."""
        self.link.uplink += data
        heard: list[Any] = []
        for _ in range(ticks):
            self.tick += 1
            self.state.begin(self.tick, 0)
            self.task.run(self.tick, 0)
            self.events += list(self.state.take_events())
            for answer in self.replies.answers():
                packet = answer_message(answer).pack(MAV.MAVLink(None, *US))
                heard.append(MAV.MAVLink(None).decode(bytearray(packet)))
        return heard

    def ask(self, number: int, *params: float, **more: Any) -> tuple[int, CommandResult, int]:
        """What a command is answered: MAVLink's result, ours, and its detail."""
        (ack,) = self.hear(self.command(number, *params, **more))
        assert (ack.get_type(), ack.command, ack.target_system) == ("COMMAND_ACK", COMMAND_BASE + number, 250)
        return ack.result, CommandResult(ack.result_param2 & 0xFF), ack.result_param2 >> 8

    def param(self, name: str, value: float) -> bytes:
        return self.packed(MAV.MAVLink_param_set_message(*US, name.encode(), value, MAV.MAV_PARAM_TYPE_REAL32))

    @property
    def names(self) -> list[str]:
        return [EVENT_BY_NUMBER[record.number].name for record in self.events]


def done(detail: int = 0) -> tuple[int, CommandResult, int]:
    return MAV.MAV_RESULT_ACCEPTED, CommandResult.ACCEPTED, detail


@pytest.mark.requirement("WB-CMD-11")
def test_each_command_of_the_bus_can_be_given_over_mavlink() -> None:
    station = Station()
    assert station.ask(Command.NOOP) == done()
    assert station.ask(Command.DISABLE_TASK, TaskNumber.IDENTIFY) == done()
    assert station.tasks.switched == [("identify", False)]
    assert station.ask(Command.SET_MODE, FlightMode.INHIBITED) == done()
    assert station.ask(Command.TABLE_LOAD, TableNumber.VISION, len(TOML)) == done()
    data = TOML.ljust(PIECE_BYTES * PIECES, b"\0")
    count = math.ceil(len(TOML) / PIECE_BYTES)
    assert station.hear(station.packed(MAV.MAVLink_wingbeat_table_data_message(*US, 0, count, data))) == []
    crc = zlib.crc32(TOML)
    assert station.ask(Command.TABLE_VALIDATE, TableNumber.VISION, crc & 0xFFFF, crc >> 16) == done()
    assert station.ask(Command.TABLE_ACTIVATE, 0, 0b10) == done()
    assert station.bank.at_boundary()[0] == (TableNumber.VISION,)
    assert station.ask(Command.ARM, Command.RESTART) == done()
    assert station.ask(Command.FIRE, Command.RESTART, math.nan) == done()
    assert station.done == ["restart"]
    assert station.counts == (9, 0) and station.names == ["COMMAND_ACCEPTED"] * 8


@pytest.mark.requirement("WB-CMD-11")
def test_each_refusal_over_mavlink_has_its_result() -> None:
    station = Station()
    bad = (MAV.MAV_RESULT_DENIED, CommandResult.BAD_ARGUMENT, 0)
    assert station.ask(99)[:2] == (MAV.MAV_RESULT_UNSUPPORTED, CommandResult.UNKNOWN_COMMAND)
    assert station.ask(-COMMAND_BASE + 512, 1)[:2] == (MAV.MAV_RESULT_UNSUPPORTED, CommandResult.UNKNOWN_COMMAND)
    for params in ((1.0,), (0, 1), (0.5,), (0, 0, 0, 3), (-1,), (math.inf,), (0, 65536), (0, 0, 0, 0, 0, 0, 1)):
        assert station.ask(Command.NOOP, *params) == bad
    assert station.ask(Command.RESTART)[1] is CommandResult.NOT_ARMED
    assert station.ask(Command.TABLE_VALIDATE, TableNumber.VISION) == (
        MAV.MAV_RESULT_FAILED, CommandResult.TABLE_FAULT, TableFault.NOTHING_UPLOADED,
    )  # fmt: skip
    assert station.ask(Command.SET_MODE, FlightMode.TEST)[:2] == (
        MAV.MAV_RESULT_TEMPORARILY_REJECTED, CommandResult.WRONG_MODE,
    )  # fmt: skip
    message = MAV.MAVLink_command_int_message(*US, 0, COMMAND_BASE + 1, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    (ack,) = station.hear(station.packed(message))
    assert ack.result == MAV.MAV_RESULT_UNSUPPORTED
    for first, count in ((0, 1), (0, 0), (0, 33)):
        pieces = MAV.MAVLink_wingbeat_table_data_message(*US, first, count, bytes(PIECE_BYTES * PIECES))
        assert station.hear(station.packed(pieces)) == []
    assert station.counts == (0, 17) and set(station.names) == {"COMMAND_REJECTED"}


@pytest.mark.requirement("WB-CMD-11")
def test_pieces_beyond_the_announced_table_change_nothing() -> None:
    station = Station()
    station.ask(Command.TABLE_LOAD, TableNumber.VISION, 4 * 10)
    before = station.digest()
    for first, count in ((8, 3), (10, 1), (65535, 2)):
        pieces = MAV.MAVLink_wingbeat_table_data_message(*US, first, count, bytes(range(128)))
        station.hear(station.packed(pieces))
    assert station.digest() == before and station.counts == (1, 3)
    told = [record.arguments for record in station.events[-3:]]
    assert [(a[0], a[2], a[3]) for a in told] == [
        (Command.TABLE_LOAD, CommandResult.BAD_ARGUMENT, chunk) for chunk in (8, 10, 65535)
    ]  # fmt: skip
    assert all(math.isnan(a[1]) for a in told)
    pieces = MAV.MAVLink_wingbeat_table_data_message(*US, 0, 0, bytes(128))
    station.hear(station.packed(pieces))
    assert station.events[-1].arguments[3] == 0
    pieces = MAV.MAVLink_wingbeat_table_data_message(*US, 2, 3, bytes(range(128)))
    station.hear(station.packed(pieces))
    assert station.bank.upload.content == bytes(8) + bytes(range(12)) + bytes(20) and station.counts == (2, 4)


@pytest.mark.requirement("WB-CMD-11")
def test_what_is_for_others_is_let_pass() -> None:
    station = Station()
    station.hear(station.command(Command.RESET_COUNTERS, to=(OTHER, COMPONENT_ID)))
    station.hear(station.command(Command.RESET_COUNTERS, to=(SYSTEM_ID, OTHER)))
    station.hear(station.packed(MAV.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
    station.hear(station.packed(MAV.MAVLink_mission_request_list_message(*US)))
    assert station.counts == (0, 0) and not station.done and not station.events
    assert station.hear(station.command(Command.RESET_COUNTERS, to=(0, 0)))[0].result == MAV.MAV_RESULT_ACCEPTED


@pytest.mark.requirement("WB-CMD-06")
def test_a_command_that_is_sent_again_is_answered_the_same_and_done_once() -> None:
    station = Station()
    packet = station.command(Command.RESET_COUNTERS)
    (first,) = station.hear(packet)
    (second,) = station.hear(packet)  # the line doubled it
    assert first.to_dict() == second.to_dict() and station.done == ["reset"]
    assert station.ask(Command.RESET_COUNTERS, confirmation=1) == done() and station.done == ["reset"]
    assert station.ask(Command.RESET_COUNTERS) == done() and station.done == ["reset"] * 2
    assert station.ask(Command.NOOP, confirmation=3) == done()  # the first one never came
    assert station.ask(Command.RESET_COUNTERS, confirmation=1) == done() and station.done == ["reset"] * 3
    station.hear(ticks=AGAIN_TICKS)
    assert station.ask(Command.RESET_COUNTERS, confirmation=1) == done() and station.done == ["reset"] * 4
    assert station.counts == (7, 0)


@pytest.mark.requirement("WB-CMD-12")
def test_all_parameters_can_be_listed_a_few_a_tick_and_are_the_tables_numbers() -> None:
    station = Station()
    request = station.packed(MAV.MAVLink_param_request_list_message(*US))
    heard = station.hear(request)
    assert len(heard) == LISTED_A_TICK
    heard += station.hear(ticks=len(PARAMETERS))
    assert [m.param_index for m in heard] == list(range(len(PARAMETERS)))
    assert {m.param_count for m in heard} == {len(PARAMETERS)}
    tables = {TableNumber.VISION: "vision", TableNumber.IDENTIFY: "identify", TableNumber.EXECUTIVE: "executive"}
    for message, parameter in zip(heard, PARAMETERS, strict=True):
        part = getattr(station.bank.flight, tables[parameter.table])
        assert message.param_id == parameter.name and len(parameter.name) <= LONGEST_NAME
        assert message.param_value == np.float32(getattr(part, parameter.field))
    assert len(INDEX_BY_NAME) == len(PARAMETERS), "two parameters have one name"
    assert station.counts == (1, 0) and station.names == ["PARAMETERS_READ"]
    assert math.isnan(station.events[0].arguments[0])


@pytest.mark.requirement("WB-CMD-12")
def test_parameters_are_the_numbers_of_the_tables_in_their_order() -> None:
    assert find_parameters() == PARAMETERS
    kinds = {
        TableNumber.VISION: VisionTable,
        TableNumber.IDENTIFY: IdentifyTable,
        TableNumber.EXECUTIVE: ExecutiveTable,
    }
    expected = [
        (f"{number.name[0]}_{name.upper()}"[:16], number, name, kind is int)
        for number, table in kinds.items()
        for name, kind in get_type_hints(table).items()
        if kind in (int, float)
    ]
    assert [tuple(parameter) for parameter in find_parameters()] == expected


@pytest.mark.requirement("WB-CMD-12")
def test_a_parameter_is_read_by_name_or_place() -> None:
    station = Station()
    (first,) = station.hear(station.packed(MAV.MAVLink_param_request_read_message(*US, b"", 0)))
    assert first.param_id == PARAMETERS[0].name
    station = Station()
    for name, place in (("V_LEAST_CELLS", -1), ("", INDEX_BY_NAME["V_LEAST_CELLS"])):
        (value,) = station.hear(station.packed(MAV.MAVLink_param_request_read_message(*US, name.encode(), place)))
        assert (value.param_id, value.param_value) == ("V_LEAST_CELLS", station.bank.flight.vision.least_cells)
        assert (station.names[-1], station.events[-1].arguments[0]) == ("PARAMETERS_READ", value.param_index)
    for name, place in (("NO_SUCH", -1), ("", len(PARAMETERS)), ("", -2)):
        (error,) = station.hear(station.packed(MAV.MAVLink_param_request_read_message(*US, name.encode(), place)))
        assert (error.get_type(), error.error) == ("PARAM_ERROR", MAV.MAV_PARAM_ERROR_DOES_NOT_EXIST)
        assert (error.param_id, error.param_index, error.target_system) == (name, place, 250)
        index, value, fault = station.events[-1].arguments[:3]
        assert (index == place or math.isnan(index)) and math.isnan(value) and fault == TableFault.NO_SUCH_PARAMETER
    assert station.counts == (2, 3)


@pytest.mark.requirement("WB-CMD-12")
def test_parameters_that_are_set_become_active_together_at_the_boundary() -> None:
    station = Station()
    before = station.bank.flight
    (cells,) = station.hear(station.param("V_LEAST_CELLS", 17))
    (gate,) = station.hear(station.param("V_EPIPOLAR_GATE_", 0.7))
    (least,) = station.hear(station.param("I_MINIMUM_AMPLIT", 0.25))
    assert (cells.param_value, gate.param_value, least.param_value) == (17.0, np.float32(0.7), 0.25)
    assert station.bank.flight == before
    assert station.bank.at_boundary() == ((TableNumber.VISION, TableNumber.IDENTIFY), TableFault.NONE)
    now = station.bank.flight
    assert (now.vision.least_cells, now.vision.epipolar_gate_px, now.identify.minimum_amplitude_mm) == (17, 0.7, 0.25)
    assert station.names == ["PARAMETER_SET"] * 3 and station.counts == (3, 0)


@pytest.mark.requirement("WB-CMD-12")
@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("V_LEAST_CELLS", 3, TableFault.BAD_VALUE),
        ("V_LEAST_CELLS", 17.5, TableFault.BAD_VALUE),
        ("V_LEAST_CELLS", math.nan, TableFault.BAD_VALUE),
        ("V_EPIPOLAR_GATE_", math.inf, TableFault.BAD_VALUE),
        ("I_HISTORY_TICKS", 300, TableFault.FIXED),
        ("I_LEAST_TICKS", 99_000, TableFault.INCONSISTENT),
        ("E_ARM_TICKS", 10, TableFault.FIXED),
        ("NO_SUCH", 1, TableFault.NO_SUCH_PARAMETER),
    ],
)
def test_a_parameter_that_is_refused_stays_and_says_why(name: str, value: float, fault: TableFault) -> None:
    station = Station()
    before = station.digest()
    heard = station.hear(station.param(name, value))
    assert station.digest() == before and station.counts == (0, 1) and station.names == ["PARAMETER_REFUSED"]
    assert station.events[0].arguments[2] == fault
    assert heard[0].get_type() == "PARAM_ERROR"
    if name in INDEX_BY_NAME:
        assert heard[1].param_value == np.float32(parameter_value(station.bank, INDEX_BY_NAME[name]))
        read_only = fault is TableFault.FIXED
        expected = MAV.MAV_PARAM_ERROR_READ_ONLY if read_only else MAV.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        assert heard[0].error == expected


@pytest.mark.requirement("WB-CMD-12")
def test_a_table_of_the_grounds_that_waits_is_not_touched_by_a_parameter() -> None:
    station = Station()
    station.bank.load(TableNumber.VISION, TOML)
    before = station.digest()
    assert station.hear(station.param("V_LEAST_CELLS", 17))[0].error == MAV.MAV_PARAM_ERROR_PERMISSION_DENIED
    assert station.digest() == before
    station.bank.activate([TableNumber.VISION])
    assert station.hear(station.param("V_LOST_AFTER_TIC", 9))[0].get_type() == "PARAM_VALUE"
    station.bank.at_boundary()
    assert (station.bank.flight.vision.least_cells, station.bank.flight.vision.lost_after_ticks) == (20, 9)
    station.bank.roll_back([TableNumber.VISION])
    assert station.hear(station.param("I_MINIMUM_AMPLIT", 1.0))[0].error == MAV.MAV_PARAM_ERROR_PERMISSION_DENIED
    station.bank.at_boundary()
    assert station.bank.flight.vision.lost_after_ticks != 9


def mutated(station: Station, draw: np.random.Generator, good: list[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Packets, each with whether it is whole: noise, flipped bits, lost ends, random arguments, other receivers."""
    while True:
        packet = bytearray(good[int(draw.integers(len(good)))])
        match int(draw.integers(5)):
            case 0:
                yield draw.bytes(int(draw.integers(1, 40))), False
            case 1:
                packet[int(draw.integers(len(packet)))] ^= 1 << int(draw.integers(8))
                yield bytes(packet), False
            case 2:
                yield bytes(packet[: int(draw.integers(1, len(packet)))]), False
            case 3:
                number, selector = int(draw.integers(0, 24)), int(draw.integers(0, 24))
                low, high = (int(v) for v in draw.integers(0, 1 << 17, 2))
                yield station.command(number, selector, low, high, confirmation=int(draw.integers(3))), True
            case _:
                index, raw = int(draw.integers(len(PARAMETERS))), struct.unpack("<f", draw.bytes(4))[0]
                name = PARAMETERS[index].name if draw.integers(3) else "NO_SUCH"
                yield station.param(name, raw if draw.integers(2) else float(draw.integers(0, 50))), True


@pytest.mark.requirement("WB-CMD-08")
def test_twenty_thousand_mutated_packets_raise_nothing_and_a_rejected_one_changes_nothing() -> None:
    draw, station = np.random.default_rng(2027), Station()
    good = [station.command(c) for c in Command] + [station.param(p.name, 3.0) for p in PARAMETERS]
    beat = station.packed(MAV.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    stream = mutated(station, draw, good)
    addressed = 0
    for count in range(20_000):
        packet, whole = next(stream)
        before, counts = station.digest() if count % 7 == 0 else None, station.counts
        # What lost its end waits for as many bytes as it claims; heartbeats of others fill it up.
        station.hear(packet if whole else packet + beat * 16)
        accepted, rejected = (now - then for now, then in zip(station.counts, counts, strict=True))
        if not accepted and before is not None:
            assert station.digest() == before
        if whole:
            assert accepted + rejected == 1
            addressed += 1
        else:
            assert not accepted
        assert len(station.link.uplink) == 0
        if addressed % 50 == 0:
            station.bank.at_boundary()
    assert addressed > 5000 and station.counts[0] > 100
    told = sum(name != "EVENTS_SUPPRESSED" for name in station.names)
    assert told + station.state.events.suppressed == sum(station.counts)
    assert station.state.events.critical == 0


@pytest.mark.requirement("WB-CMD-08")
@settings(max_examples=10, deadline=None)
@given(number=st.sampled_from(list(Command)), selector=st.integers(0, 20), value=st.integers(0, 65535))
def test_every_single_flipped_bit_of_a_packet_is_refused(number: Command, selector: int, value: int) -> None:
    mav = MAV.MAVLink(None, srcSystem=250, srcComponent=5)
    params = (float(selector), float(value), *[0.0] * 5)
    packet = MAV.MAVLink_command_long_message(*US, COMMAND_BASE + number, 0, *params).pack(mav)
    beat = MAV.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(mav)
    for bit in range(8 * len(packet)):
        flipped = bytearray(packet)
        flipped[bit // 8] ^= 1 << bit % 8
        finder = PacketFinder(MAV.MAVLink(None), PLACES)
        finder.add(bytes(flipped) + beat * 20)
        kinds = {found if isinstance(found, str) else found.get_type() for found in finder}
        assert "COMMAND_LONG" not in kinds and "HEARTBEAT" in kinds


@pytest.mark.requirement("WB-CMD-08")
def test_a_packet_that_comes_byte_by_byte_is_one_command() -> None:
    station = Station()
    heard = [station.hear(bytes([byte])) for byte in station.command(Command.NOOP)]
    assert [len(answers) for answers in heard] == [0] * (len(heard) - 1) + [1]
    assert station.counts == (1, 0)


@pytest.mark.requirement("WB-CMD-08")
def test_a_line_that_brings_more_than_may_wait_is_told_and_goes_on() -> None:
    station = Station()
    flood = b"".join(station.command(Command.NOOP) for _ in range(60))
    assert len(flood) > PLACES
    station.hear(flood)
    assert sum(station.counts) == A_TICK + 1 and station.counts[1] == 1
    station.hear(ticks=10)
    assert station.ask(Command.NOOP) == done()


@pytest.mark.requirement("WB-CMD-07")
def test_answers_to_mavlink_beyond_the_queue_are_counted() -> None:
    station = Station()
    for _ in range(PLACES_OF_ANSWERS + 2):
        station.link.uplink += station.command(Command.NOOP)
        station.task.run(1, 0)
    assert station.replies.lost >= 2
    assert len(station.hear(ticks=10)) == PLACES_OF_ANSWERS


@pytest.mark.requirement("WB-CMD-09")
def test_in_flight_a_mavlink_line_carries_telemetry_down_and_commands_up(tmp_path: Path) -> None:
    link = MemoryLink()
    station = Station()
    with flying(Footage(small(0.4)), tmp_path, 20, outlets=Outlets(link=link)) as app:
        app.step()
        link.downlink.clear()
        link.uplink += station.command(Command.SET_MODE, FlightMode.INHIBITED) + station.param("V_LEAST_CELLS", 30)
        app.step()
        heard = MAV.MAVLink(None).parse_buffer(bytes(link.downlink))
        kinds = [message.get_type() for message in heard]
        assert {"COMMAND_ACK", "PARAM_VALUE", "WINGBEAT_QUALITY"} <= set(kinds), kinds
        assert app.state.mode is FlightMode.INHIBITED
        assert (app.state.board.get(COMMANDS_ACCEPTED), app.state.board.get(COMMANDS_REJECTED)) == (2, 0)
        for _ in range(16):
            app.step()
        assert app.tables.flight.vision.least_cells == 30
