"""Faults of cameras and light."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.camera import FrameStatus
from sim.injection import Injection, Shots, Stage


class FrameFault(Injection):
    """Something is wrong with the frames of one eye, for a few ticks."""

    LASTS = (1, 12)

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.eye = int(draw.integers(2))
        self.share = float(draw.uniform(0.2, 0.8))


class FrameMissing(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        now[self.eye].stamp = now[self.eye].stamp._replace(frame=-1, status=int(FrameStatus.MISSING))


class FrameCorrupt(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        now[self.eye].stamp = now[self.eye].stamp._replace(status=int(FrameStatus.CORRUPT))
        now[self.eye].image[::7] = 0


class FrameDuplicate(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        np.copyto(now[self.eye].image, last[self.eye].image)
        now[self.eye].stamp = last[self.eye].stamp


class FrameStuck(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        np.copyto(now[self.eye].image, last[self.eye].image)


class FrameSkew(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        stamp = now[self.eye].stamp
        now[self.eye].stamp = stamp._replace(time_ns=stamp.time_ns + round(600_000 + 4e6 * (self.share - 0.2)))


class FrameLate(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        for shot, older in zip(now, last, strict=True):
            np.copyto(shot.image, older.image)
            shot.stamp = older.stamp._replace(frame=shot.stamp.frame)


class FrameSwapped(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        np.copyto(now[self.eye].image, now[1 - self.eye].image)
        now[self.eye].stamp = now[self.eye].stamp._replace(eye=1 - self.eye)


class FrameTorn(FrameFault):
    LASTS = (1, 1)  # the next frame is torn against another one

    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        image = now[self.eye].image
        row = int(self.share * len(image))
        image[row:] = last[self.eye].image[row:]


class FrameBlack(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        image = now[self.eye].image
        image[:] = self.draw.integers(0, 3, image.shape)


class FrameSaturated(FrameFault):
    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        image = now[self.eye].image
        image[:, : round((0.6 + 0.5 * self.share) * image.shape[1])] = np.iinfo(image.dtype).max


class CablesSwapped(Injection):
    LASTS = (10, 40)

    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        left: NDArray[Any] = now[0].image.copy()
        np.copyto(now[0].image, now[1].image)
        np.copyto(now[1].image, left)


class SceneFault(Injection):
    """Light changes for a while; `size` is drawn from SIZE."""

    LASTS = (10, 60)
    SIZE = (0.25, 0.45)

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.size = float(draw.uniform(*self.SIZE))
        self.pattern = int(draw.integers(1 << 16))

    def before(self, stage: Stage, tick: int) -> None:
        """The scene is as the fault makes it while it lasts, and sound otherwise."""
        stage.world.scene.pattern = self.pattern
        self.alter(stage, self.active(tick))

    def alter(self, stage: Stage, active: bool) -> None:
        """Make the scene so."""


class Eclipse(SceneFault):
    def alter(self, stage: Stage, active: bool) -> None:
        stage.world.scene.gain = 0.0 if active else 1.0


class LowLight(SceneFault):
    """The camera's own noise is as strong as what is left of the wing."""

    SIZE = (0.05, 0.07)
    GRAIN = 12.0

    def alter(self, stage: Stage, active: bool) -> None:
        stage.world.scene.gain = self.size if active else 1.0
        stage.world.scene.grain = self.GRAIN if active else 0.0


class Shadow(SceneFault):
    def alter(self, stage: Stage, active: bool) -> None:
        stage.world.scene.shadow = self.size if active else 0.0


class Glint(SceneFault):
    def alter(self, stage: Stage, active: bool) -> None:
        stage.world.scene.glint = self.size if active else 0.0


class CalibrationShift(SceneFault):
    SIZE = (0.45, 0.9)

    def alter(self, stage: Stage, active: bool) -> None:
        stage.world.scene.bump_px = self.size if active else 0.0
