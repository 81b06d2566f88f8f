"""How far to trust a pole: amplitude coherence (the paper's MAC), singular value (MSV), shape assurance."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.realisation import Poles

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def amplitude_coherence(poles: Poles, columns: int) -> FloatArray:
    """Modal amplitude coherence (k,) of identified and modelled amplitude series, 0 to 1.

    The identified series is a row of psi^-1 S^1/2 V^T, the modelled one b [1, z, z^2, ...]. Source: Eq. 39
    as Juang and Pappa (1985) mean it; in print both series are the same and the value is always 1.
    """
    powers = np.vander(poles.z, columns, increasing=True)
    identified = poles.identified.reshape(len(poles.z), columns, poles.participation.shape[1])
    along = (identified @ poles.participation.conj()[:, :, None])[:, :, 0]
    inner = np.abs(np.sum(along * powers.conj(), axis=1))
    modelled = np.linalg.norm(poles.participation, axis=1) * np.linalg.norm(powers, axis=1)
    norms = np.linalg.norm(poles.identified, axis=1) * modelled
    return np.divide(inner, norms, out=np.zeros(len(inner)), where=norms > 0.0)


def modal_singular_value(poles: Poles, columns: int) -> FloatArray:
    """Modal singular value (k,): each mode's contribution to the series.

    sqrt(|c| |b| (1 + |z| + ... + |z|^columns)), which becomes sqrt(|c| |b| / (1 - |z|)) for a long decay;
    the finite sum also holds for a pole on or outside the unit circle. Source: Eq. 40, 41.
    """
    gain = np.sum(np.vander(np.abs(poles.z), columns + 1), axis=1)
    c = np.linalg.norm(poles.shape, axis=0)
    b = np.linalg.norm(poles.participation, axis=1)
    return np.sqrt(c * b * gain)


def shape_assurance(a: ComplexArray, b: ComplexArray) -> float:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of two shapes (M,), 0 to 1; 0 if one is zero."""
    norm = float(np.vdot(a, a).real * np.vdot(b, b).real)
    return float(abs(np.vdot(a, b)) ** 2 / norm) if norm > 0.0 else 0.0


def nearest_shape(shape: ComplexArray, reference: ComplexArray) -> tuple[int, float]:
    """Index of the reference shape (k, M) that a mode's shape (M,) is most like, and their assurance, 0 to 1.

    Only channels that both have count: NaN marks those that have no value.
    """
    there = np.isfinite(shape) & np.isfinite(reference).all(axis=0)
    likeness = [shape_assurance(shape[there], other[there]) for other in reference]
    best = int(np.argmax(likeness))
    return best, likeness[best]
