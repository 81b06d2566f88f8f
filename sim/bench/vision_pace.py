"""Table `pace`: the paper camera's full rate in real time, from a ring of pairs drawn beforehand."""

import time

import numpy as np

from hal.drivers.realtime_clock import RealtimeClock
from sim.bench.table import Row
from sim.bench.vision_stand import Stand, bench_scenario, hardware, load, pair_of
from sim.world import World

RATE_HZ = 46.0
RING = 24  # pairs of half a second of motion; read forwards and backwards, so that the wing never jumps
_LEAD_NS = 200_000_000


def pace(seconds: float, seed: int) -> list[Row]:
    """One row: slots lost while pairs come at RATE_HZ for so long; a pair not begun within its slot is lost."""
    scenario = bench_scenario(1, RING, RATE_HZ)
    world = World(scenario, seed)
    pairs = [pair_of(world, tick) for tick in range(RING)]
    ring = [*range(RING), *range(RING - 2, 0, -1)]
    stand = Stand(*hardware(scenario), pairs[0])
    found = stand.acquire(*pairs[0])
    if not found.ok:
        raise RuntimeError(f"ACQUIRE: {found.reason}")
    ticks, slot_ns = round(seconds * RATE_HZ), round(1e9 / RATE_HZ)
    wall, cpu, late, lost, valid = [], [], [], 0, []
    before = load()
    clock = RealtimeClock()
    for k in range(ticks):
        due = _LEAD_NS + k * slot_ns
        if clock.now_ns() >= due + slot_ns:
            lost += 1
            continue
        clock.sleep_until_ns(due)
        begun, used = clock.now_ns(), time.process_time_ns()
        stand.tick(*pairs[ring[k % len(ring)]])
        wall.append((clock.now_ns() - begun) * 1e-6)
        cpu.append((time.process_time_ns() - used) * 1e-6)
        late.append((begun - due) * 1e-6)
        valid.append(int(stand.tracker.points.valid.sum()))
    stand.close()
    return [
        {
            "table": "pace",
            "method": "ours",
            "case": f"{RATE_HZ:g} pairs/s for {seconds:g} s",
            "ticks": ticks,
            "ticks_lost": lost,
            "slot_ms": slot_ns * 1e-6,
            "wall_ms_p50": float(np.median(wall)),
            "wall_ms_p99": float(np.percentile(wall, 99)),
            "wall_ms_max": float(np.max(wall)),
            "over_slot": int((np.array(wall) > slot_ns * 1e-6).sum()),
            "start_late_ms_p99": float(np.percentile(late, 99)),
            "cpu_ms_p50": float(np.median(cpu)),
            "least_valid": int(np.min(valid)),
            "load_1min_before": before,
            "load_1min_after": load(),
        }
    ]
