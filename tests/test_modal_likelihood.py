"""The likelihood of stationary response: its covariance, score and posterior against direct computation."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from fsw.modal.pipeline import identify
from fsw.modal.small_matrices import inverse, tangents
from fsw.modal.stationary_envelope import envelope, woodbury
from fsw.modal.stationary_likelihood import band_of, first_guess, most_likely, without
from fsw.modal.stationary_model import Band, Modes, likelihood
from fsw.modal.stationary_posterior import posterior
from sim.bench.modal_bounds import uncertainty_law
from sim.bench.modal_records import AMBIENT, free_decay, grid, pole, shapes, stationary

BAND_HZ = np.array([0.9, 0.95, 1.0, 1.05, 1.1])


def dense(frequency_hz: float, decay_rate: float, duration_s: float) -> np.ndarray:
    """Covariance of the Fourier coefficients of exp(-a |t - s| + i w (t - s)), by a plain double sum.

    Each is larger or smaller by what the pole at -w does to a displacement.
    """
    count = 2000
    time_s = (np.arange(count) + 0.5) * duration_s / count
    lag = np.arange(count) * duration_s / count
    correlation = toeplitz(np.exp((-decay_rate + 2j * np.pi * frequency_hz) * lag))
    waves = np.exp(-2j * np.pi * BAND_HZ[:, None] * time_s) / count
    waves *= (2.0 * frequency_hz / (BAND_HZ + frequency_hz))[:, None]
    return waves @ correlation @ waves.conj().T


def of_model(frequency_hz: float, decay_rate: float, duration_s: float) -> np.ndarray:
    d, a, b = envelope(BAND_HZ, frequency_hz, decay_rate, duration_s, False)[0]
    return np.diag(d) - np.outer(a, a) + np.outer(b, b)


@pytest.mark.parametrize("decay_rate", [0.002, 0.2, 3.0])
def test_covariance_of_a_mode_is_that_of_its_envelopes_correlation(decay_rate):
    assert np.allclose(of_model(1.03, decay_rate, 20.0), dense(1.03, decay_rate, 20.0), atol=5e-6)


def test_spectrum_of_a_mode_is_that_of_an_oscillator_under_white_force():
    f, damping = np.linspace(0.94, 1.06, 13), 0.005
    d = envelope(f, 1.0, 2 * np.pi * damping, 1e4, False)[0, 0]
    response = 1.0 / ((1.0 - f**2) ** 2 + (2.0 * damping * f) ** 2)
    assert np.allclose(d / d[6], response / response[6], rtol=5e-3)


def test_inverse_of_a_modes_covariance_is_made_of_weights_and_two_ranks():
    noise, y = np.array([0.1, 1.0]), np.random.default_rng(1).standard_normal(len(BAND_HZ))
    parts = envelope(BAND_HZ, 1.03, 0.2, 20.0, False)[0]
    _, a, b = parts
    weights, logarithm, products = woodbury(parts, noise, np.stack([y * y, a * y, b * y], axis=1))
    for n in range(2):
        covariance = of_model(1.03, 0.2, 20.0) + noise[n] * np.eye(len(y))
        aa, bb, ab, square, ay, by = products[n]
        assert logarithm[n] == pytest.approx(np.linalg.slogdet(covariance)[1])
        assert np.allclose(weights[n], 1.0 / (parts[0] + noise[n]))
        by_ranks = square - (ay**2 * bb + by**2 * aa - 2.0 * ay * by * ab) / (aa * bb - ab**2)
        assert by_ranks == pytest.approx(y @ np.linalg.solve(covariance, y))


def noisy_band(seed: int, directions: int, pieces: int = 2) -> Band:
    rng = np.random.default_rng(seed)
    shape = (pieces, len(BAND_HZ), directions)
    return Band(BAND_HZ, rng.standard_normal(shape) + 1j * rng.standard_normal(shape), 20.0)


def modes_of(seed: int, modes: int, directions: int) -> Modes:
    """Modes in the band."""
    rng = np.random.default_rng([seed, modes, directions])
    form = rng.standard_normal((directions, modes))
    return Modes(
        rng.uniform(0.95, 1.05, modes),
        rng.uniform(0.1, 0.3, modes),
        rng.uniform(1.0, 3.0, modes),
        form / np.linalg.norm(form, axis=0),
        0.5,
    )


def dense_model(steps: np.ndarray, f, a, v, form, noise) -> np.ndarray:
    """Covariance of the band's coefficients, direction by direction, after steps in all unknowns."""
    q, m = form.shape
    covariance = noise * np.exp(steps[-1]) * np.eye(q * len(BAND_HZ))
    for j, step in enumerate(steps[:-1].reshape(m, q + 2)):
        shape = form[:, j] + tangents(form[:, j]).T @ step[3:]
        outer = v[j] * np.exp(step[2]) * np.outer(shape, shape) / (shape @ shape)
        covariance = covariance + np.kron(outer, of_model(f[j] + step[0], a[j] * np.exp(step[1]), 20.0))
    return covariance


@pytest.mark.parametrize(("modes", "directions"), [(1, 1), (2, 1), (2, 2), (3, 3)])
def test_likelihood_slopes_and_information_are_those_of_a_complex_normal(modes, directions):
    band = noisy_band(0, directions)
    model = modes_of(0, modes, directions)
    value, score, information = likelihood(band, model, -np.inf)
    y = band.coefficients.transpose(0, 2, 1).reshape(2, -1)

    def direct(steps: np.ndarray) -> float:
        covariance = dense_model(steps, *model)
        squares = np.sum((y.conj() * np.linalg.solve(covariance, y.T).T).real)
        return -2 * np.linalg.slogdet(covariance)[1] - squares

    count = len(score)
    assert count == modes * (directions + 2) + 1
    assert value == pytest.approx(direct(np.zeros(count)), rel=1e-9)
    its_value, *rest = likelihood(band, model, value)
    assert its_value == value and [part.size for part in rest] == [0, 0]
    steps = 1e-5 * np.eye(count)
    assert np.allclose(score, [(direct(e) - direct(-e)) / 2e-5 for e in steps], rtol=1e-4, atol=1e-3)
    weight = np.linalg.inv(dense_model(np.zeros(count), *model))
    slopes = [weight @ (dense_model(e, *model) - dense_model(-e, *model)) / 2e-5 for e in steps]
    expected = 2 * np.array([[np.trace(a @ b) for b in slopes] for a in slopes])
    assert np.allclose(information, expected, rtol=1e-5, atol=1e-6 * np.max(expected))


@pytest.mark.parametrize("shape", [[1.0], [0.6, -0.8], [0.0, 1.0, 0.0], [-0.36, 0.48, 0.8]])
def test_tangents_are_orthonormal_and_at_right_angles_to_the_shape(shape):
    both = np.vstack([shape, tangents(np.array(shape))])
    assert np.allclose(both @ both.T, np.eye(len(shape)))


def test_small_inverse_is_that_of_the_library():
    A = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 3.0], [4.0, -1.0, 0.0]])
    found, logarithm = inverse(A)
    assert np.allclose(found, np.linalg.inv(A))
    assert logarithm == pytest.approx(np.linalg.slogdet(A)[1])


def close_pair(seed: int) -> tuple[Band, np.ndarray]:
    modes, duration_s, rate_hz, points, noise_mm = AMBIENT["A2"]
    _, y = stationary(modes, duration_s, rate_hz, points, noise_mm, seed)
    form = shapes(*grid(*points))
    basis, _ = np.linalg.qr(np.stack([form["B1"][2], form["IP"][2]], axis=1))
    return band_of((y - y.mean(axis=0)) @ basis, rate_hz, 0.6, 0.9), basis


def test_a_close_pair_is_told_apart_from_a_poor_guess():
    deviations = []
    for seed in range(8):
        band, _ = close_pair(300 + seed)
        guess = first_guess(band, np.array([0.728, 0.762]), np.array([0.01, 0.1]), np.eye(2) + 0.2)
        group = most_likely(band, guess)
        assert group.likelihood > likelihood(band, guess, -np.inf)[0]
        both = [posterior(band, group.modes, j, np.linalg.pinv(group.modes.shapes)[j]) for j in range(2)]
        for f, found in zip((0.73, 0.76), both, strict=True):
            rate = -pole(f).real
            deviations.append((found.frequency_hz - f) / found.frequency_sigma_hz)
            deviations.append((found.decay_rate - rate) / found.decay_rate_sigma)
            law_hz = uncertainty_law(f, 120.0)[0]
            assert 0.4 * law_hz < found.frequency_sigma_hz < 3.0 * law_hz
            assert found.line_gain > 0.0
        assert group.likelihood - without(group, band, 1).likelihood > 10.0
    assert np.mean(np.abs(deviations) < 1.96) > 0.8


def test_a_steady_line_is_as_likely_as_a_mode():
    rate_hz, count = 20.0, 2400
    time_s = np.arange(count) / rate_hz
    noise = 0.1 * np.random.default_rng(4).standard_normal(count)
    band = band_of((np.sin(2 * np.pi * 1.003 * time_s) + noise)[:, None], rate_hz, 0.9, 1.1)
    group = most_likely(band, first_guess(band, np.array([1.0]), np.array([0.05]), np.ones((1, 1))))
    assert posterior(band, group.modes, 0, np.ones(1)).line_gain < 4.0


def test_long_records_are_cut_in_pieces():
    band = band_of(np.random.default_rng(0).standard_normal((20000, 2)), 20.0, 1.0, 2.0)
    assert len(band.coefficients) > 10 and band.coefficients.shape[1] * 2 <= 128
    assert band.duration_s * len(band.coefficients) == pytest.approx(1000.0, rel=0.01)


@pytest.mark.parametrize(("case", "seed"), [("A1", 1006), ("A2", 1016), ("A2", 2006), ("A1", 2056), ("A2", 2081)])
def test_one_mode_that_falls_by_chance_is_no_free_decay(case, seed):
    assert identify(*stationary(*AMBIENT[case], seed)).kind == "ambient"


# Of the close pair of A2 each mode falls in the other's beat, so that its own peak does not tell.
@pytest.mark.parametrize(
    ("case", "samples", "seed", "damping"),
    [("A1", 2400, 77, 0.002), ("A1", 2400, 77, 0.02), ("A2", 1200, 30001, 0.005), ("A2", 1200, 30005, 0.002)],
)
def test_a_free_decay_that_is_called_ambient_gives_no_valid_mode(case, samples, seed, damping):
    time_s = np.arange(samples) / 20.0
    record = free_decay(AMBIENT[case][0], time_s, (5, 4), 0.2, seed, damping=damping)
    found = identify(time_s, record.noisy, "ambient")
    assert found.modes and not found.valid_modes
    assert identify(time_s, record.noisy).kind == "decay"


def test_a_peak_that_falls_in_two_pieces_by_chance_is_one_mode():
    f = AMBIENT["A1"][0]["B2"]
    (mode,) = (m for m in identify(*stationary(*AMBIENT["A1"], 2099)).modes if abs(m.frequency_hz - f) < 0.1 * f)
    assert mode.valid
    assert abs(mode.frequency_hz - f) < 2.0 * mode.frequency_sigma_hz < 0.01 * f


@pytest.mark.parametrize(("case", "seed", "wanted"), [("A1", 5146, 3), ("A1", 5508, 3), ("A2", 5467, 3)])
def test_modes_that_cannot_be_filtered_apart_are_not_believed_too_well(case, seed, wanted):
    # A fragment that ran out of its band took the mode beside it along; three shapes in a plane let each other through.
    valid = identify(*stationary(*AMBIENT[case], seed)).valid_modes
    assert len(valid) >= wanted
    for mode in valid:
        f = min(AMBIENT[case][0].values(), key=lambda hz, mode=mode: abs(hz - mode.frequency_hz))
        assert abs(mode.frequency_hz - f) < 4.0 * mode.frequency_sigma_hz < 0.04 * f


def test_two_modes_of_one_shape_that_stand_apart_are_both_found_in_most_records():
    _, duration_s, rate_hz, points, noise_mm = AMBIENT["A1"]
    pair_hz = np.array([4.0, 4.3])
    both = 0
    for seed in range(4):
        time_s, first = stationary({"B1": 0.72, "B2": pair_hz[0]}, duration_s, rate_hz, points, noise_mm, seed)
        _, second = stationary({"B2": pair_hz[1]}, duration_s, rate_hz, points, noise_mm, 1000 + seed)
        found = [m for m in identify(time_s, first + second).valid_modes if m.frequency_hz > 2.0]
        assert all(np.min(np.abs(m.frequency_hz - pair_hz)) < 4.0 * m.frequency_sigma_hz for m in found)
        both += len(found) == 2
    assert both >= 3
