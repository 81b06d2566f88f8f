"""Maximum likelihood refinement of a free decay: damped sinusoids and a drift polynomial, by separable least
squares.

The linear unknowns (amplitude and phase in every coordinate, drift) are eliminated: only the poles are
searched (variable projection, Golub and Pereyra 1973, with Kaufman's Jacobian). Time stamps are used as they
are: gaps and jitter cost nothing.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dorgqr, dposv, dtrtri, dtrtrs

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ITERATIONS = 25
# Relative fall of the cost that is not worth a step: of T p degrees of freedom, so much is a hundredth of one standard
# deviation of any pole.
_ARRIVED = 1e-8


@dataclass(frozen=True)
class Span:
    """What damped sinusoids of given poles and a drift polynomial can explain, whatever the signals are.

    orthonormal (T, 2 m + d) spans the linear model, triangle is its R; tangent (T, 2 m) is t times the modes' columns,
    outside of that span, gram (2 m, 2 m) its products. The last two are made when they are asked for.
    """

    time_s: FloatArray
    poles: ComplexArray
    basis: FloatArray
    orthonormal: FloatArray
    triangle: FloatArray

    @cached_property
    def tangent(self) -> FloatArray:
        """The modes' columns times t, without their part in the span."""
        E = self.time_s[:, None] * self.basis[:, : 2 * len(self.poles)]
        E -= self.orthonormal @ (self.orthonormal.T @ E)
        return E

    @cached_property
    def gram(self) -> FloatArray:
        """Products of the tangent's columns."""
        return self.tangent.T @ self.tangent

    def of(self, poles: ComplexArray) -> "Span":
        """The same with other poles."""
        return spanned(self.time_s, poles, self.basis[:, 2 * len(self.poles) :])

    def fit(self, signals: FloatArray) -> "Fit":
        """Best linear fit to signals (T, p) of unit noise variance (whitened)."""
        weights = self.orthonormal.T @ signals
        return Fit(self, dtrtrs(self.triangle, weights)[0], signals - self.orthonormal @ weights)


@dataclass(frozen=True)
class Fit:
    """A fitted record: coefficients (2 m + d, p): per mode cosine and sine, then drift; residual (T, p)."""

    span: Span
    coefficients: FloatArray
    residual: FloatArray

    def weighed(self, weights: FloatArray) -> "Fit":
        """The fit to signals @ weights (p, p)."""
        return Fit(self.span, self.coefficients @ weights, self.residual @ weights)

    @property
    def poles(self) -> ComplexArray:
        """Poles (m,) in 1/s."""
        return self.span.poles

    @property
    def orthonormal(self) -> FloatArray:
        """Of the span, (T, 2 m + d)."""
        return self.span.orthonormal

    @property
    def triangle(self) -> FloatArray:
        """Of the span, (2 m + d, 2 m + d)."""
        return self.span.triangle

    @property
    def tangent(self) -> FloatArray:
        """Of the span, (T, 2 m)."""
        return self.span.tangent

    @cached_property
    def columns(self) -> FloatArray:
        """Tangent, span and residual side by side, (T, 4 m + d + p), for what is asked of all of them."""
        return np.hstack([self.tangent, self.orthonormal, self.residual])

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors (m, p) of the coordinates along which each mode moves most."""
        waves = self.coefficients[: 2 * len(self.poles)].reshape(len(self.poles), 2, -1)
        return np.linalg.svd(waves, full_matrices=False)[2][:, 0]

    @cached_property
    def information(self) -> FloatArray:
        """Fisher information (2 m, 2 m) of the poles' (Re, Im), interleaved, for unit noise in every coordinate."""
        return _information(self.span.gram, pole_directions(self.coefficients, len(self.poles)))

    @cached_property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(np.vdot(self.residual, self.residual))


def drift_basis(time_s: FloatArray, degree: int) -> FloatArray:
    """Legendre's polynomials (T, degree + 1) over the record."""
    span = max(float(time_s[-1] - time_s[0]), 1e-300)
    return np.polynomial.legendre.legvander(2.0 * (time_s - time_s[0]) / span - 1.0, degree)


def spanned(time_s: FloatArray, poles: ComplexArray, drift: FloatArray) -> Span:
    """The linear model of poles (m,) in 1/s with Im > 0 at stamps (T,), and a drift basis (T, d).

    Its columns are the real and imaginary part of exp(s t) for each pole, then the drift's.
    """
    count = 2 * len(poles)
    basis = np.empty((len(time_s), count + drift.shape[1]), order="F")
    size, phase = np.exp(np.multiply.outer(poles.real, time_s)), np.multiply.outer(poles.imag, time_s)
    basis[:, 0:count:2], basis[:, 1:count:2] = (size * np.cos(phase)).T, (size * np.sin(phase)).T
    basis[:, count:] = drift
    # LAPACK itself: the search makes so many small factors that what is wrapped round them would cost as much.
    factored, tau, *_ = dgeqrf(basis)
    Q, R = dorgqr(factored, tau)[0], factored[: basis.shape[1]] * _upper(basis.shape[1])
    size = np.abs(np.diagonal(R))
    floor = 1e-12 * float(np.max(size))
    for k in np.flatnonzero(size < floor):
        R[k, k] = np.copysign(floor, R[k, k])
    return Span(time_s, poles, basis, Q, R)


@lru_cache
def _upper(size: int) -> FloatArray:
    """Ones (size, size) on the diagonal and above."""
    upper = np.asfortranarray(np.triu(np.ones((size, size))))
    upper.flags.writeable = False
    return upper


def project(time_s: FloatArray, signals: FloatArray, poles: ComplexArray, drift_degree: int) -> Fit:
    """Best linear fit for given poles.

    time_s (T,), signals (T, p) of unit noise variance (whitened), poles (m,) 1/s with Im > 0.
    """
    return spanned(time_s, poles, drift_basis(time_s, drift_degree)).fit(signals)


def pole_directions(X: FloatArray, modes: int) -> FloatArray:
    """Coefficients (2 m, 2, p) of (t cos, t sin) in the model's derivatives by Re s and Im s of each mode."""
    directions = np.empty((2 * modes, 2, X.shape[1]))
    cosine, sine = X[0 : 2 * modes : 2], X[1 : 2 * modes : 2]
    directions[0::2, 0], directions[0::2, 1] = cosine, sine
    directions[1::2, 0], directions[1::2, 1] = sine, -cosine
    return directions


def _information(gram: FloatArray, directions: FloatArray) -> FloatArray:
    """Gauss-Newton matrix from the Gram matrix of (t cos, t sin) outside the linear model's span."""
    modes = len(gram) // 2
    flat = directions.reshape(4 * modes, directions.shape[2])
    products = (flat @ flat.T).reshape(modes, 2, 2, modes, 2, 2) * gram.reshape(modes, 1, 2, modes, 1, 2)
    return products.sum(axis=(2, 5)).reshape(2 * modes, 2 * modes)


def refine(time_s: FloatArray, signals: FloatArray, poles: ComplexArray, drift_degree: int) -> Fit:
    """Poles of least squares, from starting values, by damped Gauss-Newton steps (Levenberg-Marquardt) of
    bounded count.

    time_s (T,) true stamps from 0; signals (T, p) whitened; poles (m,) 1/s. A step changes a pole by at most
    1.5 / T.
    """
    return refined(project(time_s, signals, poles, drift_degree), signals)


def refined(fit: Fit, signals: FloatArray) -> Fit:
    """The same from a fit to the signals with the starting values."""
    poles = fit.poles
    if len(poles) == 0:
        return fit
    longest = 1.5 / max(float(fit.span.time_s[-1]), 1e-300)
    damping = 1e-6
    for _ in range(ITERATIONS):
        # The residual lies outside the span already: t times the columns and their tangent pull alike.
        pull = (fit.tangent.T @ fit.residual).reshape(len(poles), 1, 2, -1)
        directions = pole_directions(fit.coefficients, len(poles)).reshape(len(poles), 2, 2, -1)
        gradient = (directions * pull).sum(axis=(2, 3)).ravel()
        normal = fit.information.copy()
        normal.flat[:: len(normal) + 1] += damping * (normal.flat[:: len(normal) + 1] + 1e-300)
        _, step, failed = dposv(normal, gradient)
        if failed:
            step = np.linalg.lstsq(normal, gradient, rcond=1e-14)[0]
        # The cost falls by this or, where the step is cut, by more.
        if float(step @ gradient) <= _ARRIVED * fit.cost:
            break
        step *= min(1.0, longest / max(float(np.max(np.abs(step))), 1e-300))
        trial = fit.span.of(fit.poles + step[0::2] + 1j * step[1::2]).fit(signals)
        if np.isfinite(trial.cost) and trial.cost <= fit.cost:
            gain = fit.cost - trial.cost
            fit, damping = trial, max(damping * 0.1, 1e-12)
            if gain <= _ARRIVED * fit.cost:
                break
        else:
            damping = max(damping * 10.0, 1e-6)
            if damping > 1e8:
                break
    return fit


def moved(fit: Fit, before: Fit) -> float:
    """How far the poles of a fit are from those of one before, in their deviations; inf if their number has changed."""
    if fit is before:
        return 0.0
    if len(fit.poles) != len(before.poles):
        return np.inf
    step = (fit.poles - before.poles).view(np.float64)
    return float(np.sqrt(max(float(step @ fit.information @ step), 0.0)))


def significance(fit: Fit) -> FloatArray:
    """Wald statistic (m,) of each mode's amplitudes given the others: chi-square, 2 p degrees, for white noise."""
    count = len(fit.poles)
    inverse = dtrtri(fit.triangle)[0]
    rows = inverse[: 2 * count].reshape(count, 2, -1)
    X = fit.coefficients[: 2 * count].reshape(count, 2, -1)
    return np.asarray(np.sum(X * np.linalg.solve(rows @ rows.transpose(0, 2, 1), X), axis=(1, 2)))
