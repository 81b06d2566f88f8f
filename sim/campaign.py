"""The fault campaign: which flights to fly, worker processes that fly them, and one row of figures for each fault."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from msgspec import Struct

from fault.fmea import FAULT_BY_NAME, FMEA, Fault
from sim.campaign_flight import Order, fly_order
from sim.campaign_judge import Findings
from sim.campaign_stage import RATE_HZ
from wingbeat.errors import InputError

NOMINAL_TICKS = 9000  # of one flight: the hours are flown in pieces, side by side
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Row(Struct, frozen=True, kw_only=True):
    """A fault's flights. found, misses, late: of all runs; recovered: of those that were flown to their end.

    misleading and false_alarms count messages and events.
    """

    fault: str
    runs: int
    whole_runs: int
    detected: int
    misses: int
    late: int
    latency_ticks_p50: float | None
    latency_ticks_max: int | None
    latency_limit_ticks: int
    misleading: int
    false_alarms: int
    recovered: int
    must_recover: int
    errors: int

    @property
    def good(self) -> bool:
        """Nothing speaks against it."""
        wrong = self.misses + self.late + self.misleading + self.false_alarms + self.errors
        return wrong == 0 and self.recovered >= self.must_recover


def chosen_faults(names: str | None) -> list[Fault]:
    """Rows of the failure list by their names, separated by commas; all for None. Raises InputError."""
    if names is None:
        return list(FMEA)
    for name in names.split(","):
        if name not in FAULT_BY_NAME:
            raise InputError("is no row of the failure list", name, "take names from docs/fmea.md")
    return [FAULT_BY_NAME[name] for name in names.split(",")]


def orders_for(
    faults: Sequence[Fault], runs: int, seed: int, surrogate_only: bool, nominal_hours: float
) -> list[Order]:
    """All flights: the rows in turn, the first flight of each through the whole chain, then the nominal hours.

    Whatever takes longest comes first, so that no worker is left alone with it.
    """
    orders = []
    for number in range(runs):
        run, place = divmod(number, len(faults))
        orders.append(Order(faults[place], run, seed, whole=run == 0 and not surrogate_only))
    ticks = round(nominal_hours * 3600.0 * RATE_HZ)
    pieces = [NOMINAL_TICKS] * (ticks // NOMINAL_TICKS) + ([ticks % NOMINAL_TICKS] if ticks % NOMINAL_TICKS else [])
    nominal = [Order(None, run, seed, ticks=piece) for run, piece in enumerate(pieces)]
    return [*nominal, *sorted(orders, key=lambda order: not order.whole)]


def fly_all(orders: Sequence[Order], jobs: int, each: Callable[[], None] = lambda: None) -> list[Findings]:
    """Fly them in so many processes; what they show, in the order of `orders`. each is called after every flight."""
    if jobs == 1:
        found = []
        for order in orders:
            found.append(fly_safely(order))
            each()
        return found
    shown: list[Findings | None] = [None] * len(orders)
    with one_thread_each(), multiprocessing.get_context("spawn").Pool(min(jobs, max(len(orders), 1))) as pool:
        for number, findings in pool.imap_unordered(_numbered, enumerate(orders)):
            shown[number] = findings
            each()
    return [findings for findings in shown if findings is not None]


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that begin meanwhile compute with one thread each."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def fly_safely(order: Order) -> Findings:
    """Fly an order; an exception that leaves the application ends this flight, and counts, but not the campaign."""
    try:
        return fly_order(order)
    except Exception as error:
        limit = order.fault.latency_ticks if order.fault else None
        text = f"{type(error).__name__}: {error}"
        return Findings(
            fault=order.name, run=order.run, whole=order.whole, ticks=0, latency_limit_ticks=limit, error=text
        )


def _numbered(numbered: tuple[int, Order]) -> tuple[int, Findings]:
    number, order = numbered
    return number, fly_safely(order)


def rows_of(findings: Sequence[Findings]) -> list[Row]:
    """One row for each fault that was flown, in order of the failure list."""
    rows = []
    for fault in FMEA:
        flights = [flight for flight in findings if flight.fault == fault.name]
        if flights:
            rows.append(_row(fault, flights))
    return rows


def _row(fault: Fault, flights: Sequence[Findings]) -> Row:
    latencies = [flight.latency_ticks for flight in flights if flight.latency_ticks is not None]
    ended = [flight for flight in flights if flight.recovered is not None]
    return Row(
        fault=fault.name,
        runs=len(flights),
        whole_runs=sum(flight.whole for flight in flights),
        detected=len(latencies),
        misses=sum(flight.missed for flight in flights),
        late=sum(flight.late for flight in flights),
        latency_ticks_p50=float(np.median(latencies)) if latencies else None,
        latency_ticks_max=max(latencies, default=None),
        latency_limit_ticks=fault.latency_ticks,
        misleading=sum(len(flight.misleading) for flight in flights),
        false_alarms=sum(len(flight.false_alarms) for flight in flights),
        recovered=sum(bool(flight.recovered) for flight in ended),
        must_recover=len(ended) if fault.recovers else 0,
        errors=sum(bool(flight.error) for flight in flights),
    )
