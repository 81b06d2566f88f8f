"""What a flight of the campaign shows: when the fault was found, false alarms before it, and misleading messages.

A message is misleading when a mode was sent on the bus as valid whose frequency differs from every natural frequency in
force by more than three of its standard deviations and by more than half a per cent. In force are those that held at
some moment of the grace before the end of the record behind the message: as long as the failure's latency allows, for
no one can know sooner.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from msgspec import Struct

from fault.fmea import Fault
from sim.injection import Injection
from sim.lines import Heard, SentMode
from sim.stores import Told
from sim.surrogate_motion import ModalMotion
from telemetry.declaration import Severity
from telemetry.dictionary import FlightMode
from telemetry.events import EVENT_BY_NUMBER, LIMIT_RED, MODE_CHANGED, MODE_INVALID

if TYPE_CHECKING:
    from sim.campaign_flight import Order

SIGMAS, SHARE = 3.0, 0.005
NO_GRACE_TICKS = 1


class Findings(Struct, frozen=True, kw_only=True):
    """Of one flight. latency_ticks: None if the fault was not found; latency_limit_ticks: what the row allows.

    recovered: it measures again at the end; None where it ends before. error: what ended the flight, or nothing.
    """

    fault: str
    run: int
    whole: bool
    ticks: int
    first_tick: int = -1
    latency_ticks: int | None = None
    latency_limit_ticks: int | None = None
    false_alarms: list[str] = []
    misleading: list[str] = []
    messages: int = 0
    valid_messages: int = 0
    valid_before: bool = False
    recovered: bool | None = None
    error: str = ""

    @property
    def late(self) -> bool:
        """Found, but not in time."""
        found, limit = self.latency_ticks, self.latency_limit_ticks
        return found is not None and limit is not None and found > limit

    @property
    def missed(self) -> bool:
        """There was a fault, and it was not found."""
        return self.latency_ticks is None and (self.latency_limit_ticks is not None or bool(self.error))


def judge(
    order: "Order",
    injection: Injection,
    ticks: int,
    told: Sequence[Told],
    heard: Sequence[Heard],
    motion: ModalMotion,
    period_ns: int,
) -> Findings:
    """Judge a flight of so many ticks by what was sent. told, heard: in order of time."""
    first, fault = injection.first, order.fault
    grace = fault.latency_ticks if fault else NO_GRACE_TICKS
    before = [packet for packet in heard if packet.at_tick < first]
    return Findings(
        fault=order.name,
        run=order.run,
        whole=order.whole,
        ticks=ticks,
        first_tick=first,
        latency_ticks=None if fault is None else _latency(fault, first, told, heard),
        latency_limit_ticks=None if fault is None else fault.latency_ticks,
        false_alarms=[
            f"tick {event.at_tick}: {event.name}" for event in told if event.at_tick < first and alarms(event)
        ],
        misleading=[
            f"tick {packet.at_tick}: slot {mode.slot} {mode.frequency_hz:.5f} Hz, sigma {mode.sigma_hz:.2g}"
            for packet in heard
            for mode in packet.valid
            if misleads(mode, packet.at_tick, grace, motion, period_ns)
        ],
        messages=len(heard),
        valid_messages=sum(bool(packet.valid) for packet in heard),
        valid_before=bool(before) and bool(before[-1].valid),
        recovered=None if order.whole else _measures(told, heard),
    )


def misleads(mode: SentMode, at_tick: int, grace: int, motion: ModalMotion, period_ns: int) -> bool:
    """Whether a valid mode of a packet sent at this tick has no true frequency that it may stand for."""
    end_s = (at_tick - mode.age_ticks) * period_ns * 1e-9
    true_hz = motion.frequencies_hz(end_s - grace * period_ns * 1e-9, end_s)
    return all(abs(mode.frequency_hz - true) > max(SIGMAS * mode.sigma_hz, SHARE * true) for true in true_hz)


def alarms(event: Told) -> bool:
    """Whether an event is an alarm: critical, a red limit, or the end of TRACK."""
    left = event.number == MODE_CHANGED.number and event.arguments[0] == FlightMode.TRACK
    critical = EVENT_BY_NUMBER[event.number].severity is Severity.CRITICAL
    return left or critical or event.number == LIMIT_RED.number


def _latency(fault: Fault, first: int, told: Sequence[Told], heard: Sequence[Heard]) -> int | None:
    """Ticks from the fault to the event that tells of it; a withdrawn mode tells by being withdrawn."""
    found = [
        event.at_tick for event in told if event.at_tick >= first and fault.detected_in(event.number, event.arguments)
    ]
    if fault.event is MODE_INVALID:
        found += [packet.at_tick for packet in heard if packet.at_tick >= first and not packet.valid]
    return min(found) - first if found else None


def _measures(told: Sequence[Told], heard: Sequence[Heard]) -> bool:
    """Whether the flight is in TRACK at the end, and sends valid modes."""
    modes = [event.arguments[1] for event in told if event.number == MODE_CHANGED.number]
    return bool(modes) and modes[-1] == FlightMode.TRACK and bool(heard) and bool(heard[-1].valid)
