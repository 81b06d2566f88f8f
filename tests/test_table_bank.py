"""Tables in memory: uploaded, refused with a code, activated together at a boundary, rolled back, scrubbed."""

import zlib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from flight_parts import Footage, flying, small
from hypothesis import given
from hypothesis import strategies as st

from fsw.executive.schedule import Refusal
from fsw.tables.bank import TableBank
from fsw.tables.flight import load_flight
from fsw.tables.image import HEADER, Copy, is_whole, part_of, payload_of
from fsw.tables.scrub import PLACES, Scrub
from fsw.tables.upload import CHUNK_BYTES, MOST_BYTES, Upload
from telemetry.board import EventRecord
from telemetry.dictionary import TABLE_REPAIRS, TABLES_CORRUPT, TableFault
from telemetry.events import EVENT_BY_NUMBER, TableCopy, TableNumber

VISION, IDENTIFY, LIMITS, SCHEDULE = TableNumber.VISION, TableNumber.IDENTIFY, TableNumber.LIMITS, TableNumber.SCHEDULE
GOOD = b"[vision]\nleast_cells = 20\n"


def make_bank(refusal: int = 0) -> TableBank:
    return TableBank(load_flight(), lambda schedule: refusal)


def send(bank: TableBank, number: TableNumber, content: bytes, crc32: int | None = None) -> TableFault:
    assert bank.upload.begin(number, len(content))
    for chunk in range(-(-len(content) // CHUNK_BYTES)):
        piece = content[chunk * CHUNK_BYTES : (chunk + 1) * CHUNK_BYTES].ljust(CHUNK_BYTES, b"\0")
        assert bank.upload.put(chunk, piece)
    return bank.validate(number, zlib.crc32(content) if crc32 is None else crc32)


def images(bank: TableBank) -> list[bytes]:
    return [bytes(store.active.image) for store in bank.stores.values()]


@pytest.mark.requirement("WB-TAB-01")
def test_an_uploaded_table_holds_from_the_boundary_on_and_the_one_before_can_come_back() -> None:
    bank = make_bank()
    first = bank.flight
    assert send(bank, VISION, GOOD) is TableFault.NONE
    assert bank.flight == first
    assert bank.activate([VISION]) is TableFault.NONE
    assert bank.flight == first
    assert bank.at_boundary() == ((VISION,), TableFault.NONE)
    assert bank.flight.vision == msgspec.structs.replace(first.vision, least_cells=20)
    assert bank.stores[VISION].active.version == 2
    assert bank.at_boundary() == ((), TableFault.NONE)
    assert bank.roll_back([VISION]) is TableFault.NONE
    assert bank.at_boundary() == ((VISION,), TableFault.NONE)
    assert bank.flight == first
    assert bank.stores[VISION].active.version == 1
    assert bank.stores[VISION].previous is not None and bank.stores[VISION].previous.version == 2


@pytest.mark.requirement("WB-TAB-02")
def test_several_tables_become_active_at_once_or_none_of_them() -> None:
    bank = make_bank()
    first = bank.flight
    send(bank, VISION, GOOD)
    assert bank.activate([VISION, LIMITS]) is TableFault.NOTHING_LOADED
    assert bank.pending is None
    assert send(bank, LIMITS, b"limit = []\n") is TableFault.NONE
    assert bank.activate([VISION, LIMITS]) is TableFault.NONE
    loaded = bank.stores[LIMITS].loaded
    assert loaded is not None
    loaded.image[9] ^= 1
    assert bank.at_boundary() == ((), TableFault.DAMAGED)
    assert bank.flight == first and bank.pending is None
    assert send(bank, LIMITS, b"limit = []\n") is TableFault.NONE
    assert bank.activate([VISION, LIMITS]) is TableFault.NONE
    assert bank.at_boundary() == ((VISION, LIMITS), TableFault.NONE)
    assert bank.flight.limit == [] and bank.flight.vision.least_cells == 20
    assert bank.roll_back([IDENTIFY]) is TableFault.NOTHING_LOADED


REFUSED: dict[str, tuple[TableNumber, bytes, TableFault]] = {
    "no TOML": (VISION, b"[vision\n", TableFault.NOT_TOML),
    "no text": (VISION, b"\xff\xfe\x00", TableFault.NOT_TOML),
    "nested without end": (VISION, b"a = " + b"[" * 9000, TableFault.NOT_TOML),
    "another table": (VISION, b"[identify]\norder = 20\n", TableFault.OTHER_TABLE),
    "two tables": (VISION, GOOD + b"[identify]\norder = 20\n", TableFault.OTHER_TABLE),
    "nothing": (VISION, b"\n", TableFault.OTHER_TABLE),
    "unknown key": (VISION, b"[vision]\nmost_cells = 1\n", TableFault.BAD_VALUE),
    "out of range": (VISION, b"[vision]\nleast_cells = 1\n", TableFault.BAD_VALUE),
    "not finite": (VISION, b"[vision]\nskew_limit_us = nan\n", TableFault.BAD_VALUE),
    "no table": (VISION, b"vision = 3\n", TableFault.BAD_VALUE),
    "a row lacks a key": (SCHEDULE, b'[[schedule]]\ntask = "acquire"\n', TableFault.BAD_VALUE),
    "record too short": (IDENTIFY, b"[identify]\nleast_ticks = 451\n", TableFault.INCONSISTENT),
    "sizes memory": (IDENTIFY, b"[identify]\nhistory_ticks = 451\n", TableFault.FIXED),
    "sizes memory too": (VISION, b"[vision]\ndrop_window_ticks = 61\n", TableFault.FIXED),
    "taken in at the start": (TableNumber.EXECUTIVE, b"[executive]\ncatch_up_ticks = 1\n", TableFault.FIXED),
}


@pytest.mark.requirement("WB-TAB-03")
@pytest.mark.parametrize(("number", "content", "fault"), REFUSED.values(), ids=REFUSED.keys())
def test_each_cause_to_refuse_a_table_has_its_code_and_changes_nothing(
    number: TableNumber, content: bytes, fault: TableFault
) -> None:
    bank = make_bank()
    before = images(bank)
    assert send(bank, number, content) is fault
    assert images(bank) == before
    assert bank.stores[number].loaded is None


@pytest.mark.requirement("WB-TAB-03")
def test_an_unchanged_executive_table_is_no_change_of_what_is_fixed() -> None:
    assert send(make_bank(), TableNumber.EXECUTIVE, b"[executive]\ncatch_up_ticks = 2\n") is TableFault.NONE


@pytest.mark.requirement("WB-TAB-03")
@pytest.mark.parametrize("refusal", Refusal)
def test_each_reason_against_a_schedule_has_its_code(refusal: Refusal) -> None:
    bank = make_bank(refusal)
    fault = send(bank, SCHEDULE, b'[[schedule]]\ntask = "acquire"\nbudget_ms = 1.0\n')
    assert fault.name == f"SCHEDULE_{refusal.name}"


@pytest.mark.requirement("WB-TAB-03")
def test_what_did_not_come_whole_is_refused_and_may_be_completed() -> None:
    bank = make_bank()
    assert bank.validate(VISION, 0) is TableFault.NOTHING_UPLOADED
    assert send(bank, VISION, GOOD, crc32=1) is TableFault.CRC
    assert bank.validate(IDENTIFY, zlib.crc32(GOOD)) is TableFault.NOTHING_UPLOADED
    bank.upload.begin(VISION, len(GOOD))
    assert bank.validate(VISION, zlib.crc32(GOOD)) is TableFault.GAP
    assert send(bank, VISION, GOOD) is TableFault.NONE
    assert bank.validate(VISION, zlib.crc32(GOOD)) is TableFault.NOTHING_UPLOADED


@pytest.mark.requirement("WB-TAB-04")
def test_abort_forgets_upload_loaded_table_and_plan_of_this_table_only() -> None:
    bank = make_bank()
    send(bank, VISION, GOOD)
    bank.activate([VISION])
    bank.upload.begin(LIMITS, 5)
    bank.abort(IDENTIFY)
    assert bank.pending is not None and bank.upload.number is LIMITS and bank.stores[VISION].loaded is not None
    bank.abort(LIMITS)
    assert bank.upload.number is None
    bank.abort(VISION)
    assert bank.pending is None and bank.stores[VISION].loaded is None


@pytest.mark.requirement("WB-TAB-05")
def test_pieces_may_come_in_any_order_and_more_than_once_but_not_beyond_the_end() -> None:
    upload = Upload()
    assert not upload.put(0, b"abcd")
    assert not upload.begin(VISION, 0) and not upload.begin(VISION, MOST_BYTES + 1)
    assert upload.number is None
    assert upload.begin(VISION, 9)
    assert upload.put(2, b"i\0\0\0") and upload.missing == 0
    assert upload.put(0, b"abcd") and upload.missing == 1
    assert upload.put(1, b"xxxx") and upload.put(1, b"efgh") and upload.missing == -1
    assert upload.content == b"abcdefghi"
    assert not upload.put(3, b"abcd") and not upload.put(-1, b"abcd") and not upload.put(1, b"abc")
    assert upload.begin(LIMITS, MOST_BYTES) and upload.missing == 0
    assert upload.put(MOST_BYTES // CHUNK_BYTES - 1, b"last")
    upload.end()
    assert not upload.put(0, b"abcd") and upload.content == b""


@pytest.mark.requirement("WB-TAB-06")
def test_every_single_flipped_bit_of_an_image_is_found() -> None:
    copy = Copy(VISION, load_flight().vision, 3)
    assert copy.intact and len(copy.image) > HEADER.size
    for bit in range(8 * len(copy.image)):
        copy.image[bit // 8] ^= 1 << bit % 8
        assert not copy.image_whole, f"bit {bit}"
        copy.image[bit // 8] ^= 1 << bit % 8
    assert copy.intact


@pytest.mark.requirement("WB-TAB-06")
@given(number=st.sampled_from(TableNumber), bit=st.integers(0, 10**7), cut=st.integers(1, 30))
def test_no_flipped_bit_or_lost_end_of_any_image_goes_through(number: TableNumber, bit: int, cut: int) -> None:
    image = Copy(number, part_of(load_flight(), number), 1).image
    assert is_whole(number, image)
    assert not is_whole(number, image[:-cut])
    assert not is_whole(number, image[: HEADER.size - 1])
    image[bit % (8 * len(image)) // 8] ^= 1 << bit % 8
    assert not is_whole(number, image)


@pytest.mark.requirement("WB-TAB-07")
@pytest.mark.parametrize("which", TableCopy)
def test_a_damaged_image_or_table_is_made_good_from_the_other_one(which: TableCopy) -> None:
    bank = make_bank()
    send(bank, VISION, GOOD)
    bank.activate([VISION])
    bank.at_boundary()
    send(bank, VISION, b"[vision]\nleast_cells = 30\n")
    scrub, copy = Scrub(bank), bank.stores[VISION].copy(which)
    assert copy is not None
    whole, table = bytes(copy.image), copy.table
    copy.image[HEADER.size + 5] ^= 8
    found = [damage for _ in PLACES if (damage := scrub.step())]
    assert found == [(VISION, which, True, False)]
    assert bytes(copy.image) == whole and copy.table is table
    copy.table = msgspec.structs.replace(table, least_cells=99)
    found = [damage for _ in PLACES if (damage := scrub.step())]
    assert found == [(VISION, which, True, which is TableCopy.ACTIVE)]
    assert copy.table == table and copy.intact
    found = [damage for _ in PLACES if (damage := scrub.step())]
    assert found == []


@pytest.mark.requirement("WB-TAB-07")
def test_a_table_with_no_copy_left_gives_way_to_the_one_before_or_is_told_as_damaged() -> None:
    bank = make_bank()
    first = bank.flight.vision
    send(bank, VISION, GOOD)
    bank.activate([VISION])
    bank.at_boundary()
    scrub = Scrub(bank)

    def ruin(copy: Copy | None) -> None:
        assert copy is not None
        copy.image[HEADER.size] ^= 1
        copy.table = {1, 2}  # what nothing can be made of

    ruin(bank.stores[VISION].active)
    assert [d for _ in PLACES if (d := scrub.step())] == [(VISION, TableCopy.ACTIVE, True, True)]
    assert bank.flight.vision == first and bank.stores[VISION].previous is None
    ruin(bank.stores[VISION].active)
    assert [d for _ in range(2 * len(PLACES)) if (d := scrub.step())] == [(VISION, TableCopy.ACTIVE, False, False)]
    assert scrub.beyond_repair == {VISION}
    bank.stores[VISION].active = Copy(VISION, first, 7)
    assert [d for _ in PLACES if (d := scrub.step())] == []
    assert scrub.beyond_repair == set()
    for which in (TableCopy.LOADED, TableCopy.PREVIOUS):
        send(bank, VISION, GOOD)
        if which is TableCopy.PREVIOUS:
            bank.activate([VISION])
            bank.at_boundary()
        ruin(bank.stores[VISION].copy(which))
        assert [d for _ in PLACES if (d := scrub.step())] == [(VISION, which, True, False)]
        assert bank.stores[VISION].copy(which) is None


@pytest.mark.requirement("WB-TAB-07")
def test_a_damaged_previous_table_never_takes_the_place_of_a_damaged_active_one() -> None:
    bank = make_bank()
    send(bank, VISION, GOOD)
    bank.activate([VISION])
    bank.at_boundary()
    store = bank.stores[VISION]
    assert store.previous is not None
    store.previous.image[3] ^= 1
    active = store.active
    store.discard(TableCopy.ACTIVE)
    assert store.active is active
    assert bank.roll_back([VISION]) is TableFault.DAMAGED


@pytest.fixture(scope="module")
def footage() -> Footage:
    return Footage(small(0.4))


def listening(app: object) -> list[EventRecord]:
    heard: list[EventRecord] = []
    state = app.state  # type: ignore[attr-defined]
    before = state.events.raise_event

    def keep(event, tick, time_ns, arguments):  # type: ignore[no-untyped-def]
        heard.append(EventRecord(event.number, tick, time_ns, 0, tuple(arguments)))
        before(event, tick, time_ns, arguments)

    state.events.raise_event = keep
    return heard


def names(heard: list[EventRecord]) -> list[str]:
    return [EVENT_BY_NUMBER[record.number].name for record in heard]


@pytest.mark.requirement("WB-TAB-01")
def test_in_flight_new_tables_hold_from_the_end_of_a_hyperperiod(footage: Footage, tmp_path: Path) -> None:
    schedule = load_flight().schedule
    rows = [msgspec.to_builtins(row) for row in schedule if row.task != "black_box"]
    toml = "\n".join("[[schedule]]\n" + "\n".join(f"{k} = {v!r}" for k, v in row.items()) for row in rows)
    with flying(footage, tmp_path, 40) as app:
        assert app.tables.load(SCHEDULE, toml.replace("'", '"').encode()) is TableFault.NONE
        assert app.tables.load(VISION, GOOD) is TableFault.NONE
        assert app.tables.load(IDENTIFY, b"[identify]\norder = 20\n") is TableFault.NONE
        assert app.tables.load(LIMITS, b"limit = []\n") is TableFault.NONE
        app.tables.activate([SCHEDULE, VISION, IDENTIFY, LIMITS])
        heard = listening(app)
        while app.step():
            if app.executive.tick == 8:
                assert not heard or "TABLE_ACTIVATED" not in names(heard)
                assert "black_box" in app.executive.tasks
        assert [r.tick for r in heard if EVENT_BY_NUMBER[r.number].name == "TABLE_ACTIVATED"] == [9] * 4
        assert "black_box" not in app.executive.tasks
        assert app._acquire.table.least_cells == 20 == app._vision[1].table.least_cells  # type: ignore[attr-defined]
        assert app._identify.table.order == 20
        assert app.protection.level(111) == 0


@pytest.mark.requirement("WB-TAB-08")
def test_in_flight_a_flipped_bit_is_found_told_and_mended_within_ten_seconds(footage: Footage, tmp_path: Path) -> None:
    draw = np.random.default_rng(7)
    with flying(footage, tmp_path, 150) as app:
        app.step()
        heard = listening(app)
        store = app.tables.stores[LIMITS]
        place = int(draw.integers(len(store.active.image)))
        store.active.image[place] ^= 1 << int(draw.integers(8))
        changed = list(app.tables.stores[VISION].active.table.__struct_fields__)
        msgspec.structs.force_setattr(app.tables.stores[VISION].active.table, changed[2], 13)
        while app.step():
            pass
        told = [name for name in names(heard) if name.startswith("TABLE")]
        assert sorted(told) == ["TABLE_CORRUPT", "TABLE_CORRUPT", "TABLE_REPAIRED", "TABLE_REPAIRED"]
        assert app.state.board.get(TABLE_REPAIRS) == 2 and app.state.board.get(TABLES_CORRUPT) == 0
        assert all(store.active.intact for store in app.tables.stores.values())
        assert app._acquire.table is app.tables.stores[VISION].active.table
        assert app._acquire.table.least_cells == load_flight().vision.least_cells


@pytest.mark.requirement("WB-MEM-04")
def test_in_flight_a_lost_lease_and_a_double_release_are_told(footage: Footage, tmp_path: Path) -> None:
    with flying(footage, tmp_path, 70) as app:
        heard = listening(app)
        app.step()
        lost = app.pools[0].lease("nobody", 1)
        assert lost is not None
        app.pools[1].release(np.zeros(3))
        while app.step():
            pass
        assert names(heard).count("POOL_VIOLATION") == 1
        assert names(heard).count("LEASES_OUTSTANDING") == 1
        assert payload_of([1]) == b"[1]"


@pytest.mark.requirement("WB-TAB-07")
def test_a_table_so_damaged_that_it_has_no_bytes_is_made_good_from_its_image() -> None:
    copy = make_bank().stores[VISION].active
    good = copy.table.least_cells
    msgspec.structs.force_setattr(copy.table, "least_cells", object())
    assert not copy.table_whole and copy.image_whole
    assert copy.repair() and copy.intact and copy.table.least_cells == good
