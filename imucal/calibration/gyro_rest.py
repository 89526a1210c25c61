"""Gyroscope bias and g-sensitivity from the mean rates at rest.

The mean rate of rest i is b + G f_i + M earth_i + noise. The vertical part of the earth's rotation looks like
a multiple of G; its horizontal part has an unknown heading and counts as noise.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.gravity import EarthRate
from imucal.calibration.slow_noise import TRUSTED, Excess, Mixture, Spread, mix
from imucal.calibration.turn_data import Headings
from imucal.frozen import frozen_alone

__all__ = ["GyroRest", "estimate_gyro_rest"]

#: P-value of chi² of G's nine entries below which G is used.
_SIGNIFICANT = 0.01
#: Minimum number of rests beyond the parameters of one axis.
_MIN_BEYOND = 2


@frozen_alone
class GyroRest(ReadOnlyArrays):
    """Bias and g-sensitivity of a gyroscope, with 95 % intervals.

    `G`, in raw units per m/s², is zero unless `significant`. `G_estimate` and `G_interval`, shape (3, 3, 2),
    are NaN if unknown. `G_apparent` includes the vertical part of the earth's rotation. `earth_share` is the
    unknown earth rate's share of the deviation of the diagonal of G.
    """

    b: FloatArray
    b_interval: FloatArray
    G: FloatArray
    G_estimate: FloatArray
    G_interval: FloatArray
    G_apparent: FloatArray
    significant: bool
    earth_share: float
    excess: tuple[Excess, ...]


def estimate_gyro_rest(
    means: FloatArray,
    f: FloatArray,
    base: FloatArray,
    walk: FloatArray,
    *,
    scale: FloatArray,
    earth: EarthRate,
    gravity: float,
    checked: bool,
    headings: Headings | None = None,
) -> GyroRest:
    """Estimate bias and g-sensitivity by generalised least squares, axis by axis.

    `means` are raw rates, `f` calibrated specific forces in m/s², shape (m, 3). `base`, shape (3, m, m), is
    the covariance of the means. `scale` is M_g in raw units per rad/s. If `checked`, `base` is used alone if
    its chi² has p >= 0.2.
    """
    m = len(means)
    horizontal = (np.linalg.norm(scale, axis=1) * earth.horizontal_sigma)[:, None, None] ** 2
    base = base + horizontal * (headings.covariance if headings else np.eye(m))
    full = np.column_stack([np.ones(m), f])
    known = m >= full.shape[1] + _MIN_BEYOND and np.linalg.matrix_rank(full, tol=0.1 * gravity) == 4
    X = full if known else full[:, :1]
    fits = _axes(means, X, base, walk)
    trusted = checked and _p_value(fits, 3 * (m - X.shape[1])) >= TRUSTED
    turning = scale * earth.vertical / gravity
    unsure = (scale * earth.vertical_sigma / gravity).ravel()
    sensitivity = _sensitivity([first if trusted else mixed for first, mixed, *_ in fits], turning, unsure)
    significant = sensitivity.p < _SIGNIFICANT
    applied = sensitivity.G if significant else np.zeros((3, 3))
    if not significant:
        fits = _axes(means - f @ turning.T, full[:, :1], base, walk)
    chosen = [(first, Excess()) if trusted else (mixed, excess) for first, mixed, excess, _ in fits]
    b = np.array([mixture.mean[0] for mixture, _ in chosen])
    halves = np.array([mixture.interval(np.eye(mixture.mean.size)[:1])[0] for mixture, _ in chosen])
    return GyroRest(
        b=b,
        b_interval=b[:, None] + halves,
        G=applied,
        G_estimate=sensitivity.G,
        G_interval=sensitivity.interval,
        G_apparent=applied + turning,
        significant=significant,
        earth_share=sensitivity.earth_share,
        excess=tuple(excess for _, excess in chosen),
    )


def _p_value(fits: list[tuple[Mixture, Mixture, Excess, float]], dof: int) -> float:
    return float(chdtrc(dof, sum(chi2 for *_, chi2 in fits))) if dof else 1.0


class _Sensitivity(NamedTuple):
    """The estimate of G, its intervals (3, 3, 2), p, and `earth_share`."""

    G: FloatArray
    interval: FloatArray
    p: float
    earth_share: float


def _sensitivity(mixtures: list[Mixture], turning: FloatArray, unsure: FloatArray) -> _Sensitivity:
    """Return G without the earth's rotation `turning`, whose deviation is `unsure`, shape (9,)."""
    if mixtures[0].mean.size == 1:
        return _Sensitivity(np.full((3, 3), np.nan), np.full((3, 3, 2), np.nan), p=math.nan, earth_share=0.0)
    G = np.array([mixture.mean[1:] for mixture in mixtures]) - turning
    covariance = np.outer(unsure, unsure)
    interval = np.empty((3, 3, 2))
    for axis, mixture in enumerate(mixtures):
        rows = slice(3 * axis, 3 * axis + 3)
        own = np.diag(mixture.covariance)[1:]
        covariance[rows, rows] += mixture.covariance[1:, 1:]
        wider = np.sqrt(np.diag(covariance)[rows] / own)
        interval[axis] = G[axis, :, None] + mixture.interval(np.eye(4)[1:]) * wider[:, None]
    share = math.sqrt(float((unsure[::4] ** 2).sum() / np.diag(covariance)[::4].sum()))
    p = float(chdtrc(9, G.ravel() @ np.linalg.solve(covariance, G.ravel())))
    return _Sensitivity(G, interval, p, share)


def _axes(
    means: FloatArray, X: FloatArray, base: FloatArray, walk: FloatArray
) -> list[tuple[Mixture, Mixture, Excess, float]]:
    return [_axis(y, X, K, walk) for y, K in zip(means.T, base, strict=True)]


def _axis(
    y: FloatArray, X: FloatArray, K: FloatArray, walk: FloatArray
) -> tuple[Mixture, Mixture, Excess, float]:
    """Return an axis's parameters by the base alone and with slow noise, its excess, and the base's chi²."""
    L = np.linalg.cholesky(K)
    Xw, yw = (solve_triangular(L, values, lower=True) for values in (X, y))
    covariance = np.linalg.inv(Xw.T @ Xw)
    theta = covariance @ (Xw.T @ yw)
    mixed, excess, _ = mix(X @ theta - y, X, theta, (K, np.eye(len(y)), walk), Spread.of(K[None], walk))
    return Mixture.single(theta, covariance), mixed, excess, float(np.sum((yw - Xw @ theta) ** 2))
