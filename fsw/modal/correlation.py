"""Correlation functions of vibration signals (the paper's Eq. 31), in the two forms that suit two kinds of response."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def fixed_window(signals: FloatArray, lags: int) -> FloatArray:
    """Products summed over a window of the same length at every lag: the ERA/DC form, exact for free decays.

    signals (T, p), T > lags. Returns (lags, p, p): entry k is sum over t < T - lags of signals[t + k + 1]
    signals[t]^T. Lag 0 is left out: it alone carries the mean of the noise's square. Because the window does
    not shrink with the lag, a sum of damped exponentials keeps its poles exactly. Source: Juang, Cooper and
    Wright, 1988 (ERA/DC).
    """
    window = len(signals) - lags
    past = signals[:window]
    return np.stack([signals[k : k + window].T @ past for k in range(1, lags + 1)])


def spectral(signals: FloatArray, lags: int) -> FloatArray:
    """Correlations by cross spectrum and inverse Fourier transform: the paper's form, for stationary
    response.

    signals (T, p), T > lags. Returns (lags, p, p), unbiased: the mean of signals[t + k + 1] signals[t]^T
    over the T - k - 1 products there are. Zero padding keeps the transform from wrapping round. On a free
    decay this form destroys the damping, for its window shrinks while the signal decays. Source: Eq. 31 and
    the text after Fig. 9.
    """
    count = len(signals)
    size = 1 << (count + lags).bit_length()
    spectrum = np.fft.rfft(signals, size, axis=0)
    products = np.empty((lags, signals.shape[1], signals.shape[1]))
    pairs = (count - np.arange(1, lags + 1))[:, None]
    for j in range(signals.shape[1]):
        cross = spectrum * spectrum[:, j : j + 1].conj()
        products[:, :, j] = np.fft.irfft(cross, size, axis=0)[1 : lags + 1] / pairs
    return products
