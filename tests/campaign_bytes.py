"""One flight with several faults at once, as bytes: what the bus, the events and the black box said.

Run as a program it flies in a process of its own, and prints the digest: campaign_bytes.py lockstep|real
"""

import hashlib
import sys
import tempfile
from pathlib import Path

import numpy as np

from hal.clock import Clock
from hal.drivers.lockstep_clock import LockstepClock
from sim.cameras import WorldClock
from sim.campaign_flight import fly
from sim.campaign_stage import FlightStage
from sim.injection import Injection, Shots, Stage
from sim.injection_commands import CommandGarbage
from sim.injection_frames import FrameStuck, FrameTorn, Glint
from sim.injection_memory import BitFlipTable, BusOff, DoubleRelease
from sim.injection_time import TriggerDouble, TriggerMissing

TICKS = 240
FAULTS: list[tuple[type[Injection], int]] = [
    (FrameTorn, 60),
    (CommandGarbage, 65),
    (TriggerMissing, 80),
    (BitFlipTable, 90),
    (FrameStuck, 110),
    (DoubleRelease, 120),
    (TriggerDouble, 130),
    (BusOff, 140),
    (Glint, 150),
]


class Many(Injection):
    """Several faults, one after the other."""

    def __init__(self, seed: int) -> None:
        draw = np.random.default_rng(seed)
        self.parts = [fault(first, draw) for fault, first in FAULTS]
        super().__init__(FAULTS[0][1], draw)

    def active(self, tick: int) -> bool:
        return any(part.active(tick) for part in self.parts)

    def prepare(self, stage: Stage) -> None:
        for part in reversed(self.parts):  # from the end: an edge that is taken away moves the later ones
            part.prepare(stage)

    def before(self, stage: Stage, tick: int) -> None:
        for part in self.parts:
            part.before(stage, tick)

    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        for part in self.parts:
            if part.active(tick):
                part.frames(stage, tick, now, last)


def digests(clock: Clock | None, seed: int = 5) -> dict[str, str]:
    """Digest of the frames on the bus, of the events, and of each black box; clock: the world's, None: lockstep."""
    with tempfile.TemporaryDirectory() as folder:
        stage = FlightStage(TICKS, seed, Path(folder), keep=True, oscillator=clock or LockstepClock())
        fly(stage, Many(seed), lockstep=clock is None)
        parts = {"bus": repr(stage.bus.frames).encode(), "events": bytes(stage.events.lines)}
        parts |= {file.name: file.read_bytes() for file in sorted(Path(folder).glob("black_box_*.mcap"))}
        if stage.app.executive.overruns:
            parts["overruns"] = str(stage.app.executive.overruns).encode()
    return {name: hashlib.sha256(content).hexdigest() for name, content in parts.items()}


if __name__ == "__main__":
    for name, digest in digests(WorldClock() if sys.argv[1] == "real" else None).items():
        print(name, digest)
