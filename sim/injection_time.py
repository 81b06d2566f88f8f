"""Faults of the trigger, of mission time and of the executive."""

from collections.abc import Sequence

import numpy as np

from fsw.executive.entry import Entry, FrameTask, LongTask
from sim.edges import Exposure, Jump
from sim.injection import Injection, Now, Shots, Stage

MS = 1_000_000


class TriggerFault(Injection):
    """Edits the edge of its first tick; share: of a period, beyond the window."""

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.share = float(draw.uniform(0.24, 0.45))

    def move(self, stage: Stage, by_ns: int) -> None:
        """Another moment for that edge."""
        edge = stage.edges[self.first]
        stage.edges[self.first] = Exposure(edge.time_ns + by_ns, edge.picture)


class TriggerMissing(TriggerFault):
    def prepare(self, stage: Stage) -> None:
        del stage.edges[self.first]


class TriggerEarly(TriggerFault):
    def prepare(self, stage: Stage) -> None:
        self.move(stage, -round(self.share * stage.period_ns))


class TriggerLate(TriggerFault):
    def prepare(self, stage: Stage) -> None:
        self.move(stage, round(self.share * stage.period_ns))


class TriggerDouble(TriggerFault):
    def prepare(self, stage: Stage) -> None:
        edge = stage.edges[self.first]
        after_ns = round(self.draw.uniform(0.2, 12.0) * MS)
        stage.edges.insert(self.first + 1, Exposure(edge.time_ns + after_ns, -1))


class TriggerDead(TriggerFault):
    LASTS = (4, 60)

    def prepare(self, stage: Stage) -> None:
        del stage.edges[self.first : self.end]


class ClockJump(Injection):
    """Forward or back, by 20 ms to 60 s, at any moment between two edges."""

    def prepare(self, stage: Stage) -> None:
        size_s = float(np.exp(self.draw.uniform(np.log(0.02), np.log(60.0)))) * (1.0 if self.draw.integers(2) else -1.0)
        at_ns = stage.edges[self.first].time_ns + round(self.draw.uniform(0.05, 0.9) * stage.period_ns)
        stage.clock.jump = Jump(at_ns, round(size_s * 1e9))


class SlowCamera(Injection):
    LASTS = (1, 6)

    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        """The grab takes more than a period."""
        oscillator = stage.clock.oscillator
        oscillator.sleep_until_ns(oscillator.now_ns() + round(self.draw.uniform(1.05, 1.8) * stage.period_ns))


class Watchdog(Injection):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        """The grab hangs for longer than the watchdog waits."""
        oscillator = stage.clock.oscillator
        oscillator.sleep_until_ns(oscillator.now_ns() + round(self.draw.uniform(2.2, 3.5) * 1e9))


class TaskHang(Injection):
    LASTS = (30, 90)

    def patience(self, entry: Entry, tick: int) -> bool:
        """The identification is not done."""
        hangs = entry.slot.task == "identify" and self.active(tick)
        return not hangs and entry.done.wait()


class TaskFailure(Injection):
    """The task feature raises an exception, once."""

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.spent = False

    def tasks(self, tasks: Sequence[FrameTask | LongTask], tick: Now) -> Sequence[FrameTask | LongTask]:
        """The same tasks, one of them with a defect."""
        return [
            Defect(task, self, tick) if isinstance(task, FrameTask) and task.name == "feature" else task
            for task in tasks
        ]


class Defect:
    """A task that ends with an error that nobody foresaw."""

    def __init__(self, task: FrameTask, failure: TaskFailure, tick: Now) -> None:
        self.name, self.init = task.name, task.init
        self._task, self._failure, self._tick = task, failure, tick

    def run(self, tick: int, time_ns: int) -> None:
        """As the task, but for the defect."""
        if self._failure.active(self._tick()) and not self._failure.spent:
            self._failure.spent = True
            raise ZeroDivisionError("a defect")
        self._task.run(tick, time_ns)
