"""The realisation and its indicators beside those of an independent package, on the same record."""

import numpy as np
import pytest

from fsw.modal.indicators import amplitude_coherence, modal_singular_value
from fsw.modal.realisation import continuous, frequency_and_damping, poles_of_order, realise
from sim.bench.modal_records import published

era = pytest.importorskip("pyyeti.era", reason="the extra [peers] is not installed")


def test_poles_coherence_and_singular_values_are_those_of_pyyeti():
    record = published("D2", 4)
    rows, columns, order, rate_hz = 30, len(record.time_s) - 31, 6, 20.0
    peer = era.ERA(
        record.noisy.T,
        rate_hz,
        svd_tol=order,
        auto=True,
        alpha=rows,
        all_lower_limits=0.0,
        damp_range=(-1.0, 1.0),
        show_plot=False,
        verbose=False,
    )
    system = realise(record.noisy[:, :, None], peer.alpha, peer.beta, order)
    own = poles_of_order(system, order)
    frequency_hz, damping = frequency_and_damping(continuous(own.z, rate_hz))
    by_frequency = np.argsort(frequency_hz)
    assert peer.alpha == rows and peer.beta >= columns - 2
    assert np.allclose(frequency_hz[by_frequency], peer.freqs_hz, rtol=1e-6)
    assert np.allclose(damping[by_frequency], peer.zeta, rtol=1e-4)
    coherence = amplitude_coherence(own, peer.beta)[by_frequency]
    assert np.allclose(coherence, peer.indicators["MAC"], atol=1e-5)
    strength = modal_singular_value(own, len(record.time_s) - 2)[by_frequency]
    assert np.allclose(strength / strength.max(), peer.indicators["MSV"], rtol=1e-3)
