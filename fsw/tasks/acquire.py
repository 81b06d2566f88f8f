"""acquire: take the pair of this trigger from both cameras, and let only good pairs go on."""

from fault.modes import Cause
from fsw.memory.pool import FramePool
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.frames import FrameCheck, Unfit
from hal.camera import Camera, FrameStamp, FrameStatus
from telemetry.declaration import Event, Point
from telemetry.dictionary import (
    DROP_RATE,
    DROPS_BLACK,
    DROPS_CORRUPT,
    DROPS_DUPLICATE,
    DROPS_LATE,
    DROPS_MEMORY,
    DROPS_MISSING,
    DROPS_SATURATED,
    DROPS_SKEW,
    DROPS_STUCK,
    DROPS_SWAPPED,
    DROPS_TORN,
    ILLUMINATED,
)
from telemetry.events import (
    DARKNESS,
    FRAME_BLACK,
    FRAME_CORRUPT,
    FRAME_DUPLICATE,
    FRAME_LATE,
    FRAME_MISSING,
    FRAME_SATURATED,
    FRAME_SKEW,
    FRAME_STUCK,
    FRAME_SWAPPED,
    FRAME_TORN,
    LIGHT,
    POOL_DENIED,
)

DROPS = (
    DROPS_MISSING, DROPS_DUPLICATE, DROPS_SKEW, DROPS_CORRUPT, DROPS_STUCK, DROPS_SWAPPED, DROPS_LATE, DROPS_BLACK,
    DROPS_SATURATED, DROPS_TORN, DROPS_MEMORY,
)  # fmt: skip
Stamps = tuple[FrameStamp, FrameStamp]
EYES = (0, 1)


class Acquire:
    """Leases two frames, fills them, and gives them back at the end of the tick (`release`).

    A pair is dropped by the first cause that holds, in this order: no memory; a frame is missing, corrupt, a duplicate
    by its camera's count, the other eye's, not of this trigger, not of its partner's; shows nothing, is saturated,
    repeats the frame before in all or in part. Each cause has its counter and its event. Darkness of both eyes is no
    fault: it is told once, and does not count in the drop rate.
    """

    name = "acquire"

    def __init__(
        self, state: State, cameras: tuple[Camera, Camera], pools: tuple[FramePool, FramePool], table: VisionTable
    ) -> None:
        self._state, self._cameras, self._pools, self._table = state, cameras, pools, table
        self._checks = tuple(
            FrameCheck((c.height, c.width), c.dtype, table.black_levels, table.saturated_share) for c in cameras
        )
        self._last = [-1, -1]  # the frames that went before, by their cameras' count
        self._gone = 0  # ticks in a row without a usable pair
        self._leased = False
        self._dark = False
        self._dropped = bytearray(table.drop_window_ticks)  # of the last ticks with light: 1 for a dropped pair
        self._wanted = 0

    @property
    def table(self) -> VisionTable:
        """Its table; a new one holds from the next pair on."""
        return self._table

    @table.setter
    def table(self, table: VisionTable) -> None:
        self._table = table
        for check in self._checks:
            check.black_levels, check.saturated_share = table.black_levels, table.saturated_share

    def init(self) -> None:
        """All counters start at 0, and the kernels run once on dark images, so that no tick compiles anything."""
        self.reset()
        self._state.board.set(DROP_RATE, 0)
        self._state.board.set(ILLUMINATED, 1)
        self._checks[0].init(self._state.pair.left)
        self._checks[1].init(self._state.pair.right)

    def run(self, tick: int, time_ns: int) -> None:
        """Grab both frames; decide whether the pair is usable."""
        state = self._state
        state.pair.usable = self._take(tick) and self._judge(self._grab(), time_ns)
        self._count()
        self._gone = 0 if state.pair.usable else self._gone + 1
        if self._gone >= self._table.hold_after_ticks:
            state.causes |= Cause.FRAMES_GONE
        elif self._gone == 0:
            state.causes |= Cause.FRAMES_BACK

    def reset(self) -> None:
        """Count dropped pairs from 0 again."""
        for point in DROPS:
            self._state.board.set(point, 0)

    def release(self) -> None:
        """Give the frames back. They can still be looked at until the next tick."""
        if self._leased:
            self._pools[0].release(self._state.pair.left)
            self._pools[1].release(self._state.pair.right)
            self._leased = False

    def _take(self, tick: int) -> bool:
        """Lease a frame for each eye, or none."""
        left = self._pools[0].lease(self.name, tick)
        if left is None:
            return self._drop(DROPS_MEMORY, POOL_DENIED, 0)
        right = self._pools[1].lease(self.name, tick)
        if right is None:
            self._pools[0].release(left)
            return self._drop(DROPS_MEMORY, POOL_DENIED, 1)
        self._state.pair.left, self._state.pair.right, self._leased = left, right, True
        return True

    def _grab(self) -> Stamps:
        return self._cameras[0].grab(self._state.pair.left), self._cameras[1].grab(self._state.pair.right)

    def _judge(self, stamps: Stamps, time_ns: int) -> bool:
        return self._delivered(stamps) and self._of_this_trigger(stamps, time_ns) and self._fit(stamps)

    def _delivered(self, stamps: Stamps) -> bool:
        """Each eye delivered a whole new frame of its own."""
        for eye in EYES:
            if stamps[eye].status & FrameStatus.MISSING:
                return self._drop(DROPS_MISSING, FRAME_MISSING, eye)
        for eye in EYES:
            if stamps[eye].status & FrameStatus.CORRUPT:
                return self._drop(DROPS_CORRUPT, FRAME_CORRUPT, eye)
        for eye in EYES:
            if stamps[eye].frame == self._last[eye]:
                return self._drop(DROPS_DUPLICATE, FRAME_DUPLICATE, eye)
        for eye in EYES:
            if stamps[eye].eye not in (eye, -1):
                return self._drop(DROPS_SWAPPED, FRAME_SWAPPED, eye)
        return True

    def _of_this_trigger(self, stamps: Stamps, time_ns: int) -> bool:
        """Both were exposed by this tick's trigger, and together."""
        for eye in EYES:
            late_us = (stamps[eye].time_ns - time_ns) * 1e-3
            if abs(late_us) > self._table.late_limit_us:
                return self._drop(DROPS_LATE, FRAME_LATE, eye, late_us)
        skew_us = (stamps[1].time_ns - stamps[0].time_ns) * 1e-3
        if stamps[0].trigger != stamps[1].trigger or abs(skew_us) > self._table.skew_limit_us:
            return self._drop(DROPS_SKEW, FRAME_SKEW, skew_us, self._table.skew_limit_us)
        return True

    def _fit(self, stamps: Stamps) -> bool:
        """Their pixels show a wing, as far as a sparse sample tells."""
        left, right = self._checks[0].look(self._state.pair.left), self._checks[1].look(self._state.pair.right)
        self._last[0], self._last[1] = stamps[0].frame, stamps[1].frame
        self._light(left is Unfit.BLACK and right is Unfit.BLACK)
        if self._dark:
            self._state.board.add(DROPS_BLACK)
            return False
        for eye, unfit in enumerate((left, right)):
            if unfit is Unfit.BLACK:
                return self._drop(DROPS_BLACK, FRAME_BLACK, eye)
            if unfit is Unfit.SATURATED:
                return self._drop(DROPS_SATURATED, FRAME_SATURATED, eye, self._checks[eye].share_at_top)
            if unfit is Unfit.STUCK:
                return self._drop(DROPS_STUCK, FRAME_STUCK, eye)
            if unfit is Unfit.TORN:
                return self._drop(DROPS_TORN, FRAME_TORN, eye)
        return True

    def _light(self, dark: bool) -> None:
        if dark != self._dark:
            self._dark = dark
            self._state.board.set(ILLUMINATED, 0 if dark else 1)
            self._state.raise_event(DARKNESS if dark else LIGHT)

    def _count(self) -> None:
        """The share of dropped pairs over the last ticks with light."""
        if self._dark:
            return
        self._dropped[self._wanted % len(self._dropped)] = not self._state.pair.usable
        self._wanted += 1
        self._state.board.set(DROP_RATE, sum(self._dropped) / min(self._wanted, len(self._dropped)))

    def _drop(self, counter: Point, event: Event, *arguments: float) -> bool:
        self._state.board.add(counter)
        self._state.raise_event(event, *arguments)
        return False
