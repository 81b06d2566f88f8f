"""The list of failures is whole: every row can be found, its limits can work, and the page says what the list says."""

import msgspec
import pytest

from fault.fmea import FAULT_BY_NAME, FMEA, Fault, limit_rows, shipped_limits
from fault.fmea_page import fmea_page
from fault.limits import Limit, faults_in
from telemetry import dictionary as d
from telemetry import events

POINTS_OF_THE_FLIGHT = {  # what the flight core must watch
    "cmp", "recall", "points", "reprojection_rms_px", "epipolar_rms_px", "amplitude_coherence", "frequency_uncertainty",
    "frequency_jump", "damping_ratio", "age_ticks", "drop_rate", "overrun", "bus_errors", "storage_failed",
    "free_wheel", "tables_corrupt", "pool_violations", "leases_outstanding", "tasks_silent",
}  # fmt: skip


def fault(**changes: object) -> Fault:
    values = {
        "number": 1, "name": "a", "part": "camera", "failure": "f", "effect": "e", "detected_by": "LIMIT_RED:cmp",
        "response": "r", "latency_ticks": 1, **changes,
    }  # fmt: skip
    return msgspec.convert(values, Fault)


@pytest.mark.requirement("WB-FLT-12")
def test_rows_are_numbered_in_order_and_named_apart() -> None:
    assert [row.number for row in FMEA] == list(range(1, len(FMEA) + 1))
    assert list(FAULT_BY_NAME.values()) == list(FMEA) and list(FAULT_BY_NAME) == [row.name for row in FMEA]
    assert len(FAULT_BY_NAME) == len(FMEA) >= 39


@pytest.mark.requirement("WB-FLT-12")
@pytest.mark.parametrize("row", FMEA, ids=lambda row: row.name)
def test_every_failure_is_told_by_an_event_that_exists(row: Fault) -> None:
    name, _, argument = row.detected_by.partition(":")
    assert row.event is events.EVENT_BY_NAME[name]
    if argument:
        assert argument in (row.event.arguments[0].choices or {}).values()
    assert all(limit.number // 10 == row.number for limit in row.limits)


@pytest.mark.requirement("WB-FLT-12")
def test_the_limits_of_all_rows_are_the_limit_table() -> None:
    limits = shipped_limits()
    assert faults_in(limits) == ""
    assert {limit.point for limit in limits} == POINTS_OF_THE_FLIGHT
    assert msgspec.convert(limit_rows(), list[Limit]) == limits
    assert [limit.number for limit in limits] == sorted({limit.number for limit in limits})


def test_a_failure_that_a_limit_finds_leaves_it_the_samples_that_it_needs() -> None:
    setting = {limit.point: limit.set_after for limit in shipped_limits()}
    for row in FMEA:
        point = row.detected_by.partition(":")[2]
        assert row.latency_ticks >= setting.get(point, 1)


@pytest.mark.requirement("WB-FLT-07")
def test_scene_limits_need_light_and_limits_of_modes_need_motion() -> None:
    for limit in shipped_limits():
        if limit.per == "frame" or limit.point == "drop_rate":
            assert limit.requires == ("illuminated",)
        elif limit.per == "estimate":
            assert limit.requires[:2] == ("observable", "frequency_hz") and limit.excludes == ("identified_flags",)


@pytest.mark.requirement("WB-FLT-12")
@pytest.mark.parametrize(
    ("detected_by", "event", "first", "told"),
    [
        ("LIMIT_RED:cmp", events.LIMIT_RED, "cmp", True),
        ("LIMIT_RED:cmp", events.LIMIT_RED, "mu", False),
        ("LIMIT_RED:cmp", events.LIMIT_YELLOW, "cmp", False),
        ("LIMIT_YELLOW:cmp", events.LIMIT_YELLOW, "cmp", True),
        ("LIMIT_YELLOW:cmp", events.LIMIT_RED, "cmp", True),
        ("LIMIT_YELLOW:cmp", events.LIMIT_RED, "mu", False),
        ("LIMIT_YELLOW:cmp", events.LIMIT_CLEARED, "cmp", False),
        ("LIMIT_RED", events.LIMIT_RED, "mu", True),
        ("BUS_DROPPED", events.LIMIT_RED, "mu", False),
    ],
)
def test_an_event_tells_of_a_failure_by_its_name_and_first_argument(
    detected_by: str, event: events.Event, first: str, told: bool
) -> None:
    assert fault(detected_by=detected_by).detected_in(event.number, (d.POINT_NUMBER[first], 0.0)) is told


def test_an_event_without_arguments_tells_by_its_name() -> None:
    assert fault(detected_by="DARKNESS").detected_in(events.DARKNESS.number, ())
    assert not fault(detected_by="DARKNESS:LEFT").detected_in(events.DARKNESS.number, ())
    assert not fault(detected_by="MODE_INVALID:cmp").detected_in(events.MODE_INVALID.number, (0.0, 0.0))


@pytest.mark.parametrize("changes", [{"name": "Two Words"}, {"part": "moon"}, {"latency_ticks": 0}, {"more": 1}])
def test_a_row_that_says_nothing_sensible_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        fault(**changes)


@pytest.mark.requirement("WB-FLT-12")
def test_the_page_shows_every_failure_and_every_limit_in_a_row() -> None:
    lines = fmea_page().splitlines()
    rows = [line for line in lines if line.startswith("| ") and not line.startswith("| no.")]
    assert len(rows) == len(FMEA) + len(shipped_limits())
    assert rows[0] == (
        "| 1 | `frame_missing` | camera | an eye's frame does not come | no points in this tick; after 5 ticks the "
        "prediction is void | `FRAME_MISSING` | 1 | pair dropped and counted; HOLD after 5 ticks; modes withdrawn when "
        "half of the pairs are lost | 11 |"
    )
    for expected in (
        "| 151 | `reprojection_rms_px` | frame | > 0.2 px | > 0.4 px | 0.02 | 5 | 4 | 15 | `illuminated` | "
        "degrade (poor_scene) | auto |",
        "| 351 | `damping_ratio` | estimate |  | < 0 or > 0.2 | 0 | 1 | 4 | 2 | `observable`, `frequency_hz`, "
        "`damping_ratio`, not `identified_flags` | invalidate (overdamped) | auto |",
        "| 311 | `pool_violations` | tick |  | > 0.5 | 0 | 1 | 4 | 1 |  | report | latched |",
    ):
        assert expected in rows
    for head in [line for line in lines if line.startswith("| no.")]:
        assert lines[lines.index(head) + 1] == "|" + "---|" * head.count(" | ") + "---|"
    assert lines[0] == "# Failures and limits" and lines.count("") == 7 and fmea_page().endswith("|\n")
    assert "  " not in rows[0]
    assert rows[1].endswith("| pair dropped and counted |  |")
    headings = [line for line in lines if line.startswith("#")]
    assert headings == ["# Failures and limits", "## Failures", "## Limits as shipped"]


@pytest.mark.requirement("WB-FLT-12")
def test_a_failure_that_looks_like_another_one_is_found_by_either_event() -> None:
    jump, double = FAULT_BY_NAME["clock_jump"], FAULT_BY_NAME["trigger_double"]
    assert jump.detected_in(events.CLOCK_JUMP.number, (20.0,)) and jump.detected_in(events.TRIGGER_GAP.number, (1.0,))
    assert not double.detected_in(events.TRIGGER_GAP.number, (1.0,))
