"""Faults of the structure: what moves otherwise than the wing did."""

import numpy as np

from sim.injection import Injection, Stage
from sim.surrogate_flap import Flap
from sim.surrogate_motion import Line

RECORD = 450  # ticks of the record


class MotionFault(Injection):
    """The motion is laid down before the flight; the wing is kicked again where it was at rest."""

    LASTS = (150, 240)
    RECOVERY = RECORD + 210

    KICK_MM = (20.0, 3.0, 4.0)


class FrequencyStep(MotionFault):
    """A hinge loosens and stays loose."""

    LASTS = (1, 1)

    def prepare(self, stage: Stage) -> None:
        stage.world.motion.scale_frequency(stage.time_s(self.first), 0.97)


class WingStopped(MotionFault):
    """Held for a moment, or struck; from then on it decays again."""

    LASTS = (1, 1)

    def prepare(self, stage: Stage) -> None:
        time_s = stage.time_s(self.first)
        if self.draw.integers(2):
            stage.world.motion.stop(time_s, float(self.draw.uniform(0.0, 0.3)))
        stage.world.motion.kick(time_s, [float(mm * self.draw.uniform(0.5, 1.0)) for mm in self.KICK_MM])


class WingQuiet(MotionFault):
    LASTS = (520, 520)

    def prepare(self, stage: Stage) -> None:
        stage.world.motion.stop(stage.time_s(self.first), 0.0)
        stage.world.motion.kick(stage.time_s(self.end), self.KICK_MM)


class LampFlicker(MotionFault):
    """A steady line between the first and the highest mode, away from both."""

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.frequency_hz = float(draw.uniform(1.2, 4.0))

    def prepare(self, stage: Stage) -> None:
        amplitude_mm, phase = float(self.draw.uniform(0.5, 3.0)), float(self.draw.uniform(0.0, 2.0 * np.pi))
        span_s = (stage.time_s(self.first), stage.time_s(self.end))
        stage.world.motion.lines.append(Line(*span_s, 0, self.frequency_hz, amplitude_mm, phase))


class PanelLoose(MotionFault):
    """A panel swings between its stops, and its blows shake the wing; then it locks again."""

    def prepare(self, stage: Stage) -> None:
        size_mm, seed = float(self.draw.uniform(5.0, 15.0)), int(self.draw.integers(1 << 30))
        stage.world.flap = Flap(stage.time_s(self.first), stage.time_s(self.end), size_mm, seed)
        stage.world.flap.shake(stage.world.motion)
