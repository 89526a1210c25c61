"""Slow noise between rests: how much more the means differ than the noise model, averaged over its size.

The base covariance gets two terms: tau² for each rest and axis, and a random walk kappa. Their likelihood is
REML's, with half-Cauchy priors that scale with the base, on a grid. Noise within short rests does not reveal
slower noise.

Source: Patterson & Thompson (1971), Biometrika 58, 545 (REML); Gelman (2006), Bayesian Analysis 1, 515
(half-Cauchy prior).
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import chdtrc, ndtr

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.accelerometer import (
    AccelerometerFit,
    derivatives,
    fit_accelerometer,
    residual_covariance,
)
from imucal.calibration.mean_covariance import mean_covariance
from imucal.noise import TERMS, NoiseModel

__all__ = [
    "TRUSTED",
    "AccelerometerEstimate",
    "Excess",
    "Mixture",
    "Spread",
    "estimate_accelerometer",
    "mix",
    "walk_covariance",
]

#: P-value of chi² below which a base is not used alone.
TRUSTED = 0.2
#: Cells of the grid in each direction.
_CELLS = 10
#: Ends of the grid, in deviations of the base.
_GRID_ENDS = (0.05, 60.0)
#: Halvings of the range in which a limit is searched: it is then exact to 1e-12 of the range.
_BISECTIONS = 40
#: Rounds of estimating the excess and fitting again.
_ROUNDS = 2
_WALK = NoiseModel(terms=(TERMS["K"].of(1.0),))


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture(ReadOnlyArrays):
    """Parameters as a mixture of k normals: means (k, p), covariances (k, p, p), weights (k,)."""

    means: FloatArray
    covariances: FloatArray
    weights: FloatArray

    @classmethod
    def single(cls, mean: FloatArray, covariance: FloatArray) -> "Mixture":
        return cls(means=mean[None], covariances=covariance[None], weights=np.ones(1))

    @property
    def mean(self) -> FloatArray:
        return np.asarray(self.weights @ self.means)

    @property
    def covariance(self) -> FloatArray:
        apart = self.means - self.mean
        within = np.einsum("k,kij->ij", self.weights, self.covariances)
        return np.asarray(within + np.einsum("k,ki,kj->ij", self.weights, apart, apart))

    def interval(self, rows: FloatArray, *, level: float = 0.95) -> FloatArray:
        """Return the interval of each combination in `rows`, shape (q, p), minus its mean, shape (q, 2)."""
        centres = (self.means - self.mean) @ rows.T
        deviations = np.sqrt(np.maximum(np.einsum("qi,kij,qj->kq", rows, self.covariances, rows), 0.0))
        deviations = np.maximum(deviations, np.finfo(float).tiny)
        targets = np.array([[(1 - level) / 2], [(1 + level) / 2]])
        reach = (np.abs(centres) + 8 * deviations).max(axis=0)
        low, high = np.tile(-reach, (2, 1)), np.tile(reach, (2, 1))
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            share = np.einsum(
                "k,kcq->cq", self.weights, ndtr((middle - centres[:, None]) / deviations[:, None])
            )
            low, high = np.where(share < targets, middle, low), np.where(share < targets, high, middle)
        return np.asarray((low + high).T / 2)


@dataclass(frozen=True, kw_only=True)
class Excess:
    """Slow noise beyond the base: deviation `tau` of each rest and axis, and a random walk of `kappa` per √s.

    `walk_share` is the walk's share of the variance.
    """

    tau: float = 0.0
    kappa: float = 0.0
    walk_share: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Scales of grid and priors: deviation of the base, and of a walk with kappa = 1, between rests."""

    base: float
    walk: float

    @classmethod
    def of(cls, covariances: FloatArray, walk: FloatArray) -> "Spread":
        """Return the sizes for covariances of means, shapes (a, m, m) and (m, m)."""
        return cls(base=_between(np.mean(covariances, axis=0)), walk=_between(walk))


def walk_covariance(spans: IntArray, *, rate_hz: float, samples: int) -> FloatArray:
    """Return `mean_covariance` of a random walk with K = 1."""
    return mean_covariance(_WALK, spans, rate_hz=rate_hz, samples=samples)


def mix(
    residual: FloatArray,
    J: FloatArray,
    theta: FloatArray,
    parts: tuple[FloatArray, FloatArray, FloatArray],
    spread: Spread,
) -> tuple[Mixture, Excess, Excess]:
    """Return the parameters over the grid of (tau, kappa), the mean excess and the most likely one.

    `residual`, shape (m,), and its derivatives J, shape (m, p), are at the parameters `theta`. `parts` are
    covariances of the residuals, each (m, m): the base; tau = 1; kappa = 1.
    """
    base, rest, walk = parts
    shares, prior = _grid()
    tau, kappa = (
        side.ravel() for side in np.meshgrid(shares, shares * spread.base / spread.walk, indexing="ij")
    )
    tau = tau * spread.base
    S = base + tau[:, None, None] ** 2 * rest + kappa[:, None, None] ** 2 * walk
    size = np.linalg.norm(J / np.sqrt(np.diag(base))[:, None], axis=0)
    L = np.linalg.cholesky(S)
    both = np.column_stack([J / size, residual])
    whitened = np.linalg.solve(L, np.broadcast_to(both, (tau.size, *both.shape)))
    Jw, rw = whitened[:, :, :-1], whitened[:, :, -1]
    N = np.linalg.inv(Jw.transpose(0, 2, 1) @ Jw)
    step = -(N @ (Jw.transpose(0, 2, 1) @ rw[..., None]))[..., 0]
    left = rw + (Jw @ step[..., None])[..., 0]
    likelihood = (
        -np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        + 0.5 * np.linalg.slogdet(N)[1]
        - 0.5 * (left**2).sum(axis=1)
        + np.log(np.outer(prior, prior).ravel())
    )
    weights = np.exp(likelihood - likelihood.max())
    weights /= weights.sum()
    mixture = Mixture(means=theta + step / size, covariances=N / np.outer(size, size), weights=weights)
    best = int(np.argmax(likelihood))
    mean = (math.sqrt(float(weights @ tau**2)), math.sqrt(float(weights @ kappa**2)))
    return mixture, _excess(*mean, spread), _excess(float(tau[best]), float(kappa[best]), spread)


@dataclass(frozen=True, kw_only=True, eq=False)
class AccelerometerEstimate(ReadOnlyArrays):
    """An accelerometer's parameters with their distribution.

    `fit` is at the most likely slow noise. `covariances`, shape (3, m, m), of the means include the mean slow
    noise. `excess` is zero if the base is trusted. `chi2`, `dof` and `p` are of the base alone.
    """

    fit: AccelerometerFit
    mixture: Mixture
    excess: Excess
    chi2: float
    dof: int
    p: float
    covariances: FloatArray

    @property
    def theta(self) -> FloatArray:
        """Mean of all nine parameters; the fit's value for fixed ones."""
        theta = self.fit.theta.copy()
        theta[self.fit.free] = self.mixture.mean
        return theta

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all nine parameters; zero for fixed ones."""
        full = np.zeros((9, 9))
        full[np.ix_(self.fit.free, self.fit.free)] = self.mixture.covariance
        return full


def estimate_accelerometer(
    means: FloatArray,
    base: FloatArray,
    walk: FloatArray,
    *,
    gravity: float,
    gravity_sigma: float = 0.0,
    checked: bool,
    free: BoolArray | None = None,
    si: bool = False,
) -> AccelerometerEstimate:
    """Fit the accelerometer and, if the base does not explain the residuals, the slow noise.

    `base`, shape (3, m, m), is the covariance of the raw `means`, shape (m, 3). If `checked`, it is a model
    of a long static log, used alone if its chi² has p >= 0.2 or nothing can be checked. `si` is whether the
    means are in m/s². Rests that do not determine bias and scale raise a DataError.
    """
    fit_with = partial(fit_accelerometer, means, gravity=gravity, gravity_sigma=gravity_sigma, si=si)
    fit = first = fit_with(base, free=free)
    p = float(chdtrc(first.dof, first.chi2)) if first.dof > 0 else math.nan
    free, covariances = first.free, base
    mixture = Mixture.single(first.theta[free], first.covariance[np.ix_(free, free)])
    excess = Excess()
    if not (checked and (math.isnan(p) or p >= TRUSTED)):
        spread = Spread.of(base, walk)
        for _ in range(_ROUNDS):
            _, J, weights = derivatives(means, fit.C, fit.b)
            # The rest of the covariance: unknown gravity and ignored misalignment.
            own = residual_covariance(weights, covariances)
            other = fit.residual_covariance - own
            walks = weights @ weights.T * walk
            prior, prior_slopes = fit.prior()
            parts = (
                _with_prior(residual_covariance(weights, base) + other, np.eye(prior.size)),
                _with_prior(np.diag((weights**2).sum(axis=1)), np.zeros((prior.size, prior.size))),
                _with_prior(walks, np.zeros((prior.size, prior.size))),
            )
            mixture, excess, likely = mix(
                np.concatenate([fit.residual, prior]),
                np.vstack([J, prior_slopes])[:, free],
                fit.theta[free],
                parts,
                spread,
            )
            covariances = base + likely.tau**2 * np.eye(len(means)) + likely.kappa**2 * walk
            fit = fit_with(covariances, free=free, start=(fit.C, fit.b))
            # With more noise fewer misalignments are observable.
            if np.any(fit.free != free):
                return estimate_accelerometer(
                    means,
                    base,
                    walk,
                    gravity=gravity,
                    gravity_sigma=gravity_sigma,
                    checked=checked,
                    free=fit.free,
                    si=si,
                )
    total = base + excess.tau**2 * np.eye(len(means)) + excess.kappa**2 * walk
    return AccelerometerEstimate(
        fit=fit,
        mixture=mixture,
        excess=excess,
        chi2=first.chi2,
        dof=first.dof,
        p=p,
        covariances=total,
    )


def _between(covariance: FloatArray) -> float:
    m = len(covariance)
    return math.sqrt(max(float(np.trace(covariance) - covariance.sum() / m) / max(m - 1, 1), 0.0))


def _with_prior(residuals: FloatArray, prior: FloatArray) -> FloatArray:
    m, k = len(residuals), len(prior)
    together = np.zeros((m + k, m + k))
    together[:m, :m] = residuals
    together[m:, m:] = prior
    return together


def _excess(tau: float, kappa: float, spread: Spread) -> Excess:
    walk = (kappa * spread.walk) ** 2
    return Excess(tau=tau, kappa=kappa, walk_share=walk / (walk + tau**2))


def _grid() -> tuple[FloatArray, FloatArray]:
    """Return sizes relative to the base, and their half-Cauchy weights."""
    edges = np.concatenate([[0.0], np.geomspace(*_GRID_ENDS, _CELLS - 1)])
    middles = np.concatenate([[edges[1] / 2], np.sqrt(edges[1:-1] * edges[2:]), [1.5 * edges[-1]]])
    below = np.concatenate([2 / math.pi * np.arctan(edges), [1.0]])
    return middles, np.diff(below)
