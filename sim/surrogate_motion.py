"""Motion in closed form at any moment: damped oscillators that are kicked, stopped, and change their frequency."""

import cmath
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.motion import Oscillator

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Stretch:
    """One mode between two changes: Re(amplitude exp(pole (t - start_s)))."""

    start_s: float
    frequency_hz: float
    damping_ratio: float
    amplitude: complex

    @property
    def pole(self) -> complex:
        """Continuous-time pole s in 1/s."""
        omega = 2.0 * math.pi * self.frequency_hz
        return complex(-self.damping_ratio * omega, omega * math.sqrt(1.0 - self.damping_ratio**2))

    def at(self, time_s: float) -> complex:
        """The rotating amplitude, whose real part is the tip's displacement in mm."""
        return self.amplitude * cmath.exp(self.pole * (time_s - self.start_s))


@dataclass(frozen=True)
class Line:
    """A steady sine on the shape of one mode, from one moment to another: no mode of the wing."""

    from_s: float
    to_s: float
    mode: int
    frequency_hz: float
    amplitude_mm: float
    phase_rad: float

    def at(self, time_s: float) -> float:
        """Its part of the tip's displacement in mm."""
        if not self.from_s <= time_s < self.to_s:
            return 0.0
        return self.amplitude_mm * math.sin(2.0 * math.pi * self.frequency_hz * (time_s - self.from_s) + self.phase_rad)


class ModalMotion:
    """Tip displacement of each mode. Changes are given in order of time; displacement and velocity go on through them,
    but for what the change itself alters.
    """

    def __init__(self, modes: Sequence[Oscillator]) -> None:
        """modes: decays from time 0. Raises ValueError for any other kind."""
        if any(mode.kind != "decay" for mode in modes):
            raise ValueError("only decays have a closed form")
        self.lines: list[Line] = []
        self._stretches = [
            [Stretch(0.0, m.frequency_hz, m.damping_ratio, cmath.rect(m.amplitude_mm, m.phase_rad))] for m in modes
        ]
        self._starts = [[0.0] for _ in modes]

    @property
    def count(self) -> int:
        """Number of modes."""
        return len(self._stretches)

    def kick(self, time_s: float, amplitudes_mm: Sequence[float]) -> None:
        """A blow that by itself would make each mode swing by so much: velocities change, displacements do not."""
        for mode, amplitude_mm in enumerate(amplitudes_mm):
            self._change(mode, time_s, 1.0, 1.0, amplitude_mm)

    def scale_frequency(self, time_s: float, factor: float) -> None:
        """All modes go on with other frequencies."""
        for mode in range(self.count):
            self._change(mode, time_s, factor, 1.0, 0.0)

    def stop(self, time_s: float, remaining: float) -> None:
        """Something takes hold of the wing: this share of displacement and velocity is left."""
        for mode in range(self.count):
            self._change(mode, time_s, 1.0, remaining, 0.0)

    def tip_mm(self, time_s: float, out: FloatArray) -> None:
        """Fill out (modes,) with the tip's displacement at a moment."""
        for mode in range(self.count):
            out[mode] = self._stretch(mode, time_s).at(time_s).real
        for line in self.lines:
            out[line.mode] += line.at(time_s)

    def frequencies_hz(self, from_s: float, to_s: float) -> list[float]:
        """Every natural frequency that held at some moment between the two."""
        found = []
        for starts, stretches in zip(self._starts, self._stretches, strict=True):
            first, last = bisect_right(starts, from_s) - 1, bisect_right(starts, to_s) - 1
            found += [stretch.frequency_hz for stretch in stretches[max(first, 0) : last + 1]]
        return found

    def _stretch(self, mode: int, time_s: float) -> Stretch:
        return self._stretches[mode][max(bisect_right(self._starts[mode], time_s) - 1, 0)]

    def _change(self, mode: int, time_s: float, factor: float, remaining: float, kick_mm: float) -> None:
        before = self._stretches[mode][-1]
        if time_s < before.start_s:
            raise ValueError(f"a change at {time_s:g} s after one at {before.start_s:g} s")
        now = before.at(time_s)
        position, velocity = remaining * now.real, remaining * (now * before.pole).real
        after = Stretch(time_s, before.frequency_hz * factor, before.damping_ratio, 0j)
        damping, omega = -after.pole.real, after.pole.imag
        amplitude = complex(position, -(velocity + damping * position) / omega - kick_mm)
        self._stretches[mode].append(Stretch(time_s, after.frequency_hz, after.damping_ratio, amplitude))
        self._starts[mode].append(time_s)
