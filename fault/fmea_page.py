"""docs/fmea.md: the list of failures and the limit table as a page for people."""

from collections.abc import Iterable, Iterator

from fault.fmea import FMEA, Fault
from fault.limits import Limit
from telemetry.dictionary import POINT_BY_NAME

_HEAD = """\
# Failures and limits

This page is made from the list of failures (`fault/fmea.toml`); a test compares the two. `wingbeat faults` injects
every row into a simulated flight and measures its latency.

- **Found by**: the event that must tell of the failure; after the colon its first argument, where only that one counts.
  A red limit tells of a yellow one too.
- **Within**: ticks from the first tick of the failure to that event, at most.
- **Limits**: their numbers in the table below, by which commands address them.
"""

_LIMITS_HEAD = """\
## Limits as shipped

A sample beyond a threshold is bad, and so is NaN. A limit trips after `set` bad samples in a row, or when more than
one sample in `forgive` + 1 is bad for long; it clears after `clear` good samples in a row, inside by the hysteresis.
Samples that are stale or do not apply count for nothing.
"""


def fmea_page() -> str:
    """The page, as Markdown."""
    return "\n".join([_HEAD, "## Failures", "", *_faults(FMEA), "", _LIMITS_HEAD, *_limits(FMEA), ""])


def _table(columns: str, rows: Iterable[Iterable[str]]) -> Iterator[str]:
    yield f"| {columns} |"
    yield "|" + "---|" * (columns.count("|") + 1)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _faults(faults: Iterable[Fault]) -> Iterator[str]:
    columns = "no. | name | part | failure | effect | found by | within | response | limits"
    return _table(
        columns,
        (
            (
                str(fault.number), f"`{fault.name}`", fault.part, fault.failure, fault.effect, _found_by(fault),
                str(fault.latency_ticks), fault.response, ", ".join(str(limit.number) for limit in fault.limits),
            )
            for fault in faults
        ),
    )  # fmt: skip


def _limits(faults: Iterable[Fault]) -> Iterator[str]:
    columns = "no. | point | per | yellow | red | hysteresis | set | forgive | clear | applies if | response | latch"
    return _table(columns, (_limit(limit) for fault in faults for limit in fault.limits))


def _limit(limit: Limit) -> Iterator[str]:
    unit = POINT_BY_NAME[limit.point].unit
    applies = [*(f"`{name}`" for name in limit.requires), *(f"not `{name}`" for name in limit.excludes)]
    yield from (str(limit.number), f"`{limit.point}`", limit.per)
    yield _pair(limit.low_yellow, limit.high_yellow, unit)
    yield _pair(limit.low_red, limit.high_red, unit)
    yield f"{limit.hysteresis:g}"
    yield from (str(limit.set_after), str(limit.forgive), str(limit.clear_after))
    yield ", ".join(applies)
    yield limit.response if limit.flag is None else f"{limit.response} ({limit.flag})"
    yield limit.latch


def _pair(low: float | None, high: float | None, unit: str) -> str:
    beyond = [f"{sign} {value:g}" for sign, value in (("<", low), (">", high)) if value is not None]
    suffix = "" if unit == "1" else f" {unit}"
    return " or ".join(beyond) + suffix if beyond else ""


def _found_by(fault: Fault) -> str:
    return f"`{fault.detected_by}`" + (f" or `{fault.or_by}`" if fault.or_by else "")
