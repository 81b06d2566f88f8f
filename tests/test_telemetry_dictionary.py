"""The dictionary is consistent, and what is made from it is valid for the tools that read it."""

import contextlib
import io
import re
import shutil
from collections import Counter
from pathlib import Path

import cantools
import numpy as np
import pymavlink
import pytest
from pymavlink.generator import mavgen, mavparse

from telemetry.board import Board
from telemetry.can_codec import LAYOUTS
from telemetry.declaration import Argument, Event, Kind, Packet, Point, Severity
from telemetry.dictionary import CMP, FREQUENCY_HZ, PACKETS, POINTS, ModeFlag, flag_bits
from telemetry.events import EVENTS, event_text
from telemetry.export import can_database, dbc_text
from telemetry.mavlink_dialect import dialect_xml
from telemetry.page import page_text

ROOT = Path(__file__).parent.parent


def test_names_numbers_and_identifiers_are_unique():
    for values in (
        [point.name for point in POINTS],
        [point.symbol for point in POINTS],
        [packet.mavlink_id for packet in PACKETS],
        [event.number for event in EVENTS],
        [event.name for event in EVENTS],
    ):
        assert [value for value, count in Counter(values).items() if count > 1] == []
    assert len(LAYOUTS) == sum(packet.frame_count for packet in PACKETS)
    assert all(can_id < 0x800 for can_id in LAYOUTS)


def test_documentation_page_is_that_of_the_dictionary():
    assert (ROOT / "docs" / "telemetry.md").read_text() == page_text()


def test_dbc_is_read_back_with_every_signal_unit_and_range():
    again, ours = cantools.database.load_string(dbc_text(), "dbc"), can_database()
    assert {m.name for m in again.messages} == {m.name for m in ours.messages}
    for message in ours.messages:
        other = again.get_message_by_name(message.name)
        assert other.frame_id == message.frame_id
        for signal in message.signals:
            twin = other.get_signal_by_name(signal.name)
            for attribute in (
                "start",
                "length",
                "scale",
                "offset",
                "minimum",
                "maximum",
                "unit",
                "comment",
                "is_float",
            ):
                assert getattr(twin, attribute) == getattr(signal, attribute), (message.name, signal.name, attribute)


def test_mavgen_accepts_the_dialect_under_its_strict_schema(tmp_path):
    shipped = Path(pymavlink.__file__).parent / "dialects" / "v20"
    for name in ("common.xml", "standard.xml", "minimal.xml"):
        shutil.copy(shipped / name, tmp_path)
    (tmp_path / "wingbeat.xml").write_text(dialect_xml())
    options = mavgen.Opts(str(tmp_path / "wingbeat.py"), mavparse.PROTOCOL_2_0, "Python3", True, True)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert mavgen.mavgen(options, [str(tmp_path / "wingbeat.xml")]), said.getvalue()


def test_a_declaration_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="does not fit in 8 bits"):
        Point("p", "1", 0, 255, 1, 8, "one code is kept for not available", Kind.COUNT)
    wide = Point("wide", "1", 0, 1, 1, 40, "wide", Kind.COUNT)
    with pytest.raises(ValueError, match="80 bits, only 48 fit"):
        Packet("x", 1, 1, 1, 0, "two wide points in a frame", (("f", (wide, wide)),))
    with pytest.raises(ValueError, match="has 8 slots"):
        Packet("x", 1, 1, 1, 0, "slots disagree", (("f", (FREQUENCY_HZ,)),))
    with pytest.raises(ValueError, match="at most 4"):
        Event(1, "E", Severity.INFO, tuple(Argument(f"a{i}") for i in range(5)), "")
    with pytest.raises(KeyError):
        Event(1, "E", Severity.INFO, (), "{missing}")


def test_flags_have_the_names_of_modes_json_and_none_is_lost():
    assert flag_bits(["harmonic", "near_nyquist"]) == ModeFlag.HARMONIC | ModeFlag.NEAR_NYQUIST
    assert flag_bits([]) == 0
    assert flag_bits(["something_new"]) == ModeFlag.OTHER


def test_every_flag_of_the_identification_has_a_bit_of_its_own():
    sources = (ROOT / "fsw" / "modal").glob("*.py")
    names = {name for source in sources for name in re.findall(r'append\("([a-z_]+)"\)', source.read_text())}
    assert {name for name in names if flag_bits([name]) & ModeFlag.OTHER} == set()


def test_every_event_has_a_text_for_any_arguments():
    for event in EVENTS:
        for arguments in ((), [0.0] * 4, [float("nan")] * 4, [1e9] * 4):
            assert event_text(event.number, arguments)
    assert event_text(60000, ()) == "unknown event 60000"


def test_board_starts_not_available_and_keeps_what_is_set():
    board = Board()
    assert np.isnan(board.values).all()
    board.set(FREQUENCY_HZ, 0.7146, 3)
    assert board.get("frequency_hz", 3) == 0.7146
    assert np.isnan(board.get(FREQUENCY_HZ, 2))
    board.slots(FREQUENCY_HZ)[2] = 4.0
    assert board.get(FREQUENCY_HZ, 2) == 4.0
    board.add(CMP)
    board.add(CMP, 2)
    assert board.get("cmp") == 3.0
    with pytest.raises(IndexError, match="slot 8"):
        board.set(FREQUENCY_HZ, 1.0, 8)
