"""Modes of the wing against closed forms of beams, the paper's own finite elements, and their own slopes."""

from dataclasses import replace

import numpy as np
import pytest

from sim.scenario import load_scenario
from sim.structure import Modes, Plate, solve_modes
from sim.world import World

RIGID = float("inf")
ALUMINIUM = Plate(1600.0, 400.0, 2.0, (533.0, 1067.0), 72.4, 2700.0, 0.33, RIGID)


def beam_hz(plate: Plate, factor: float) -> float:
    """Euler-Bernoulli: f = factor / (2 pi L^2) sqrt(E h^2 / (12 rho))."""
    speed = np.sqrt(plate.youngs_gpa * 1e9 / (12.0 * plate.density_kg_m3)) * plate.thickness_mm * 1e-3
    return factor * speed / (plate.length_mm * 1e-3) ** 2 / (2.0 * np.pi)


@pytest.fixture(scope="module")
def hinged() -> Modes:
    return solve_modes(replace(ALUMINIUM, hinge_nm_per_rad=500.0), 3)


@pytest.mark.requirement("WB-SIM-02")
def test_a_strip_without_poisson_effect_is_a_cantilever_beam() -> None:
    strip = replace(ALUMINIUM, width_mm=40.0, poisson=0.0)
    modes = solve_modes(strip, 3, elements_y=1)
    np.testing.assert_allclose(
        modes.frequency_hz, [beam_hz(strip, f) for f in (3.51602, 22.03449, 61.69721)], rtol=2e-5
    )


def test_a_strip_bends_in_the_beam_s_first_shape() -> None:
    strip = replace(ALUMINIUM, width_mm=40.0, poisson=0.0)
    modes = solve_modes(strip, 1, elements_y=1)
    x = np.linspace(0.0, 1600.0, 33)
    a, b = 1.8751040687 * x / 1600.0, 0.7340955138
    beam = (np.cosh(a) - np.cos(a) - b * (np.sinh(a) - np.sin(a))) / 2.0
    shape = modes.shapes(np.stack([x, np.zeros_like(x)], axis=1))[0, :, 0] / modes.tip[0]
    np.testing.assert_allclose(shape, beam, atol=1e-5)


@pytest.mark.requirement("WB-SIM-02")
def test_the_paper_s_plate_has_the_paper_s_finite_element_frequency() -> None:
    assert solve_modes(ALUMINIUM, 1).frequency_hz[0] == pytest.approx(0.66573, rel=5e-4)


def test_a_stiff_fold_line_is_no_fold_line() -> None:
    stiff = solve_modes(replace(ALUMINIUM, hinge_nm_per_rad=1e6), 3)
    np.testing.assert_allclose(stiff.frequency_hz, solve_modes(ALUMINIUM, 3).frequency_hz, rtol=2e-4)


def test_soft_fold_lines_lower_bending_and_leave_torsion(hinged: Modes) -> None:
    change = hinged.frequency_hz / solve_modes(ALUMINIUM, 3).frequency_hz - 1.0
    assert change[0] == pytest.approx(-0.016, abs=0.002)
    assert abs(change[2]) < 1e-3


def test_across_a_fold_line_the_wing_is_continuous_and_its_slope_is_not(hinged: Modes) -> None:
    before, after = (hinged.shapes(np.array([[533.0 + d, 70.0]]))[:, 0] for d in (-1e-6, 1e-6))
    np.testing.assert_allclose(before[:, [0, 2]], after[:, [0, 2]], atol=1e-7)
    assert after[0, 1] > before[0, 1] * 1.01


def test_the_root_is_clamped_and_tips_are_positive(hinged: Modes) -> None:
    root = hinged.shapes(np.stack([np.zeros(9), np.linspace(-200.0, 200.0, 9)], axis=1))
    assert np.abs(root).max() < 1e-12
    assert (hinged.tip > 0.0).all()


def test_slopes_are_the_derivatives_of_the_shape(hinged: Modes) -> None:
    draw = np.random.default_rng(3)
    points = np.stack([draw.uniform(1.0, 1599.0, 40), draw.uniform(-199.0, 199.0, 40)], axis=1)
    step = 1e-3
    for axis in (0, 1):
        shift = np.eye(2)[axis] * step
        central = (hinged.shapes(points + shift) - hinged.shapes(points - shift))[:, :, 0] / (2.0 * step)
        np.testing.assert_allclose(central, hinged.shapes(points)[:, :, 1 + axis], atol=1e-7)


def test_modes_are_mass_normalised(hinged: Modes) -> None:
    x, wx = np.polynomial.legendre.leggauss(60)
    y, wy = np.polynomial.legendre.leggauss(24)
    points = np.stack(np.meshgrid(800.0 * (x + 1.0), 200.0 * y, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = 2700.0 * 2e-3 * np.outer(0.8 * wx, 0.2 * wy).ravel()
    shapes = hinged.shapes(points)[:, :, 0]
    np.testing.assert_allclose((shapes * weight) @ shapes.T, np.eye(3), atol=2e-4)


def test_the_shipped_scenarios_have_the_measured_first_frequency() -> None:
    for name in ("paper", "small"):
        assert World(load_scenario(name)).motion[0].frequency_hz == pytest.approx(0.7146, rel=1e-6)
