"""The soak: one long flight in the small world, without a fault, and what it leaves in memory."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from msgspec import Struct

from sim.campaign_flight import manoeuvre, steps
from sim.campaign_stage import FlightStage
from sim.injection import Injection

WARM_UP_TICKS = 3000  # the record is full and identified, a manoeuvre is flown, and memory is as it will stay
MOST_GROWTH_MIB = 1.0
LATEST = 100  # packets and events that are kept
STRETCH_TICKS = 500  # resident memory is read so often


class Figures(Struct, frozen=True):
    """Of a soak. growth_mib: of resident memory after the warm-up, the highest reading; leases: frames out at the end
    of a tick, at most; denied, violations: of the pools.
    """

    ticks: int
    growth_mib: float
    resident_mib: float
    leases: int
    denied: int
    violations: int
    critical_events: int
    valid_at_end: bool

    @property
    def good(self) -> bool:
        """Memory is flat and nothing was lost."""
        lost = self.leases + self.denied + self.violations + self.critical_events
        return self.growth_mib < MOST_GROWTH_MIB and lost == 0 and self.valid_at_end


def soak(ticks: int, seed: int, each_tick: Callable[[], None] = lambda: None) -> Figures:
    """Fly so many ticks in this process."""
    draw = np.random.default_rng([seed, ticks])
    with tempfile.TemporaryDirectory() as folder:
        stage = FlightStage(ticks, int(draw.integers(1 << 31)), Path(folder), most=LATEST)
        manoeuvre(stage, ticks, draw)
        leases = 0
        before = highest = 0.0
        for tick, _ in enumerate(steps(stage, Injection(ticks, draw))):
            leases = max(leases, *(pool.leased for pool in stage.app.pools))
            if tick == min(WARM_UP_TICKS, ticks // 2):
                before = highest = resident_mib()
            elif tick % STRETCH_TICKS == 0:
                highest = max(highest, resident_mib())
            each_tick()
        pools = stage.app.pools
        highest = max(highest, resident_mib())
        return Figures(
            ticks,
            highest - before,
            highest,
            leases,
            sum(pool.denied for pool in pools),
            sum(pool.violations for pool in pools),
            stage.events.alarms,
            bool(stage.bus.heard) and bool(stage.bus.heard[-1].valid),
        )


def soak_text(figures: Figures) -> str:
    """The figures for people."""
    return (
        f"{figures.ticks} ticks: resident memory {figures.resident_mib:.1f} MiB, {figures.growth_mib:+.2f} MiB since "
        f"the warm-up\nframes out after a tick: {figures.leases}; denied {figures.denied}; violations "
        f"{figures.violations}; critical events {figures.critical_events}; "
        f"modes are {'valid' if figures.valid_at_end else 'NOT valid'} at the end"
    )


def resident_mib() -> float:
    """Memory of this process that is in the machine's."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**20
