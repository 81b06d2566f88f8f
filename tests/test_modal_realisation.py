"""Correlations, realisation and indicators against closed forms."""

import numpy as np
import pytest
from scipy.linalg import hankel

from fsw.modal.correlation import fixed_window, random_decrement, spectral
from fsw.modal.indicators import amplitude_coherence, modal_singular_value, shape_assurance
from fsw.modal.paper import subspace_of_data
from fsw.modal.pipeline import identify
from fsw.modal.realisation import (
    block_hankel,
    continuous,
    frequency_and_damping,
    poles_of_order,
    realise,
    weighted_realisation,
)
from fsw.modal.result import Options, to_contract
from sim.bench.modal_records import AMBIENT, pole, published, stationary

RATE_HZ = 20.0
POLES = np.array([pole(0.72, 0.005), pole(0.75, 0.008), pole(4.2, 0.02)])


def noise_free(count=200, channels=4, seed=1):
    rng = np.random.default_rng(seed)
    form = rng.standard_normal((len(POLES), channels)) + 1j * rng.standard_normal((len(POLES), channels))
    return (np.exp(np.arange(count)[:, None] / RATE_HZ * POLES) @ form).real


def sorted_poles(series, rows=30, order=6):
    found = poles_of_order(realise(series, rows, rows, order), order)
    s = continuous(found.z, RATE_HZ)
    return s[np.argsort(s.imag)], found


def test_block_hankel_of_one_channel_is_the_textbook_hankel():
    h = np.arange(12.0)
    assert np.array_equal(block_hankel(h[:, None, None], 5, 4, 2), hankel(h[2:7], h[6:10]))


def test_block_hankel_of_many_channels_has_the_series_in_its_blocks():
    h = np.random.default_rng(1).standard_normal((9, 2, 3))
    H = block_hankel(h, 4, 3, 2).reshape(4, 2, 3, 3)
    assert all(np.array_equal(H[i, :, j], h[2 + i + j]) for i in range(4) for j in range(3))


def test_realisation_of_a_noise_free_free_response_is_exact():
    s, _ = sorted_poles(noise_free()[:, :, None])
    frequency_hz, damping = frequency_and_damping(s)
    assert np.allclose(frequency_hz, np.abs(POLES) / (2 * np.pi), rtol=1e-9)
    assert np.allclose(damping, -POLES.real / np.abs(POLES), rtol=0, atol=1e-9)


def test_realisation_reproduces_the_series_it_was_made_from():
    series = noise_free()[:, :, None]
    system = realise(series, 30, 30, 6)
    state, again = system.B, []
    for _ in range(60):
        again.append(system.C @ state)
        state = system.A @ state
    assert np.allclose(np.array(again), series[:60], atol=1e-9 * np.max(np.abs(series)))


def test_fixed_window_products_keep_the_poles_of_a_decay():
    # Products square the range of the data: half of the digits are left for the weakest mode.
    s, _ = sorted_poles(fixed_window(noise_free(), 60))
    assert np.allclose(s, POLES, rtol=1e-6)


def test_correlations_through_the_spectrum_destroy_the_damping_of_a_decay():
    signals = np.exp(POLES[0] * np.arange(400) / RATE_HZ).real[:, None]
    s = continuous(poles_of_order(realise(spectral(signals, 200), 100, 100, 2), 2).z, RATE_HZ)
    assert not np.isclose(s[0].real, POLES[0].real, rtol=0.2)


def test_spectral_correlation_is_the_direct_sum():
    signals = np.random.default_rng(0).standard_normal((50, 3))
    direct = [signals[k:].T @ signals[: 50 - k] / (50 - k) for k in range(1, 11)]
    assert np.allclose(spectral(signals, 10), direct, atol=1e-12)


def test_amplitude_coherence_is_one_without_noise_and_low_for_poles_that_noise_made():
    clean = noise_free()
    _, found = sorted_poles(clean[:, :, None])
    assert np.all(amplitude_coherence(found, 30) > 1 - 1e-9)
    noisy = clean + 0.3 * np.random.default_rng(2).standard_normal(clean.shape)
    system = realise(fixed_window(noisy, 60), 30, 30, 16)
    many = poles_of_order(system, 16)
    s = continuous(many.z, RATE_HZ)
    coherence = amplitude_coherence(many, 30)
    true = np.min(np.abs(s[:, None].imag - POLES.imag) / POLES.imag, axis=1) < 0.03
    assert coherence[true].max() > 0.99
    assert np.median(coherence[~true]) < 0.9


def test_modal_singular_value_approaches_the_infinite_sum():
    _, found = sorted_poles(noise_free()[:, :, None])
    c, b = np.linalg.norm(found.shape, axis=0), np.linalg.norm(found.participation, axis=1)
    assert np.allclose(modal_singular_value(found, 20000), np.sqrt(c * b / (1 - np.abs(found.z))), rtol=1e-6)


def test_shape_assurance_ignores_scale_and_phase():
    a = np.array([1.0, 2.0 - 1.0j, 0.5j])
    assert shape_assurance(a, 3j * a) == pytest.approx(1.0)
    assert shape_assurance(np.array([1.0 + 0j, 0]), np.array([0j, 1])) == 0.0
    assert shape_assurance(np.zeros(2, complex), np.ones(2, complex)) == 0.0


@pytest.mark.parametrize("cva", [False, True])
def test_projection_of_data_realises_a_long_noise_free_series(cva):
    signals = noise_free(count=400) + 1e-9 * np.random.default_rng(0).standard_normal((400, 4))
    found = poles_of_order(subspace_of_data(signals, 15, 6, cva), 6)
    s = continuous(found.z, RATE_HZ)
    assert np.allclose(s[np.argsort(s.imag)], POLES, rtol=1e-4)


def test_weights_leave_the_poles_of_a_noise_free_series_exact():
    series = noise_free()[:, :, None]
    rng = np.random.default_rng(3)
    left, right = np.eye(40) + 0.1 * rng.standard_normal((40, 40)), np.eye(10) + 0.1 * rng.standard_normal((10, 10))
    found = poles_of_order(weighted_realisation(series, 10, 10, 6, left, right), 6)
    s = continuous(found.z, RATE_HZ)
    assert np.allclose(s[np.argsort(s.imag)], POLES, rtol=1e-9)
    plain = poles_of_order(realise(series, 10, 10, 6), 6)
    for a, b in zip(found.shape.T, plain.shape.T, strict=True):
        assert max(shape_assurance(a, other) for other in plain.shape.T) > 1 - 1e-9 and b.shape == a.shape


def test_random_decrement_of_a_response_to_noise_decays_like_the_mode():
    time_s, y = stationary({"B1": 3.0}, 600.0, 20.0, (2, 2), 0.01, 5)
    signature = random_decrement(y, 200)
    s, _ = sorted_poles(fixed_window(signature, 60), order=2)
    assert abs(s[0]) / (2 * np.pi) == pytest.approx(3.0, rel=0.01)
    assert signature[0, -1] > 0.0 and len(time_s) == len(y)


@pytest.mark.parametrize("method", ["paper", "rdt_era_dc", "ssi_data"])
@pytest.mark.parametrize("weighting", ["none", "cva"])
def test_methods_of_the_paper_find_the_strongest_mode_of_a_stationary_response(method, weighting):
    time_s, y = stationary(*AMBIENT["A1"], 3)
    found = identify(time_s, y, "ambient", Options(method=method, weighting=weighting))
    assert any(abs(mode.frequency_hz - 0.72) < 0.02 * 0.72 for mode in found.modes)
    assert to_contract(found)["modes"][0]["amplitude_mm"] is None


def test_the_papers_correlations_take_the_damping_from_a_decay_and_fixed_windows_keep_it():
    record = published("D2", 1)
    damping = {}
    for form in ("spectral", "fixed_window"):
        found = identify(record.time_s, record.noisy, "decay", Options(method="paper", correlation=form))
        damping[form] = min(found.modes, key=lambda mode: mode.frequency_hz).damping_ratio
    assert damping["fixed_window"] == pytest.approx(0.005, rel=0.05)
    assert damping["spectral"] < 0.5 * 0.005
