"""What the fault campaign says: a table for people, a document for programs, and whether all is well."""

from collections.abc import Sequence
from typing import Any

import msgspec

from sim.campaign import Row, rows_of
from sim.campaign_judge import Findings
from sim.campaign_stage import RATE_HZ

HEAD = ("fault", "runs", "whole", "found", "p50", "max", "limit", "miss", "late", "false", "mislead", "recov")


def campaign_document(findings: Sequence[Findings], seed: int) -> dict[str, Any]:
    """The JSON document. All but the machine's own affairs is the same for the same seed."""
    rows, nominal = rows_of(findings), [flight for flight in findings if flight.fault == "nominal"]
    document = {
        "rows": [msgspec.to_builtins(row) | {"good": row.good} for row in rows],
        "runs": sum(row.runs for row in rows),
        "seed": seed,
        "nominal_hours": sum(flight.ticks for flight in nominal) / RATE_HZ / 3600.0,
        "nominal_messages": sum(flight.messages for flight in nominal),
        "nominal_valid_messages": sum(flight.valid_messages for flight in nominal),
        "nominal_false_alarms": sum(len(flight.false_alarms) for flight in nominal),
        "nominal_misleading": sum(len(flight.misleading) for flight in nominal),
        "misses": sum(row.misses for row in rows),
        "late": sum(row.late for row in rows),
        "false_alarms": sum(row.false_alarms for row in rows),
        "misleading": sum(row.misleading for row in rows),
        "messages": sum(flight.messages for flight in findings),
        "remarks": remarks(findings),
    }
    return document | {"good": is_good(rows, nominal)}


def is_good(rows: Sequence[Row], nominal: Sequence[Findings]) -> bool:
    """Whether nothing was missed, late, misleading or a false alarm, and everything recovered that must."""
    quiet = all(not (flight.false_alarms or flight.misleading or flight.error) for flight in nominal)
    return quiet and all(row.good for row in rows)


def remarks(findings: Sequence[Findings]) -> list[str]:
    """A line for each flight that something speaks against."""
    lines = []
    for flight in findings:
        wrong = [flight.error] if flight.error else []
        wrong += ["missed"] if flight.missed else []
        wrong += [f"found after {flight.latency_ticks} ticks"] if flight.late else []
        wrong += [f"false alarm {alarm}" for alarm in flight.false_alarms[:1]]
        wrong += [f"misleading {message}" for message in flight.misleading[:1]]
        wrong += ["not recovered"] if flight.recovered is False and flight.fault != "nominal" else []
        if wrong:
            chain = ", whole chain" if flight.whole else ""
            lines.append(f"{flight.fault}, run {flight.run}{chain}: {'; '.join(wrong)}")
    return lines


def campaign_table(findings: Sequence[Findings]) -> str:
    """One line a fault, latencies in ticks, then the sums."""
    rows = rows_of(findings)
    lines = [HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(line[place]) for line in lines) for place in range(len(HEAD))]
    text = [
        "  ".join(cell.ljust(width) if place == 0 else cell.rjust(width) for place, (cell, width) in enumerate(pairs))
        for pairs in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    document = campaign_document(findings, 0)
    text.append("")
    text.append(
        f"{document['runs']} runs: {document['misses']} misses, {document['late']} late, "
        f"{document['false_alarms']} false alarms, {document['misleading']} misleading "
        f"of {document['messages']} messages"
    )
    if document["nominal_hours"]:
        text.append(
            f"{document['nominal_hours']:.2f} h without a fault: {document['nominal_false_alarms']} false alarms, "
            f"{document['nominal_misleading']} misleading of {document['nominal_messages']} messages, "
            f"{document['nominal_valid_messages']} valid"
        )
    return "\n".join([*text, *document["remarks"]])


def _cells(row: Row) -> tuple[str, ...]:
    middle = "-" if row.latency_ticks_p50 is None else f"{row.latency_ticks_p50:g}"
    longest = "-" if row.latency_ticks_max is None else str(row.latency_ticks_max)
    counts = (row.misses, row.late, row.false_alarms, row.misleading)
    ended = row.runs - row.whole_runs
    return (
        row.fault,
        str(row.runs),
        str(row.whole_runs),
        str(row.detected),
        middle,
        longest,
        str(row.latency_limit_ticks),
        *map(str, counts),
        f"{row.recovered}/{ended}",
    )
