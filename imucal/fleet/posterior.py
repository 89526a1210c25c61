"""The posterior of a fleet's median mu, the spread tau between units and the scatter omega within them.

The logarithm of the coefficient in log l of unit u is ``mu + tau b_u + omega c_ul``, with standard normal b
and c. The likelihood of a unit is normal if all of its logs are precise, otherwise tabulated on a grid.

If the units are precise, the prior of mu is flat and tau has Jeffreys' prior. If they are only bounded, a
flat prior would determine the result. The prior is then flat in the square of the median, and the prior of
tau is the usual spread of units of one model.

Sources: Hardy & Thompson (1996), Statistics in Medicine 15, p. 619 (likelihood of random effects); Tiao & Tan
(1965), Biometrika 52, p. 37 (prior for a one-way layout); Krishnamoorthy & Mathew (2009), Statistical
Tolerance Regions, chapters 2 and 5 (bound).
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.noise_fit import Interval
from imucal.fleet.values import LogValues, Squares
from imucal.frozen import frozen

#: Grid points of an imprecise unit's coefficient, of mu, of tau and of omega.
_POINTS, _MUS, _TAUS, _OMEGAS = 301, 61, 48, 12
#: Maximum number of times that a grid is narrowed.
_ROUNDS = 6
#: Extent of the grids, in the logarithm; a coefficient 50 times smaller is invisible.
_DEEPEST = 4.0
#: Spread between units or logs, in the logarithm: usual, and largest.
_USUAL, _WIDEST = 0.5, 2.0
#: Tail probability, and relative weight, of a negligible scatter within units.
_RARE, _LITTLE = 1e-3, 1e-4
#: Log-posterior below its peak at which points are ignored.
_NOTHING = 16.0
#: Limits that keep logarithms of small probabilities and exponentials finite.
_TINY, _LARGEST = math.exp(-690), 600.0
#: Points of the predictive distributions; smaller weights of the posterior are ignored.
_GRID, _UNLIKELY = 801, 1e-7
#: Shares by which widths and centres of merged normal distributions may differ.
_SAME_NORMAL, _SAME_CENTRE = 0.02, 0.2
#: Extent of the distribution of the next log, in standard deviations.
_FARTHEST = 6.0
#: Points of the predictive distribution with which an imprecise unit is compared.
_DRAWS = 4000
#: Multiples of the golden ratio modulo 1 fill the unit interval evenly and look random.
_GOLDEN = (math.sqrt(5) - 1) / 2
#: Two-sided normal quantile of 95 %, and probabilities of limits and median.
TWO_SIDED = 1.959963984540054
TAILS = (0.025, 0.5, 0.975)


def interval_of(quantiles: FloatArray) -> Interval:
    """Return the interval of quantiles at `TAILS`."""
    low, value, high = quantiles.tolist()
    return Interval(value=value, low=low, high=high)


class UnitLikelihoods:
    """Likelihoods of the logarithms of the units' coefficients, if logs of one unit scatter by `omega`.

    `normal` units have a `centre` and a `deviation`, shape (units,). For other units the likelihoods divided
    by their peaks are `weak`, shape (weak units, points), at `theta`, shape (points,). `constant` is the rest
    of the log-likelihood.
    """

    def __init__(self, logs: LogValues, omega: float) -> None:
        self.omega, self.about = omega, logs.middle
        self.normal: BoolArray = np.bincount(logs.unit, ~logs.narrow) == 0
        square = math.exp(2 * logs.middle)
        weak_error = logs.squares.deviation(square) / (2 * square)
        error = np.where(logs.narrow | logs.by_limits, logs.deviation, weak_error)
        weights = 1 / (error**2 + omega**2)
        total = np.maximum(np.bincount(logs.unit, weights), _TINY)
        self.centre: FloatArray = np.bincount(logs.unit, weights * logs.centre) / total
        self.deviation: FloatArray = 1 / np.sqrt(total)
        reach = min(9 * logs.scale, _DEEPEST)
        ends = logs.middle - _DEEPEST - reach, logs.middle + reach + 3 * logs.scale
        self.theta: FloatArray = np.linspace(*ends, _POINTS)
        own = self.normal[logs.unit]
        others = logs.take(~own)
        each = others.log_likelihood(self.theta)
        if omega > 0 and each.size:
            top = each.max(axis=1, keepdims=True)
            each = np.log(np.exp(each - top) @ blur(self.theta, self.theta, omega).T + _TINY) + top
        weak = np.zeros((len(others.names), _POINTS))
        np.add.at(weak, others.unit, each)
        peaks = weak.max(axis=1, keepdims=True)
        self.weak: FloatArray = np.exp(weak - peaks)
        apart = weights * (logs.centre - self.centre[logs.unit]) ** 2
        scatter = np.sum(np.log(weights[own]) - apart[own]) - np.sum(np.log(total[self.normal]))
        self.constant = 0.5 * float(scatter) + float(peaks.sum())

    def limits(self) -> tuple[BoolArray, FloatArray]:
        """Return which units are estimated, and the 95 % limits and maxima of all units, shape (3, units)."""
        values, limits = self.normal.copy(), self.centre + np.outer((-1, 0, 1), TWO_SIDED * self.deviation)
        for unit, curve in zip(np.flatnonzero(~values).tolist(), self.weak, strict=True):
            inside = self.theta[curve > math.exp(-(TWO_SIDED**2) / 2)]
            limits[:, unit] = inside[0], self.theta[curve.argmax()], inside[-1]
            values[unit] = inside[0] > self.theta[0]
        return values, limits

    def log_posterior(self, tau: FloatArray, mu: FloatArray, blurs: Sequence[FloatArray]) -> FloatArray:
        """Return the log-posterior, a density in log tau; it and `mu` have the shape (tau, mu).

        `blurs` contains for each tau the matrix that averages likelihoods at `theta` around its row of mu.
        """
        v = self.deviation[self.normal] ** 2 + tau[:, None] ** 2
        y, offset = self.centre[self.normal] - mu[:, :1], mu - mu[:, :1]
        first, second = (np.sum(part, axis=1)[:, None] for part in (y / v, 1 / v))
        squares = np.sum(y * y / v, axis=1)[:, None] - 2 * offset * first + offset**2 * second
        result: FloatArray = self.constant - 0.5 * (squares + np.sum(np.log(v), axis=1)[:, None])
        if blurs:
            result += [np.log(matrix @ self.weak.T + _TINY).sum(axis=1) for matrix in blurs]
            result += self._prior_of_median(mu)
        return result + self._prior(tau)[:, None]

    def _prior(self, tau: FloatArray) -> FloatArray:
        """Return the log-prior of log tau and omega: Jeffreys' prior for precise units."""
        t2, variance = tau**2, self.deviation**2
        values = 0.5 * np.log(np.sum(1 / (variance + t2[:, None]) ** 2, axis=1)) + np.log(t2)
        usual = np.log(tau) - 0.5 * (t2 + self.omega**2) / _USUAL**2
        unknown = float(np.mean((variance / (variance + _USUAL**2)) ** 2))
        result: FloatArray = (1 - unknown) * values + unknown * usual
        return result

    def _prior_of_median(self, mu: FloatArray) -> FloatArray:
        """Return Jeffreys' log-prior of mu at the usual spread; for weak units it is flat in exp(2 mu)."""
        variance = self.deviation**2
        values = float(np.sum(1 / (variance[self.normal] + _USUAL**2)))
        weak, precision = len(self.weak), float(np.mean(1 / variance[~self.normal]))
        at = np.exp(np.minimum(-4 * (mu - self.about), _LARGEST)) / precision
        return 0.5 * np.log((values + weak / (at + _USUAL**2)) / (values + weak / _USUAL**2))


def blur(theta_to: FloatArray, theta: FloatArray, width: float) -> FloatArray:
    """Return the matrix of means of a function on `theta` over normal distributions about `theta_to`."""
    step = float(theta[1] - theta[0])
    wide = max(width, step / 2)
    kernel = np.exp(-0.5 * ((theta_to[:, None] - theta) / wide) ** 2)
    cell = math.sqrt(2 * math.pi) * wide / step
    kernel[:, 0] = cell * scipy.special.ndtr((theta[0] + step / 2 - theta_to) / wide)
    kernel[:, -1] = cell * scipy.special.ndtr((theta_to - theta[-1] + step / 2) / wide)
    result: FloatArray = kernel / kernel.sum(axis=1, keepdims=True)
    return result


def two_sided(chance: FloatArray) -> FloatArray:
    """Return two-sided p-values from lower tail probabilities."""
    return 2 * np.minimum(chance, 1 - chance)


@frozen
class NextLog:
    """Distribution of the logarithm of a new unit's log, without the log's own error.

    `below` is the distribution function at the ascending `points`.
    """

    points: tuple[float, ...]
    below: tuple[float, ...]

    def p_value(self, new: LogValues) -> float:
        step, weight = np.diff(self.points), np.diff(self.below)
        at = np.asarray(self.points[1:]) - step / 2
        if new.narrow.all():
            # The distribution is uniform between two points.
            error = np.hypot(new.deviation[0], step / math.sqrt(12))
            less = scipy.special.ndtr((new.centre[0] - at) / error)
        else:
            less = new.squares.below(np.exp(2 * np.minimum(at, _LARGEST / 2)))[0]
        return float(two_sided(less @ weight / weight.sum()))


class Posterior:
    """Weights on a grid of omega, tau and mu, which are broadcast against each other; their sum is 1."""

    def __init__(self, values: LogValues, omegas: FloatArray | None = None) -> None:
        omegas = _scatters(values) if omegas is None else omegas
        units = [UnitLikelihoods(values, omega) for omega in omegas.tolist()]
        taus = (math.log(0.01 * values.scale), math.log(max(_WIDEST, 2 * values.scale)))
        for _ in range(_ROUNDS):
            tau = np.exp(np.linspace(*taus, _TAUS))
            mu, height = _over_mu(values, units, tau)
            height -= height.max()
            narrower = support(np.log(tau), np.any(height > -_NOTHING, axis=(0, 2)))
            if 2 * (narrower[1] - narrower[0]) > taus[1] - taus[0]:
                break
            taus = narrower
        self.omega, self.tau, self.mu = omegas[:, None, None], tau[None, :, None], mu[None]
        self.weight: FloatArray = np.exp(height) / np.exp(height).sum()

    @classmethod
    def whole(cls, values: LogValues) -> "Posterior":
        """Return the posterior over all values of omega, on a finer second grid for imprecise logs."""
        found = cls(values)
        if values.narrow.all() or len(found.omega) < 2:
            return found
        omega, weight = found.omega.ravel(), found.weight.sum(axis=(1, 2))
        low, high = support(omega, weight > _LITTLE * weight.max())
        return cls(values, np.linspace(low, high, _OMEGAS))

    def quantiles(self, values: FloatArray, at: Sequence[float]) -> FloatArray:
        """Return quantiles of a function of the grid."""
        keep = self.weight > math.exp(-_NOTHING) * self.weight.max()
        every, weights = np.broadcast_to(values, self.weight.shape)[keep], self.weight[keep]
        order = np.argsort(every)
        total = np.cumsum(weights[order])
        result: FloatArray = np.interp(np.asarray(at) * total[-1], total - weights[order] / 2, every[order])
        return result

    def prediction(self, at: Sequence[float] | FloatArray) -> FloatArray:
        """Return quantiles of the logarithm of the coefficient of a new unit."""
        return _Law(self.mu[0], self.tau[0], self.weight.sum(axis=0)).quantiles(at)

    def next_log(self) -> NextLog:
        law = _Law(self.mu, np.hypot(self.tau, self.omega), self.weight)
        points = np.unique(law.quantiles(scipy.special.ndtr(np.linspace(-_FARTHEST, _FARTHEST, _GRID))))
        return NextLog(points=tuple(points.tolist()), below=tuple(law.below(points).tolist()))

    def p_value(self, unit: LogValues) -> float:
        """Return the two-sided p-value of the logs of one new unit, all of them narrow."""
        weight = 1 / (unit.deviation**2 + self.omega**2)
        total = weight.sum(axis=-1, keepdims=True)
        apart = weight @ unit.centre[:, None] / total - self.mu
        score = apart / np.sqrt(self.tau**2 + 1 / total)
        return float(two_sided(np.sum(self.weight * scipy.special.ndtr(score))))

    def p_values(self, units: Squares, scatter: FloatArray) -> FloatArray:
        """Return two-sided p-values of squared coefficients of new units, shape (units,).

        `scatter`, shape (units,), is the deviation of the mean of a unit's logs about the unit.
        """
        at = (np.arange(_DRAWS) + 0.5) / _DRAWS
        log, moved = self.prediction(at), scipy.special.ndtri((at * _DRAWS * _GOLDEN) % 1)
        return two_sided(units.below(np.exp(2 * (log + scatter[:, None] * moved))).mean(axis=1))


class _Law:
    """A mixture of normal distributions with centres `mu`, widths `wide` and weights."""

    def __init__(self, mu: FloatArray, wide: FloatArray, weight: FloatArray) -> None:
        keep = weight > _UNLIKELY * weight.max()
        mu, wide, weight = (np.broadcast_to(part, weight.shape)[keep] for part in (mu, wide, weight))
        weight /= weight.sum()
        # Replace nearly equal distributions by one with their common mean and variance.
        widths = np.floor(np.log(wide) / _SAME_NORMAL)
        places = np.floor(mu / (_SAME_CENTRE * np.exp(widths * _SAME_NORMAL)))
        same = np.unique(widths + 1j * places, return_inverse=True)[1]
        self._weight = np.bincount(same, weight)
        self._mu = np.bincount(same, weight * mu) / self._weight
        apart = np.bincount(same, weight * (wide**2 + (mu - self._mu[same]) ** 2))
        self._wide = np.sqrt(apart / self._weight)
        middle, usual = float(self._mu @ self._weight), float(self._wide @ self._weight)
        reach = 6 * float(self._wide.max()) + np.array([middle - self._mu.min(), self._mu.max() - middle])
        ends = np.arcsinh(reach / usual)
        self.points = middle + usual * np.sinh(np.linspace(-ends[0], ends[1], _GRID))

    def below(self, points: FloatArray) -> FloatArray:
        # All points at once would need too much memory.
        apart = ((at - self._mu) / self._wide for at in points)
        return np.array([float(scipy.special.ndtr(one) @ self._weight) for one in apart])

    def quantiles(self, at: Sequence[float] | FloatArray) -> FloatArray:
        return np.interp(at, self.below(self.points), self.points)


def _scatters(values: LogValues) -> FloatArray:
    """Return evenly spaced values of omega; only 0 if no unit has two logs."""
    counts = np.bincount(values.unit)
    degrees = values.unit.size - counts.size
    if degrees == 0:
        return np.zeros(1)
    means = np.bincount(values.unit, values.centre) / counts
    squares = float(np.sum((values.centre - means[values.unit]) ** 2))
    if not values.narrow.all():
        return np.linspace(0.0, min(3 * math.sqrt(squares / degrees) + 0.3, _WIDEST), _OMEGAS)
    known = float(np.mean(values.deviation**2))
    low, high = (squares / float(scipy.special.chdtri(degrees, tail)) for tail in (_RARE, 1 - _RARE))
    most = 10 * math.sqrt(squares / degrees) + 1e-6
    return np.linspace(math.sqrt(max(low - known, 0.0)), min(math.sqrt(high), most), _OMEGAS)


def support(grid: FloatArray, likely: BoolArray) -> tuple[float, float]:
    """Return the range of the likely points of a grid, extended by one point on each side."""
    places = np.flatnonzero(likely)
    return float(grid[max(places[0] - 1, 0)]), float(grid[min(places[-1] + 1, grid.size - 1)])


def _over_mu(
    values: LogValues, units: list[UnitLikelihoods], tau: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a grid of mu for each tau, shape (tau, mu), and the log-posterior, shape (omega, tau, mu)."""
    reach = min(9 * values.scale, _DEEPEST) + 6 * tau
    ends = np.column_stack([values.middle - reach, values.middle + reach])
    for _ in range(_ROUNDS):
        mu = np.linspace(ends[:, 0], ends[:, 1], _MUS, axis=1)
        # Slow, and the same for every omega.
        weak = len(units[0].weak) > 0
        blurs = [blur(row, units[0].theta, t) for t, row in zip(tau.tolist(), mu, strict=True) if weak]
        height = np.array([of_omega.log_posterior(tau, mu, blurs) for of_omega in units])
        own = height - height.max(axis=(0, 2), keepdims=True)
        narrower = np.array(list(map(support, mu, np.any(own > -_NOTHING, axis=0))))
        if np.all(2 * np.diff(narrower) > np.diff(ends)):
            break
        ends = narrower
    return mu, height + np.log(mu[:, 1] - mu[:, 0])[:, None]
