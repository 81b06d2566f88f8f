"""What no method can beat: the Cramer-Rao bound of a record's true model, and the uncertainty law of ambient response.

Both are computed from the truth that made the record, numerically and without any function of the flight software.
"""

import numpy as np
from numpy.typing import NDArray

from sim.bench.modal_records import DAMPING, FreeDecay

FloatArray = NDArray[np.float64]

# Step of the central differences, in Hz and of a damping ratio.
_STEP = 1e-7


def cramer_rao(record: FreeDecay) -> FloatArray:
    """Least standard deviations (m, 2) of frequency in Hz and damping ratio, unbiased, from a free decay.

    The Fisher information for known white noise of the damped sinusoids' frequencies and damping ratios, when
    amplitude and phase in every channel are unknown as well: those are projected out.
    """
    time_s, count = record.time_s, len(record.frequency_hz)
    unknown = np.column_stack([record.frequency_hz, np.full(count, record.damping)]).ravel()

    def waves(values: FloatArray) -> FloatArray:
        frequency_hz, damping = values.reshape(-1, 2).T
        omega = 2.0 * np.pi * frequency_hz
        turn = omega * np.sqrt(1.0 - damping**2) * time_s[:, None]
        fall = np.exp(-damping * omega * time_s[:, None])
        return np.hstack([fall * np.cos(turn), fall * np.sin(turn)])

    cosine = (record.amplitude_mm * np.cos(record.phase_rad))[:, None] * record.shape
    sine = (-record.amplitude_mm * np.sin(record.phase_rad))[:, None] * record.shape
    weights = np.vstack([cosine, sine])
    Q, _ = np.linalg.qr(waves(unknown))
    slopes = []
    for step in _STEP * np.eye(len(unknown)):
        slope = (waves(unknown + step) - waves(unknown - step)) @ weights / (2.0 * _STEP)
        slopes.append((slope - Q @ (Q.T @ slope)).ravel() / record.noise_mm)
    J = np.stack(slopes)
    return np.sqrt(np.diag(np.linalg.inv(J @ J.T))).reshape(count, 2)


def uncertainty_law(frequency_hz: float, duration_s: float) -> tuple[float, float]:
    """Least standard deviations of frequency in Hz and damping ratio from stationary response to white noise.

    Long data, wide band, high signal-to-noise ratio. Source: Au, 2014.
    """
    cycles = frequency_hz * duration_s
    return frequency_hz * (DAMPING / (2.0 * np.pi * cycles)) ** 0.5, DAMPING * (2.0 * np.pi * DAMPING * cycles) ** -0.5
