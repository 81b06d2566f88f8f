"""Weights of coordinates by their noise: chance costs nothing, what is really common is taken out."""

import numpy as np
import pytest

from fsw.modal.refinement import project
from fsw.modal.weighting import whitening

SAMPLES, COORDINATES, RECORDS = 100, 12, 60


def loss(covariance, seed):
    """Variance of the best-weighted mean of one direction with a record's weights, over that with the true ones."""
    rng = np.random.default_rng(seed)
    noise = rng.multivariate_normal(np.zeros(len(covariance)), covariance, SAMPLES)
    time_s = np.arange(SAMPLES) / 10.0
    root, _ = whitening(project(time_s, noise, np.zeros(0, np.complex128), 0), 1e-300)
    along = np.eye(len(covariance))[0]
    weights = root @ root.T @ along
    best = along @ np.linalg.solve(covariance, along)
    return float(weights @ covariance @ weights / (along @ weights) ** 2 * best)


def mean_loss(covariance):
    return float(np.mean([loss(covariance, seed) for seed in range(RECORDS)]))


def test_correlations_by_chance_cost_next_to_nothing():
    # All p - 1 other coordinates weighed by the sample's covariance would cost (T - 1) / (T - p): 12 per cent.
    assert 1.0 <= mean_loss(np.diag(np.linspace(0.5, 2.0, COORDINATES))) < 1.02


@pytest.mark.parametrize("common", [0.6, 0.95, 0.999, 0.99999])
def test_noise_that_two_coordinates_share_is_taken_out(common):
    covariance = np.eye(COORDINATES)
    covariance[0, 1] = covariance[1, 0] = common
    assert mean_loss(covariance) < 1.2  # left in, the loss would be 1 / (1 - r^2): 1.6 and more


@pytest.mark.parametrize("quiet", [1e-2, 1e-4, 1e-8])
def test_a_quiet_direction_across_many_coordinates_is_kept(quiet):
    # Its correlations are each far from 1: shrunk one by one, they would bury it.
    rng = np.random.default_rng(8)
    mix = np.linalg.qr(rng.standard_normal((COORDINATES, COORDINATES)))[0]
    power = np.ones(COORDINATES)
    power[0] = quiet
    assert mean_loss((mix * power) @ mix.T) < 1.2


def test_noise_that_all_coordinates_share_is_taken_out():
    # The best weights leave a fifth of the variance; a sample of this size must learn eleven of them, at 12 per cent.
    assert mean_loss(0.2 * np.eye(COORDINATES) + 0.8) < 1.2


@pytest.mark.parametrize(("common", "least", "most"), [(0.0, 1, 5), (0.7, COORDINATES, COORDINATES)])
def test_how_many_coordinates_noise_couples_is_told(common, least, most):
    covariance = np.eye(COORDINATES)
    covariance[:4, :4] += common * (1.0 - np.eye(4))
    noise = np.random.default_rng(1).multivariate_normal(np.zeros(COORDINATES), covariance, 4000)
    fit = project(np.arange(4000) / 10.0, noise, np.zeros(0, np.complex128), 0)
    _, coupled = whitening(fit, 1e-300)
    assert least <= coupled <= most


def test_coordinates_without_noise_and_alike_give_finite_weights():
    signal = np.sin(np.arange(SAMPLES) / 3.0)[:, None] * np.ones(3)
    root, _ = whitening(project(np.arange(SAMPLES) / 10.0, signal, np.zeros(0, np.complex128), 0), 1e-18)
    still, _ = whitening(project(np.arange(SAMPLES) / 10.0, 0.0 * signal, np.zeros(0, np.complex128), 0), 1e-18)
    assert np.isfinite(root).all()
    assert np.isfinite(still).all()
