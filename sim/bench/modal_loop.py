"""A satellite whose attitude loop is closed while its wing is watched: the loop moves the pole, torque tells the plant.

One axis: J theta'' + h eta'' = torque, eta'' + 2 z w eta' + w^2 eta + h theta'' = 0, the torque of a PD law held from
sample to sample. The wing's cameras see eta times its shape; the wheels tell their torque.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fsw.modal.pipeline import identify
from sim.bench.modal_records import DAMPING, FloatArray, grid, shapes
from sim.bench.table import Row

_CANTILEVER_HZ, _COUPLING = 0.72, 0.2  # h^2 / J: the coupled pole lies 12 % above the cantilever's
_RATE_HZ, _DURATION_S, _NOISE_MM, _TIP_MM = 20.0, 60.0, 0.2, 20.0
# Crossover and damping of the rigid body's loop; slews back and forth, and the tip's motion that one of them is worth.
_LOOP_HZ, _LOOP_DAMPING, _SLEW_EVERY_S, _SLEW_TIPS = 0.25, 0.2, 10.0, 0.3


@dataclass(frozen=True)
class LoopRecord:
    """time_s (T,), channels y (T, M) in mm, torque u (T, 1) over inertia; poles in 1/s without and with the loop."""

    time_s: FloatArray
    y: FloatArray
    u: FloatArray
    open_pole: complex
    closed_pole: complex


def closed_loop(seed: int) -> LoopRecord:
    """A struck wing under attitude control that slews back and forth; torque is held between samples."""
    rng = np.random.default_rng(seed)
    w, h = 2.0 * np.pi * _CANTILEVER_HZ, _COUPLING**0.5
    mass = np.array([[1.0, h], [h, 1.0]])
    flat, stiff, damp = np.zeros((2, 2)), np.diag([0.0, w**2]), np.diag([0.0, 2.0 * DAMPING * w])
    A = np.block([[flat, np.eye(2)], [-np.linalg.solve(mass, stiff), -np.linalg.solve(mass, damp)]])
    B = np.concatenate([np.zeros(2), np.linalg.solve(mass, [1.0, 0.0])])
    held = scipy.linalg.expm(np.block([[A, B[:, None]], [np.zeros((1, 5))]]) / _RATE_HZ)
    step, push = held[:4, :4], held[:4, 4]
    crossover = 2.0 * np.pi * _LOOP_HZ
    gain = np.array([crossover**2, 0.0, 2.0 * _LOOP_DAMPING * crossover, 0.0])
    count = round(_DURATION_S * _RATE_HZ)
    state = np.array([0.0, 1.0, 0.0, rng.uniform(-1.0, 1.0) * w])
    states, torque = np.empty((count, 4)), np.empty((count, 1))
    half = round(_SLEW_EVERY_S * _RATE_HZ)
    for k in range(count):
        aim = np.array([_SLEW_TIPS * (k // half % 2), 0.0, 0.0, 0.0])
        states[k], torque[k] = state, -gain @ (state - aim)
        state = step @ state + push * torque[k, 0]
    shape = shapes(*grid(5, 4))["B1"][2]
    y = _TIP_MM * np.outer(states[:, 1], shape) + _NOISE_MM * rng.standard_normal((count, len(shape)))
    flexible = (np.log(np.linalg.eigvals(M).astype(complex)) * _RATE_HZ for M in (step, step - np.outer(push, gain)))
    open_pole, closed_pole = (complex(max(s, key=lambda pole: pole.imag)) for s in flexible)
    return LoopRecord(np.arange(count) / _RATE_HZ, y, torque, open_pole, closed_pole)


def cases(runs: int, seed: int) -> list[Callable[[], Sequence[Row]]]:
    """One case: the same records without and with the measured torque."""
    return [lambda: _rows(range(seed, seed + runs))]


def _rows(seeds: Sequence[int]) -> list[Row]:
    rows: list[Row] = []
    for name, with_torque in (("without inputs", False), ("with measured torque", True)):
        from_open, from_closed, covered = [], [], 0
        for seed in seeds:
            record = closed_loop(seed)
            found = identify(record.time_s, record.y, u=record.u if with_torque else None).modes
            near = [mode for mode in found if 0.6 < mode.frequency_hz < 1.0]
            if near:
                mode = max(near, key=lambda mode: mode.amplitude)
                open_hz, closed_hz = (abs(pole) / (2.0 * np.pi) for pole in (record.open_pole, record.closed_pole))
                from_open.append(abs(mode.frequency_hz / open_hz - 1.0))
                from_closed.append(abs(mode.frequency_hz / closed_hz - 1.0))
                wanted = open_hz if with_torque else closed_hz
                covered += abs(mode.frequency_hz - wanted) < 1.96 * mode.frequency_sigma_hz
        rows.append(
            {
                "table": "loop",
                "method": "wingbeat",
                "case": name,
                "records": len(seeds),
                "found": len(from_open),
                "from_open_loop_median_percent": 100.0 * float(np.median(from_open)),
                "from_open_loop_p95_percent": 100.0 * float(np.percentile(from_open, 95)),
                "from_closed_loop_median_percent": 100.0 * float(np.median(from_closed)),
                "from_closed_loop_p95_percent": 100.0 * float(np.percentile(from_closed, 95)),
                "cover_percent": 100.0 * covered / len(seeds),
            }
        )
    return rows
