"""The task identify over a flight's displacements: what a loose panel goes on shaking after a break is not believed."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.modal.autoregression import predict
from fsw.modal.coordinates import principal_coordinates
from fsw.modal.result import ModalResult, Mode
from fsw.modal.stationary_force import is_steady
from fsw.tables.flight import load_flight
from fsw.tasks.identify import Identify
from fsw.tasks.state import Pair, State
from sim.bench.modal_records import AMBIENT, stationary
from sim.campaign_judge import SHARE, SIGMAS
from sim.motion import Oscillator
from sim.surrogate_flap import Flap
from sim.surrogate_motion import ModalMotion
from telemetry.dictionary import FlightMode

FloatArray = NDArray[np.float64]
RATE_HZ, CELLS = 15.0, 40
HZ, DAMPING, SIZE_MM = (0.7146, 4.427, 5.806), (0.006, 0.008, 0.009), (20.0, 2.0, 3.0)
LOOSE_S = (12.0, 55.0)


def flight(seed: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Time (T,) in s and positions (T, CELLS, 3) in mm of a wing that swings freely until a panel comes loose."""
    draw = np.random.default_rng(seed)
    sizes, phases = draw.uniform(0.5, 1.5, 3) * SIZE_MM, draw.uniform(0.0, 2.0 * np.pi, 3)
    modes = zip(HZ, DAMPING, sizes.tolist(), phases.tolist(), strict=True)
    wing = ModalMotion([Oscillator(f, damping, size, "decay", phase) for f, damping, size, phase in modes])
    flap = Flap(*LOOSE_S, float(draw.uniform(5.0, 15.0)), seed)
    flap.shake(wing)
    along = np.linspace(0.1, 1.0, CELLS)
    forms = np.stack([along**2, along**2 - 0.6 * along, np.sin(2.5 * np.pi * along)])
    panel = np.where((along > 0.6) & (along < 0.8), (along - 0.6) / 0.2, 0.0)
    time_s, tips = np.arange(round(seconds * RATE_HZ)) / RATE_HZ, np.zeros(3)
    xyz = np.zeros((len(time_s), CELLS, 3))
    for t, row in zip(time_s.tolist(), xyz, strict=True):
        wing.tip_mm(t, tips)
        row[:] = np.outer(tips @ forms + flap.tip_mm(t) * panel, (0.05, 0.1, 1.0))
    return time_s, xyz + 1e-3 * draw.standard_normal(xyz.shape)


def misleads(mode: Mode) -> bool:
    """As the campaign judges what was sent."""
    off = [abs(mode.frequency_hz - hz) - max(SIGMAS * mode.frequency_sigma_hz, SHARE * hz) for hz in HZ]
    return mode.valid and min(off) > 0.0


def identified(time_s: FloatArray, xyz: FloatArray, every: int) -> list[tuple[float, ModalResult]]:
    """Time and estimate of every so many ticks of a flight, as the task delivers it."""
    table, blank = load_flight().identify, np.zeros((4, 4), np.uint8)
    history = Ring(table.history_ticks, (), np.int64), Displacements(table.history_ticks, CELLS)
    tracker = SimpleNamespace(grid=SimpleNamespace(count=CELLS))
    state = State(tracker, Pair(blank, blank), *history)  # type: ignore[arg-type]
    state.mode = FlightMode.TRACK
    task, results = Identify(state, table), []
    for tick, (t, row) in enumerate(zip(time_s.tolist(), xyz, strict=True)):
        state.time_ns = round(t * 1e9)
        state.history_time_ns.push(state.time_ns)
        state.history_mm.push(row)
        if tick % every == 0 and task.take(tick):
            task.work()
            task.deliver(tick + 1)
            if state.estimate is not None and state.estimate.time_ns == state.time_ns:
                results.append((t, state.estimate.result))
    return results


@pytest.mark.requirement("WB-MOD-11")
def test_blows_of_a_loose_panel_are_no_steady_noise_and_neither_is_what_ends_within_the_record() -> None:
    for seed in range(6):
        time_s, xyz = flight(seed, LOOSE_S[1] + 25.0)
        y = xyz.reshape(len(xyz), -1)
        for begin_s in (LOOSE_S[0] + 0.1, LOOSE_S[0] + 10.0, LOOSE_S[1] - 5.0):
            piece = (time_s > begin_s) & (time_s <= begin_s + 30.0)
            assert not is_steady(predict(principal_coordinates(time_s[piece], y[piece], 12)))


@pytest.mark.requirement("WB-MOD-11")
@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "missing"), [(10.0, 15.0, 0.0), (30.0, 15.0, 0.05), (10.0, 46.0, 0.0)]
)
def test_white_force_is_steady_noise(duration_s: float, rate_hz: float, missing: float) -> None:
    modes, _, _, points, noise_mm = AMBIENT["A2"]
    for seed in range(20):
        time_s, y = stationary(modes, duration_s, rate_hz, points, noise_mm, 900 + seed)
        there = np.random.default_rng(seed).uniform(size=len(time_s)) >= missing
        assert is_steady(predict(principal_coordinates(time_s[there], y[there], 12)))


@pytest.mark.requirement("WB-MOD-11")
@pytest.mark.parametrize("seed", [1, 3])
def test_what_a_loose_panel_feigns_is_not_believed_and_what_was_known_before_comes_back(seed: int) -> None:
    results = identified(*flight(seed, 90.0), every=20)
    before = [result for t, result in results if t < LOOSE_S[0]]
    assert [mode.valid for mode in before[-1].modes] == [True] * 3
    assert not any(misleads(mode) for _, result in results for mode in result.modes)
    assert sum(mode.valid for mode in results[-1][1].modes) >= 2
