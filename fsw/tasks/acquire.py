"""acquire: take the pair of this trigger from both cameras, and let only good pairs go on."""

import numpy as np

from fault.modes import Cause
from fsw.memory.pool import FramePool
from fsw.tasks.state import State
from hal.camera import Camera, FrameStamp, FrameStatus
from telemetry.declaration import Event, Point
from telemetry.dictionary import DROPS_CORRUPT, DROPS_MISSING, DROPS_SKEW, DROPS_STUCK
from telemetry.events import FRAME_CORRUPT, FRAME_MISSING, FRAME_SKEW, FRAME_STUCK

SAMPLE_STEP = 16  # every so many pixels, both ways, are compared with the frame before


class Acquire:
    """Leases two frames, fills them, gives them back at the next tick.

    A pair is dropped, by the first cause that holds: a frame is missing, corrupt, of another exposure than its
    partner (trigger or time), or the same frame as before, by its number or by every pixel of a sparse sample: noise
    makes no two images alike. Each cause has its counter and its event.
    """

    name = "acquire"

    def __init__(
        self, state: State, cameras: tuple[Camera, Camera], pools: tuple[FramePool, FramePool], skew_limit_us: float,
        hold_after_ticks: int,
    ) -> None:  # fmt: skip
        self._state, self._cameras, self._pools = state, cameras, pools
        self._skew_limit_ns, self._hold_after = round(skew_limit_us * 1000.0), hold_after_ticks
        self._last = [-1, -1]  # the frames that went before, by their cameras' count
        self._gone = 0  # ticks in a row without a usable pair
        self._leased = False
        shapes = [pair[::SAMPLE_STEP, ::SAMPLE_STEP] for pair in (state.pair.left, state.pair.right)]
        self._samples = [(np.zeros_like(s), np.zeros(s.shape, np.bool_)) for s in shapes]

    def init(self) -> None:
        """All counters start at 0."""
        for point in (DROPS_MISSING, DROPS_SKEW, DROPS_CORRUPT, DROPS_STUCK):
            self._state.board.set(point, 0)

    def run(self, tick: int, time_ns: int) -> None:
        """Grab both frames; decide whether the pair is usable."""
        state = self._state
        self.release()
        left, right = self._pools[0].lease(self.name), self._pools[1].lease(self.name)
        assert left is not None and right is not None  # each pool holds the two frames that are ever out
        state.pair.left, state.pair.right, self._leased = left, right, True
        stamps = (self._cameras[0].grab(left), self._cameras[1].grab(right))
        state.pair.usable = self._judge(stamps)
        self._gone = 0 if state.pair.usable else self._gone + 1
        if self._gone >= self._hold_after:
            state.causes |= Cause.FRAMES_GONE
        elif self._gone == 0:
            state.causes |= Cause.FRAMES_BACK

    def release(self) -> None:
        """Give the frames back."""
        if self._leased:
            self._pools[0].release(self._state.pair.left)
            self._pools[1].release(self._state.pair.right)
            self._leased = self._state.pair.usable = False

    def _judge(self, stamps: tuple[FrameStamp, FrameStamp]) -> bool:
        for eye, stamp in enumerate(stamps):
            if stamp.status & FrameStatus.MISSING:
                return self._drop(DROPS_MISSING, FRAME_MISSING, eye)
        for eye, stamp in enumerate(stamps):
            if stamp.status & FrameStatus.CORRUPT:
                return self._drop(DROPS_CORRUPT, FRAME_CORRUPT, eye)
        skew_ns = stamps[1].time_ns - stamps[0].time_ns
        if stamps[0].trigger != stamps[1].trigger or abs(skew_ns) > self._skew_limit_ns:
            return self._drop(DROPS_SKEW, FRAME_SKEW, skew_ns / 1000.0, self._skew_limit_ns / 1000.0)
        for eye, stamp in enumerate(stamps):
            repeated = self._repeats(eye)
            if stamp.frame == self._last[eye] or repeated:
                return self._drop(DROPS_STUCK, FRAME_STUCK, eye)
        self._last[0], self._last[1] = stamps[0].frame, stamps[1].frame
        return True

    def _repeats(self, eye: int) -> bool:
        """Whether the sample of this frame is that of the frame before; keeps it for the next."""
        image = self._state.pair.left if eye == 0 else self._state.pair.right
        now = image[::SAMPLE_STEP, ::SAMPLE_STEP]
        before, same = self._samples[eye]
        np.equal(now, before, out=same)
        np.copyto(before, now)
        return bool(same.all())

    def _drop(self, counter: Point, event: Event, *arguments: float) -> bool:
        self._state.board.add(counter)
        self._state.raise_event(event, *arguments)
        return False
