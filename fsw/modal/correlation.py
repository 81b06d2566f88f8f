"""Correlation functions of vibration signals (the paper's Eq. 31), in the two forms that suit two kinds of response."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

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
    count, width = signals.shape
    size = next_fast_len(count + lags, real=True)
    spectrum = np.fft.rfft(np.ascontiguousarray(signals.T), size)
    products = np.empty((lags, width, width))
    pairs = count - np.arange(1, lags + 1)
    for j in range(width):
        # Of two signals one transform gives both orders: the other one stands at negative lags.
        cross = np.fft.irfft(spectrum[j:] * spectrum[j].conj(), size)
        products[:, j, j:] = (cross[:, : -lags - 1 : -1] / pairs).T
        products[:, j:, j] = (cross[:, 1 : lags + 1] / pairs).T
    return products


def random_decrement(signals: FloatArray, lags: int) -> FloatArray:
    """Random decrement signatures (lags, p): the mean of all stretches that begin where the loudest signal rises.

    It rises through its root mean square; stretches from its fall through the opposite level join in, turned over.
    signals (T, p), T > lags. Of a response to noise the free decay is left; where nothing passes, the signals' own
    beginning is. Source: Cole, 1973; section 5 of the paper.
    """
    lead = signals[:, int(np.argmax(np.sum(signals**2, axis=0)))]
    level = float(np.sqrt(np.mean(lead**2)))
    begins = len(signals) - lags
    up = np.flatnonzero((lead[:begins] < level) & (lead[1 : begins + 1] >= level)) + 1
    down = np.flatnonzero((lead[:begins] > -level) & (lead[1 : begins + 1] <= -level)) + 1
    stretches = [signals[k : k + lags] for k in up] + [-signals[k : k + lags] for k in down]
    return np.mean(stretches, axis=0) if stretches else signals[:lags].copy()
