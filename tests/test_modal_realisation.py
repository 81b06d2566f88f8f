"""Correlations, realisation and indicators against closed forms."""

import numpy as np
import pytest
from scipy.linalg import hankel

from fsw.modal.correlation import fixed_window, spectral
from fsw.modal.indicators import amplitude_coherence, modal_singular_value, shape_assurance
from fsw.modal.realisation import block_hankel, continuous, frequency_and_damping, poles_of_order, realise
from sim.bench.modal_records import pole

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
