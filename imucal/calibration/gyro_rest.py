"""Gyroscope bias and g-sensitivity from the mean rates at rest.

The mean rate of rest i is b + G f_i + M earth_i + noise. The vertical part of the earth's rotation looks like
a multiple of G; its horizontal part has an unknown heading and counts as noise.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from imucal.arrays import BoolArray, FloatArray, ReadOnlyArrays
from imucal.calibration.gravity import EarthRate
from imucal.calibration.slow_noise import TRUSTED, Excess, Mixture, Spread, mix
from imucal.calibration.turn_data import Headings

__all__ = ["GyroRest", "estimate_gyro_rest"]

#: P-value of chi² of G's nine entries below which G is used.
_SIGNIFICANT = 0.01
#: Standard deviation of an entry of G before any rest, in (rad/s)/(m/s²): 0.28 deg/s/g. Datasheets of
#: consumer gyroscopes give 0.1 deg/s/g.
_SENSITIVITY = 5e-4
#: Raw units per rad/s that make the prior of G wider than any sensor's.
_NO_PRIOR = 1e9
#: A column of G is not observable if its deviation is more than this share of the one before any rest.
_DOMINATES = 0.4


@dataclass(frozen=True, kw_only=True, eq=False)
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
    scale_known: bool = True,
) -> GyroRest:
    """Estimate bias and g-sensitivity by generalised least squares, axis by axis.

    `means` are raw rates, `f` calibrated specific forces in m/s², shape (m, 3). `base`, shape (3, m, m), is
    the covariance of the means. `scale` is M_g in raw units per rad/s. If `checked`, `base` is used alone if
    its chi² has p >= 0.2.
    """
    m = len(means)
    sizes = np.linalg.norm(scale, axis=1)
    # The prior of G needs the scale; raw counts without turns have none.
    prior_sizes = sizes if scale_known else np.full(3, _NO_PRIOR)
    horizontal = (sizes * earth.horizontal_sigma)[:, None, None] ** 2
    base = base + horizontal * (headings.covariance if headings else np.eye(m))
    full = np.column_stack([np.ones(m), f])
    shown = _shown_columns(full, base, prior_sizes)
    X = full[:, shown]
    # Columns of G that the rests do not show count as noise.
    hidden = full[:, ~shown]
    unknown = (prior_sizes[:, None, None] * _SENSITIVITY) ** 2 * (hidden @ hidden.T)
    fits = _axes(means, X, base, walk, unknown)
    trusted = checked and _p_value(fits, 3 * (m - X.shape[1])) >= TRUSTED
    turning = scale * earth.vertical / gravity
    unsure = (scale * earth.vertical_sigma / gravity).ravel()
    estimates = [first if trusted else mixed for first, mixed, *_ in fits]
    sensitivity = _sensitivity(estimates, turning, unsure, shown[1:])
    significant = sensitivity.p < _SIGNIFICANT
    applied = np.nan_to_num(sensitivity.G) if significant else np.zeros((3, 3))
    if not significant:
        fits = _axes(means - f @ turning.T, full[:, :1], base, walk, unknown)
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


def _shown_columns(full: FloatArray, base: FloatArray, sizes: FloatArray) -> BoolArray:
    """Return which parameters of an axis, bias and a row of G, the rests show, shape (4,)."""
    shown = np.ones(full.shape[1], dtype=np.bool_)
    while True:
        largest = np.zeros(shown.size)
        for K, size in zip(base, sizes, strict=True):
            deviation = np.full(shown.size, size * _SENSITIVITY)
            X = full * deviation
            S = K + X[:, ~shown] @ X[:, ~shown].T
            information = X.T @ np.linalg.solve(S, X)
            # The bias has no prior.
            information[1:, 1:] += np.eye(len(deviation) - 1)
            covariance = np.linalg.inv(information[np.ix_(shown, shown)])
            largest[shown] = np.maximum(largest[shown], np.sqrt(np.diag(covariance)))
        unseen = shown & (largest > _DOMINATES)
        unseen[0] = False
        if not unseen.any():
            return shown
        shown &= ~unseen


def _p_value(fits: list[tuple[Mixture, Mixture, Excess, float]], dof: int) -> float:
    return float(chdtrc(dof, sum(chi2 for *_, chi2 in fits))) if dof else 1.0


class _Sensitivity(NamedTuple):
    """The estimate of G, its intervals (3, 3, 2), p, and `earth_share`."""

    G: FloatArray
    interval: FloatArray
    p: float
    earth_share: float


def _sensitivity(
    mixtures: list[Mixture], turning: FloatArray, unsure: FloatArray, shown: BoolArray
) -> _Sensitivity:
    """Return G without the earth's rotation `turning`, whose deviation is `unsure`, shape (9,).

    `shown`, shape (3,), are the columns of G that the mixtures contain after the bias.
    """
    G, interval = np.full((3, 3), np.nan), np.full((3, 3, 2), np.nan)
    entries = np.tile(shown, 3)
    if not shown.any():
        return _Sensitivity(G, interval, p=math.nan, earth_share=0.0)
    covariance = np.outer(unsure, unsure)
    columns = np.flatnonzero(shown)
    for axis, mixture in enumerate(mixtures):
        G[axis, columns] = mixture.mean[1:] - turning[axis, columns]
        rows = 3 * axis + columns
        own = np.diag(mixture.covariance)[1:]
        covariance[np.ix_(rows, rows)] += mixture.covariance[1:, 1:]
        wider = np.sqrt(np.diag(covariance)[rows] / own)
        halves = mixture.interval(np.eye(mixture.mean.size)[1:]) * wider[:, None]
        interval[axis, columns] = G[axis, columns, None] + halves
    covariance = covariance[np.ix_(entries, entries)]
    on_diagonal = np.eye(3, dtype=np.bool_).ravel()[entries]
    by_earth = float((unsure[entries][on_diagonal] ** 2).sum())
    share = math.sqrt(by_earth / float(np.diag(covariance)[on_diagonal].sum()))
    known = G.ravel()[entries]
    p = float(chdtrc(known.size, known @ np.linalg.solve(covariance, known)))
    return _Sensitivity(G, interval, p, share)


def _axes(
    means: FloatArray, X: FloatArray, base: FloatArray, walk: FloatArray, unknown: FloatArray
) -> list[tuple[Mixture, Mixture, Excess, float]]:
    return [_axis(y, X, K, walk, by_G) for y, K, by_G in zip(means.T, base, unknown, strict=True)]


def _axis(
    y: FloatArray, X: FloatArray, K: FloatArray, walk: FloatArray, unknown: FloatArray
) -> tuple[Mixture, Mixture, Excess, float]:
    """Return an axis's parameters by the base alone and with slow noise, its excess, and the base's chi².

    `unknown` is the covariance by columns of G that the rests do not show.
    """
    L = np.linalg.cholesky(K + unknown)
    Xw, yw = (solve_triangular(L, values, lower=True) for values in (X, y))
    covariance = np.linalg.inv(Xw.T @ Xw)
    theta = covariance @ (Xw.T @ yw)
    mixed, excess, _ = mix(
        X @ theta - y, X, theta, (K + unknown, np.eye(len(y)), walk), Spread.of(K[None], walk)
    )
    return Mixture.single(theta, covariance), mixed, excess, float(np.sum((yw - Xw @ theta) ** 2))
