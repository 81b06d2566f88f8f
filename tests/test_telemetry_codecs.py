"""Encoders: what is sent is what was set, to half a step; what cannot be sent is said; a damaged frame is refused."""

import math
import tracemalloc

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telemetry_run import board_at, events_at, time_of

from telemetry.board import Board, EventRecord
from telemetry.can_codec import CanEncoder, decode_frame
from telemetry.declaration import Kind
from telemetry.dictionary import (
    AMPLITUDE_MM,
    DROPS_MISSING,
    DUMP_WORDS,
    EPOCH_US,
    EVENT_ARGUMENT_POINTS,
    FLAGS,
    FREQUENCY_HZ,
    HEADER_FRAMES,
    MODE,
    PACKETS,
    SATURATED,
    TICK,
    TIME_EPOCH,
    TIME_US,
    VALID,
    ModeFlag,
)
from telemetry.export import dbc_text
from telemetry.mavlink_codec import MavlinkEncoder, parse_tlog
from telemetry.scaling import clip, decode, encode, readable

GOLDEN = {
    0x210: "1400000006000009",
    0x211: "967a3418240a004f",
    0x212: "14c34bc332c3006d",
    0x215: "ffffffff020500e7",
    0x230: "12000000060000e6",
    0x231: "c0713218240a0066",
    0x232: "52ffffffffff00f8",
    0x242: "2417011500000031",
    0x243: "bc590f1f000000e0",
    0x244: "94260003270000e3",
    0x245: "0200010000000086",
    0x246: "638603b801000071",
    0x249: "02000c00000000a8",
    0x24A: "ffffffffffff0085",
}
GOLDEN_QUALITY = (
    "fd3100000001bff2d200967a3418240a0600140000005bb17f3f72f97f3faed87f3f0000c07f0000"
    "c07ff085493c0000c07fff00ffffffff020101e67a"
)
"""Bytes of tick 20 of the short run: whoever reads our telemetry relies on them."""

ALL_POINTS = sorted(
    {p for packet in PACKETS for p in packet.points} | {p for _, points in HEADER_FRAMES for p in points},
    key=lambda point: point.name,
)
QUANTITIES = [point for point in ALL_POINTS if point.kind in (Kind.QUANTITY, Kind.COUNT)]


def frames(encoder: CanEncoder, count: int) -> list[tuple[int, bytes]]:
    return [encoder.frame(row) for row in range(count)]


def decoded(encoder: CanEncoder, count: int) -> dict[tuple[str, int], float]:
    """Points by name and slot of the frames of one call."""
    values = {}
    for can_id, data in frames(encoder, count):
        layout, _, points = decode_frame(can_id, data)
        values |= {(point.name, layout.slot): value for point, value in points.items()}
    return values


@given(st.sampled_from(QUANTITIES), st.floats(0, 1))
@settings(max_examples=500)
def test_a_value_in_range_comes_back_within_half_a_step(point, share):
    value = point.minimum + share * (point.maximum - point.minimum)
    code = encode(point, value)
    assert 0 <= code < point.unavailable
    assert abs(decode(point, code) - value) <= point.scale / 2 * (1 + 1e-6) + 1e-12


@given(st.sampled_from(QUANTITIES), st.floats(allow_nan=False))
@settings(max_examples=500)
def test_a_value_out_of_range_saturates_and_never_wraps(point, value):
    kept, clipped = clip(point, value)
    assert clipped == (not point.minimum <= value <= point.maximum)
    back = decode(point, encode(point, kept))
    assert point.minimum - 1e-9 <= back <= point.maximum + 1e-9
    if clipped:
        assert back == pytest.approx(point.maximum if value > 0 else point.minimum, abs=1e-9)


@pytest.mark.parametrize("point", [p for p in ALL_POINTS if p.kind is not Kind.RAW], ids=lambda point: point.name)
def test_not_available_stays_not_available(point):
    assert clip(point, math.nan)[1] is False
    assert math.isnan(decode(point, encode(point, math.nan)))
    assert readable(point, math.nan) is None


@pytest.mark.parametrize("code", [0, 1, 0x123456789ABC, (1 << 48) - 1])
def test_raw_data_has_no_code_that_means_not_available(code):
    assert encode(DUMP_WORDS[0], float(code)) == code
    assert decode(DUMP_WORDS[0], code) == code


def test_codes_beyond_the_range_and_choices_that_nobody_made_are_not_available():
    assert math.isnan(decode(VALID, 2))
    assert math.isnan(decode(FREQUENCY_HZ, FREQUENCY_HZ.unavailable - 1))
    kept, clipped = clip(VALID, 2.0)
    assert math.isnan(kept) and clipped


def test_frames_are_the_same_bytes_as_ever():
    encoder = CanEncoder()
    count = encoder.encode(board_at(20), 20, time_of(20))
    sent = {can_id: data.hex() for can_id, data in frames(encoder, count)}
    assert count == 6 + 3 + 34
    assert {can_id: sent[can_id] for can_id in GOLDEN} == GOLDEN
    first = MavlinkEncoder().encode(board_at(20), 20, time_of(20))[0]
    assert first.hex() == GOLDEN_QUALITY


def test_cantools_reads_the_same_values_from_the_exported_dbc():
    database = cantools.database.load_string(dbc_text(), "dbc")
    encoder = CanEncoder()
    for can_id, data in frames(encoder, encoder.encode(board_at(20), 20, time_of(20))):
        theirs = database.decode_message(can_id, data, decode_choices=False)
        _, sequence, ours = decode_frame(can_id, data)
        assert theirs["sequence"] == sequence
        for point, value in ours.items():
            if math.isnan(value):
                assert theirs[point.symbol] == pytest.approx(point.minimum + point.unavailable * point.scale)
            else:
                assert theirs[point.symbol] == pytest.approx(value, abs=1e-9)


def test_every_single_bit_flip_in_a_frame_is_refused():
    encoder = CanEncoder()
    sent = frames(encoder, encoder.encode(board_at(20), 20, time_of(20)))
    for can_id, data in sent:
        for bit in range(64):
            damaged = bytearray(data)
            damaged[bit // 8] ^= 1 << bit % 8
            with pytest.raises(ValueError, match="wrong CRC"):
                decode_frame(can_id, bytes(damaged))
        for bit in range(11):
            with pytest.raises(ValueError, match=r"wrong CRC|unknown identifier"):
                decode_frame(can_id ^ (1 << bit), data)
        with pytest.raises(ValueError, match="wrong length"):
            decode_frame(can_id, data[:7])


def test_frames_of_one_sending_share_the_counter_and_the_next_sending_has_the_next():
    encoder = CanEncoder()
    for tick in (0, 5, 10):
        count = encoder.encode(board_at(tick), tick, time_of(tick))
        counters = {decode_frame(*frame)[1] for frame in frames(encoder, count) if frame[0] >= 0x240}
        assert counters == {tick // 5}


def test_a_clipped_mode_is_never_sent_as_valid():
    board = board_at(20)
    board.set(FREQUENCY_HZ, 1e6)
    encoder = CanEncoder()
    values = decoded(encoder, encoder.encode(board, 20, time_of(20)))
    assert values["frequency_hz", 0] == pytest.approx(160)
    assert values["valid", 0] == 0
    assert int(values["flags", 0]) & ModeFlag.SATURATED
    assert encoder.saturated == 1
    message = next(m for m in messages(MavlinkEncoder(), board, 20) if m.get_type() == "WINGBEAT_MODE")
    assert (message.slot, message.valid, message.saturated) == (0, 0, 1)
    assert message.flags & ModeFlag.SATURATED


def test_mode_that_does_not_exist_is_not_available_rather_than_another_mode():
    board = board_at(3)
    board.set(MODE, 400)
    board.set(DROPS_MISSING, 1e9)
    encoder = CanEncoder()
    values = decoded(encoder, encoder.encode(board, 7, time_of(7)))
    assert math.isnan(values["mode", 0])
    assert values["drops_missing", 0] == 65534
    assert encoder.saturated == 3  # mode stands in two packets of that tick


@pytest.mark.parametrize("time_us", [0, 1, EPOCH_US - 2, EPOCH_US, 1_700_000_000_123_456, 4_000_000_000_000_000])
def test_trigger_time_survives_to_the_microsecond(time_us):
    encoder = CanEncoder()
    encoder.encode(board_at(0), 1, time_us * 1000 + 999)
    header = {}
    for row in (0, 1):
        header |= decode_frame(*encoder.frame(row))[2]
    assert header[TIME_EPOCH] * EPOCH_US + header[TIME_US] == time_us
    assert header[TICK] == 1
    assert header[SATURATED] == 0


def test_estimate_that_does_not_exist_yet_has_neither_time_nor_values():
    encoder = CanEncoder()
    values = decoded(encoder, encoder.encode(Board(), 0, 0))
    mode = [decode_frame(*frame)[2] for frame in frames(encoder, 43) if frame[0] >= 0x240]
    assert all(math.isnan(v) for points in mode for p, v in points.items() if p is not SATURATED)
    assert values["cmp", 0] != values["cmp", 0]


def messages(encoder: MavlinkEncoder, board: Board, tick: int) -> list:
    packed = b"".join(bytes(8) + packet for packet in encoder.encode(board, tick, time_of(tick)))
    return list(parse_tlog(packed))


def test_mavlink_carries_the_board_and_a_heartbeat_with_a_sequence_of_its_own():
    encoder = MavlinkEncoder()
    got = [message for tick in range(31) for message in messages(encoder, board_at(tick), tick)]
    assert [message.get_seq() for message in got] == [i % 256 for i in range(len(got))]
    assert sum(m.get_type() == "HEARTBEAT" for m in got) == 3
    mode = [m for m in got if m.get_type() == "WINGBEAT_MODE"][-8:]
    assert [m.slot for m in mode] == list(range(8))
    assert mode[0].frequency_hz == pytest.approx(0.714603, abs=1e-7)
    assert (mode[0].valid, mode[1].valid, mode[2].valid) == (1, 0, 255)
    assert math.isnan(mode[2].frequency_hz)
    assert mode[0].time_usec == time_of(18) // 1000


def test_events_carry_their_arguments():
    encoder = CanEncoder()
    record = events_at(9)[0]
    values = decoded(encoder, encoder.encode_event(record))
    assert values["event_number", 0] == record.number
    assert values["event_index", 0] == 3
    assert [values[p.name, 0] for p in EVENT_ARGUMENT_POINTS[:3]] == [12.0, 0.0, 0.25]
    assert math.isnan(values["argument_3", 0])
    (packed,) = MavlinkEncoder().encode_event(record)
    (message,) = parse_tlog(bytes(8) + packed)
    assert (message.event_number, message.severity, message.argument_2) == (record.number, 3, 0.25)


def test_an_event_unknown_to_the_dictionary_is_sent_without_a_severity():
    encoder = CanEncoder()
    values = decoded(encoder, encoder.encode_event(EventRecord(60000, 1, 1000, 1, (math.inf,))))
    assert values["event_number", 0] == 60000
    assert math.isnan(values["severity", 0])
    assert values["argument_0", 0] == pytest.approx(3.4e38)
    assert values["saturated", 0] == 1


def test_encoding_allocates_no_array_data():
    encoder, board = CanEncoder(), board_at(20)
    encoder.encode(board, 20, time_of(20))
    domain = tracemalloc.DomainFilter(True, 389047)
    tracemalloc.start()
    before = tracemalloc.take_snapshot().filter_traces([domain])
    for tick in range(200):
        board.set(AMPLITUDE_MM, tick)
        board.set(FLAGS, tick)
        encoder.encode(board, tick, time_of(tick))
    after = tracemalloc.take_snapshot().filter_traces([domain])
    tracemalloc.stop()
    assert after.compare_to(before, "lineno") == []
