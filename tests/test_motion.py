"""The wing's motion against the equation of motion and the statistics that it must have."""

import numpy as np
import pytest

from sim.motion import Oscillator, free_decay, stationary_random, tip_motion

BENDING = Oscillator(0.7146, 0.006, 25.0, "decay", 0.4)


@pytest.mark.requirement("WB-SIM-03")
def test_a_decay_solves_its_equation_of_motion() -> None:
    step = 1e-4
    t = np.arange(0.0, 3.0, step)
    q = free_decay(BENDING, t)
    velocity, acceleration = (q[2:] - q[:-2]) / (2 * step), (q[2:] - 2 * q[1:-1] + q[:-2]) / step**2
    omega = 2 * np.pi * BENDING.frequency_hz
    residual = acceleration + 2 * BENDING.damping_ratio * omega * velocity + omega**2 * q[1:-1]
    assert np.abs(residual).max() < 1e-5 * np.abs(acceleration).max()


def test_a_decay_starts_at_its_amplitude_and_loses_it_as_its_damping_says() -> None:
    mode = Oscillator(2.0, 0.02, 10.0, "decay")
    period = 1.0 / (2.0 * np.sqrt(1.0 - 0.02**2))
    q = free_decay(mode, np.array([0.0, period]))
    assert q[0] == pytest.approx(10.0)
    decrement = 2 * np.pi * 0.02 / np.sqrt(1.0 - 0.02**2)
    assert np.log(q[0] / q[1]) == pytest.approx(decrement, rel=1e-9)


@pytest.mark.requirement("WB-SIM-03")
def test_random_motion_is_stationary_from_the_first_sample() -> None:
    mode = Oscillator(0.7, 0.01, 2.0, "random")
    draw = np.random.default_rng(5)
    runs = np.array([stationary_random(mode, 0.1, 12, draw) for _ in range(4000)])
    np.testing.assert_allclose(runs.std(axis=0), 2.0, rtol=0.06)


def test_random_motion_has_an_oscillator_s_autocorrelation() -> None:
    mode = Oscillator(0.7, 0.05, 3.0, "random")
    q = stationary_random(mode, 0.1, 100_000, np.random.default_rng(6))
    lags = np.arange(30)
    measured = np.array([np.mean(q[: len(q) - n] * q[n:]) for n in lags]) / 9.0
    omega, zeta = 2 * np.pi * 0.7, 0.05
    damped, t = omega * np.sqrt(1 - zeta**2), lags * 0.1
    exact = np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta / np.sqrt(1 - zeta**2) * np.sin(damped * t))
    np.testing.assert_allclose(measured, exact, atol=0.05)


def test_each_mode_has_a_stream_of_its_own() -> None:
    times = (np.arange(50) * 100_000_000).astype(np.int64)
    noisy = Oscillator(1.0, 0.01, 1.0, "random")
    alone = tip_motion([BENDING, noisy], times, 9)
    other = tip_motion([noisy, noisy, noisy], times, 9)
    np.testing.assert_array_equal(alone[:, 1], other[:, 1])
    assert abs(np.corrcoef(other[:, 0], other[:, 1])[0, 1]) < 0.9
    assert not np.array_equal(tip_motion([noisy], times, 1), tip_motion([noisy], times, 2))
