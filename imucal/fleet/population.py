"""The population that a fleet's units are drawn from: the coefficient of a sensor model, not of one unit.

On the logarithm of a coefficient, each log of unit u has ``mu + tau b_u + omega c_ul`` with b and c standard
normal, known through its own likelihood. mu is flat, tau has Jeffreys' prior, omega is on a short grid; the
posterior is summed on a grid of all three. Where every unit is measured exactly, the tolerance bound is
the noncentral-t factor.

Hardy & Thompson (1996), Statistics in Medicine 15, p. 619, give the likelihood of random effects; Tiao & Tan
(1965), Biometrika 52, p. 37, the prior for a one-way layout; Krishnamoorthy & Mathew (2009), Statistical
Tolerance Regions, chapters 2 and 5, the bound.

The likelihood of each unit's coefficient, its logs together, for one scatter between logs of a unit.

Logs of a unit scatter by omega about it, in the logarithm: temperature, mounting and the day are never the
same. A unit whose logs are all well told is a normal law; any other stands on a grid, to which a bound is
as welcome as an estimate.

The posterior of a fleet's median, spread between units and scatter within them, on a grid.

Where the units are well told mu is flat and tau has Jeffreys' prior. Where they are only bounded, flat would
be an answer: the likelihood does not fall towards zero, nor for a wide spread about a small median. There
the square of the median is flat instead, as a measured variance asks for, and tau is as likely as units of
one model are alike. omega is on a short grid. Each tau has a grid of mu of its own, and both are narrowed
until they fit the support.

Odd units of a fleet: leave-one-out residuals, with Benjamini and Hochberg's false discovery rate.

A unit is compared with what the others are like, so that it can't hide by widening the spread that it is
judged by. Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57, p. 289.

Is a new unit one of a fleet's? Its coefficient against where the next unit lies.

How far values differ beyond their errors.

Source: DerSimonian & Laird (1986), Controlled Clinical Trials 7, p. 177.

A coefficient that the logs of a whole fleet only bound, and how large it can be.

The mean of the units' squared coefficients is measured without bias, whatever the spread between them. It
bounds the median unit's square, and through it each share of the units: of all lognormal laws with root mean
square r, exp(m + t²) = r, a share p lies below exp(m + z t), which is r exp(z t - t²) ≤ r exp(z² / 4) for
the quantile z of p. So the bound needs no spread, which such logs do not tell.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet.values import LogValue, LogValues, Squares

#: Grid points of the weakly told units.
_POINTS = 301
#: How far below the median the grid reaches, in the logarithm: a coefficient 50 times smaller shows nowhere.
_DOWN = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitLikelihoods:
    """Likelihoods of the units' coefficients.

    Attributes
    ----------
    omega
        The scatter between logs of a unit.
    about
        Where the deviations of weak units hold, in the logarithm.
    normal
        Which units are a normal law, shape (units,).
    centre, deviation
        Of the normal law; of the others the same from curvature, for weights only.
    constant
        Logarithm of what the normal law leaves out: the scatter of logs about their units.
    theta
        Grid of logarithms of the coefficient for the others, shape (points,).
    weak
        Their log-likelihoods on it, shape (weak units, points).
    """

    omega: float
    about: float
    normal: BoolArray
    centre: FloatArray
    deviation: FloatArray
    constant: float
    theta: FloatArray
    weak: FloatArray


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fleet lies: the median's logarithm, and a scale of the spread about it."""

    centre: float
    scale: float


def place_of(logs: LogValues) -> Place:
    """Return a robust first guess of where the units lie."""
    centre = float(np.median(logs.centre))
    mad = 1.4826 * float(np.median(np.abs(logs.centre - centre)))
    return Place(centre, max(mad, float(np.std(logs.centre)) / 2, 0.02))


def unit_likelihoods(logs: LogValues, omega: float, place: Place) -> UnitLikelihoods:
    """Return the likelihood of each unit, where logs of one unit scatter by `omega`."""
    n = len(logs.names)
    normal = np.bincount(logs.unit, ~logs.narrow, minlength=n) == 0
    weights = 1 / (logs.log_deviation(place.centre) ** 2 + omega**2)
    total = np.bincount(logs.unit, weights, minlength=n)
    centre = np.bincount(logs.unit, weights * logs.centre, minlength=n) / np.maximum(total, 1e-300)
    own = normal[logs.unit]
    constant = 0.5 * float(
        np.sum(np.log(weights[own]) - weights[own] * (logs.centre - centre[logs.unit])[own] ** 2)
        - np.sum(np.log(total[normal]))
    )
    theta = _grid(place)
    return UnitLikelihoods(
        omega=omega,
        about=place.centre,
        normal=normal,
        centre=centre,
        deviation=1 / np.sqrt(np.maximum(total, 1e-300)),
        constant=constant,
        theta=theta,
        weak=_weak(logs, ~normal, theta, omega),
    )


def blur(theta_to: FloatArray, theta: FloatArray, width: float) -> FloatArray:
    """Return the matrix that takes the mean of a function on `theta` over a normal law about `theta_to`.

    Beyond the ends of the grid the function is what it is there.
    """
    from scipy.special import ndtr

    step = float(theta[1] - theta[0])
    wide = max(width, step / 2)
    kernel = np.exp(-0.5 * ((theta_to[:, None] - theta) / wide) ** 2)
    cell = math.sqrt(2 * math.pi) * wide / step
    kernel[:, 0] = cell * ndtr((theta[0] + step / 2 - theta_to) / wide)
    kernel[:, -1] = cell * ndtr((theta_to - theta[-1] + step / 2) / wide)
    result: FloatArray = kernel / kernel.sum(axis=1, keepdims=True)
    return result


def weighted_quantiles(values: FloatArray, weights: FloatArray, at: Sequence[float]) -> FloatArray:
    """Return quantiles of weighted values."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    result: FloatArray = np.interp(np.asarray(at) * total[-1], total - weights[order] / 2, values[order])
    return result


def _grid(place: Place) -> FloatArray:
    reach = min(9 * place.scale, _DOWN)
    return np.linspace(place.centre - _DOWN - reach, place.centre + reach + 3 * place.scale, _POINTS)


def _weak(logs: LogValues, units: BoolArray, theta: FloatArray, omega: float) -> FloatArray:
    """Return the log-likelihoods of the units that are no normal law, their logs multiplied."""
    which = units[logs.unit]
    each = logs.log_likelihood(which, theta)
    if omega > 0 and each.size:
        top = each.max(axis=1, keepdims=True)
        each = np.log(np.exp(each - top) @ blur(theta, theta, omega).T + math.exp(-690)) + top
    result = np.zeros((int(np.count_nonzero(units)), theta.size))
    row = np.cumsum(units) - 1
    np.add.at(result, row[logs.unit[which]], each)
    return result


#: Grid points of mu, of tau and of omega; the grid is narrowed so many times at most.
_MUS, _TAUS, _OMEGAS, _ROUNDS = 61, 48, 12, 6
#: A scatter within a unit that the logs show so rarely is not considered.
_RARE = 1e-3
#: Median farthest from the first guess, in the logarithm.
_DEEPEST = 4.0
#: Points of the predictive law that a weak unit is judged by.
_DRAWS = 4000
#: Its multiples fill the unit interval evenly, in an order that has nothing to do with theirs.
_GOLDEN = (math.sqrt(5) - 1) / 2
#: Keeps the logarithm of a probability that underflows finite.
_TINY = math.exp(-690)
_LARGEST = 600.0
#: Spread of units of one model, in the logarithm, where the data do not tell it; also between logs of a unit.
_USUAL = 0.5
#: Largest spread between units that is thought of, in the logarithm.
_WIDEST = 2.0
#: What lies so far below the posterior's peak, in the logarithm, weighs nothing.
_NOTHING = 16.0
#: A scatter that is less probable than this, against the most probable, is left out at second sight.
_LITTLE = 1e-4
#: Units whose terms are added at a time.
_CHUNK = 2048


@dataclass(frozen=True, slots=True)
class Posterior:
    """Weights on a grid of omega, tau and mu, broadcast against each other; they add up to one."""

    omega: FloatArray
    tau: FloatArray
    mu: FloatArray
    weight: FloatArray

    def quantiles(self, values: FloatArray, at: Sequence[float]) -> FloatArray:
        """Return quantiles of a function of the grid."""
        every = np.broadcast_to(values, self.weight.shape)
        keep = self.weight > math.exp(-_NOTHING) * self.weight.max()
        return weighted_quantiles(every[keep], self.weight[keep], at)

    def reaches(self, content: float, at: Sequence[float]) -> FloatArray:
        """Return quantiles of the logarithm that a share `content` of all units stays below."""
        from scipy.special import ndtri

        return self.quantiles(self.mu + float(ndtri(content)) * self.tau, at)

    def prediction(self, at: Sequence[float] | FloatArray) -> FloatArray:
        """Return quantiles of the logarithm of a unit that was not seen."""
        from scipy.special import ndtr

        weight = self.weight.sum(axis=0)
        keep = weight > math.exp(-_NOTHING) * weight.max()
        mu, tau = (np.broadcast_to(x, self.weight.shape)[0][keep] for x in (self.mu, self.tau))
        reach = 6 * float(tau.max())
        grid = np.linspace(float(mu.min()) - reach, float(mu.max()) + reach, 801)
        below = ndtr((grid[:, None] - mu) / tau) @ weight[keep] / weight[keep].sum()
        return np.interp(at, below, grid)

    def p_value(self, centre: FloatArray, variance: FloatArray) -> float:
        """Return the two-sided chance of a new unit's logarithm `centre`, known with a normal error.

        Both, shape (omega,), are what its logs make at each scatter within a unit.
        """
        from scipy.special import ndtr

        apart = centre[:, None, None] - self.mu
        above = float(np.sum(self.weight * ndtr(apart / np.sqrt(self.tau**2 + variance[:, None, None]))))
        return 2 * min(above, 1 - above)

    def p_values(self, units: Squares, scatter: FloatArray) -> FloatArray:
        """Return the two-sided chance of estimates of squared coefficients like these.

        `scatter`, shape (units,), is that of the mean of a unit's logs about the unit, in the logarithm.
        """
        from scipy.special import ndtri

        at = (np.arange(_DRAWS) + 0.5) / _DRAWS
        log, moved = self.prediction(at), ndtri((at * _DRAWS * _GOLDEN) % 1)
        square = np.exp(2 * (log + scatter[:, None] * moved))
        below = units.below(square).mean(axis=1)
        result: FloatArray = 2 * np.minimum(below, 1 - below)
        return result


def posterior_of(values: LogValues, omegas: FloatArray, place: Place) -> Posterior:
    """Return the posterior on a grid that is narrowed until it fits its support.

    Each tau has a grid of mu of its own: the less the spread, the better the median is known.
    """
    units = [unit_likelihoods(values, float(omega), place) for omega in omegas]
    taus = (math.log(0.01 * place.scale), math.log(max(_WIDEST, 2 * place.scale)))
    for _ in range(_ROUNDS):
        tau = np.exp(np.linspace(*taus, _TAUS))
        mu, height = _over_mu(units, tau, place)
        height -= height.max()
        narrower = _support(np.log(tau), np.any(height > -_NOTHING, axis=(0, 2)))
        if 2 * (narrower[1] - narrower[0]) > taus[1] - taus[0]:
            break
        taus = narrower
    weight = np.exp(height)
    return Posterior(omegas[:, None, None], tau[None, :, None], mu[None], weight / weight.sum())


def whole_posterior(values: LogValues, place: Place) -> Posterior:
    """Return the posterior over all scatters within a unit; of weak logs on a finer grid, at second sight."""
    found = posterior_of(values, scatters(values), place)
    if values.narrow.all() or len(found.omega) < 2:
        return found
    omega, weight = found.omega.ravel(), found.weight.sum(axis=(1, 2))
    low, high = _support(omega, weight > _LITTLE * weight.max())
    return posterior_of(values, np.linspace(low, high, _OMEGAS), place)


def _over_mu(units: list[UnitLikelihoods], tau: FloatArray, place: Place) -> tuple[FloatArray, FloatArray]:
    """Return for each tau the grid of mu that fits it, (tau, mu), and the posterior, (omega, tau, mu)."""
    reach = min(9 * place.scale, _DEEPEST) + 6 * tau
    ends = np.column_stack([place.centre - reach, place.centre + reach])
    for _ in range(_ROUNDS):
        mu = np.linspace(ends[:, 0], ends[:, 1], _MUS, axis=1)
        # The same for every omega, and what takes the time where units are weak.
        blurs = _blurs(units[0], tau, mu)
        height = np.array([_log_posterior(of_omega, tau, mu, blurs) for of_omega in units])
        own = height - height.max(axis=(0, 2), keepdims=True)
        narrower = np.array(list(map(_support, mu, np.any(own > -_NOTHING, axis=0))))
        if np.all(2 * np.diff(narrower) > np.diff(ends)):
            break
        ends = narrower
    return mu, height + np.log(mu[:, 1] - mu[:, 0])[:, None]


def _support(grid: FloatArray, likely: BoolArray) -> tuple[float, float]:
    """Return the range of the likely points and one more to each side."""
    places = np.flatnonzero(likely)
    return float(grid[max(places[0] - 1, 0)]), float(grid[min(places[-1] + 1, grid.size - 1)])


def _blurs(units: UnitLikelihoods, tau: FloatArray, mu: FloatArray) -> list[FloatArray]:
    """Return for each tau the matrix that takes a weak unit's likelihood to one of mu."""
    if not units.weak.size:
        return []
    return [blur(of_tau, units.theta, t) for t, of_tau in zip(tau.tolist(), mu, strict=True)]


def _log_posterior(
    units: UnitLikelihoods, tau: FloatArray, mu: FloatArray, blurs: Sequence[FloatArray]
) -> FloatArray:
    """Return the logarithm of the posterior, shape (tau, mu), for a flat measure in log tau."""
    t2 = tau[:, None] ** 2
    v = units.deviation[units.normal] ** 2 + t2
    y, offset = units.centre[units.normal] - mu[:, :1], mu - mu[:, :1]
    first, second = (np.sum(part, axis=1)[:, None] for part in (y / v, 1 / v))
    squares = np.sum(y * y / v, axis=1)[:, None] - 2 * offset * first + offset**2 * second
    result = units.constant - 0.5 * (squares + np.sum(np.log(v), axis=1)[:, None])
    if blurs:
        result += [_weak_part(units, matrix) for matrix in blurs]
    posterior: FloatArray = result + _prior(units, tau)[:, None] + _prior_of_median(units, mu)
    return posterior


def _prior(units: UnitLikelihoods, tau: FloatArray) -> FloatArray:
    """Return the logarithm of the prior of log tau and of the scatter within units: Jeffreys' where told."""
    t2 = tau**2
    variance = units.deviation**2
    told = 0.5 * np.log(np.sum(1 / (variance + t2[:, None]) ** 2, axis=1)) + np.log(t2)
    usual = np.log(tau) - 0.5 * (t2 + units.omega**2) / _USUAL**2
    untold = float(np.mean((variance / (variance + _USUAL**2)) ** 2))
    result: FloatArray = (1 - untold) * told + untold * usual
    return result


def _prior_of_median(units: UnitLikelihoods, mu: FloatArray) -> FloatArray:
    """Return the logarithm of Jeffreys' prior of mu at a usual spread: flat where told, else in exp(2 mu)."""
    if not units.weak.size:
        return np.zeros_like(mu)
    told = float(np.sum(1 / (units.deviation[units.normal] ** 2 + _USUAL**2)))
    # One deviation for all: a prior need not be more exact.
    weak = np.count_nonzero(~units.normal)
    precision = float(np.mean(units.deviation[~units.normal] ** -2.0))
    at = np.exp(np.minimum(-4 * (mu - units.about), _LARGEST)) / precision
    result: FloatArray = 0.5 * np.log((told + weak / (at + _USUAL**2)) / (told + weak / _USUAL**2))
    return result


def _weak_part(units: UnitLikelihoods, matrix: FloatArray) -> FloatArray:
    """Return what the units on the grid say of mu, at one tau."""
    total = np.zeros(matrix.shape[0])
    for start in range(0, len(units.weak), _CHUNK):
        some = units.weak[start : start + _CHUNK]
        top = some.max(axis=1, keepdims=True)
        total += np.log(matrix @ np.exp(some - top).T + _TINY).sum(axis=1) + top.sum()
    return total


def scatters(values: LogValues) -> FloatArray:
    """Return the scatters within a unit to consider, evenly spaced; only 0 where no unit has two logs."""
    from scipy.special import chdtri

    counts = np.bincount(values.unit)
    degrees = values.unit.size - counts.size
    if degrees == 0:
        return np.zeros(1)
    means = np.bincount(values.unit, values.centre) / counts
    squares = float(np.sum((values.centre - means[values.unit]) ** 2))
    if not values.narrow.all():
        return np.linspace(0.0, min(3 * math.sqrt(squares / degrees) + 0.3, _WIDEST), _OMEGAS)
    known = float(np.mean(values.deviation**2))
    low, high = (squares / float(chdtri(degrees, tail)) for tail in (_RARE, 1 - _RARE))
    most = 10 * math.sqrt(squares / degrees) + 1e-6
    return np.linspace(math.sqrt(max(low - known, 0.0)), min(math.sqrt(high), most), _OMEGAS)


#: Expected share of false ones among the units that are called odd.
FALSE_SHARE = 0.05
#: Fewer units leave no degrees of freedom to judge one by the others.
_OUTLIERS_FEWEST = 4


def leave_one_out(centre: FloatArray, deviation: FloatArray, tau: float) -> FloatArray:
    """Return two-sided p-values of the units, each against the mean and the spread of the others.

    Parameters
    ----------
    centre, deviation
        Logarithm of each unit's coefficient and its standard error, shape (units,).
    tau
        Standard deviation between units: it sets the units' weights, not the scale of the test.
    """
    from scipy.special import stdtr

    n = centre.size
    if n < _OUTLIERS_FEWEST:
        return np.ones(n)
    w = 1 / (deviation**2 + max(tau, 1e-12) ** 2)
    total = w.sum()
    rest = total - w
    mean = np.sum(w * centre) / total
    apart = (centre - mean) * total / rest
    # Squares about the mean of the others: those about the mean of all, less the unit's own share.
    squares = np.sum(w * (centre - mean) ** 2) - w * (centre - mean) * apart
    scale = np.sqrt(np.maximum(squares, 1e-300) / (n - 2) * (1 / w + 1 / rest))
    result: FloatArray = 2 * stdtr(n - 2, -np.abs(apart) / scale)
    return result


def adjusted(p: FloatArray) -> FloatArray:
    """Return p-values adjusted for the number of tests by Benjamini and Hochberg's step-up procedure."""
    order = np.argsort(p)
    stepped = p[order] * p.size / np.arange(1, p.size + 1)
    result = np.empty(p.size)
    result[order] = np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0)
    return result


#: Fewer units tell no spread.
FEWEST = 3


def membership(logs: Sequence[LogValue], new: LogValue) -> float:
    """Return the two-sided chance that a unit of this fleet gives a log like a new one.

    The spread between units, the scatter between logs of a unit and the error of the new log are all in it,
    and how badly the first two are known.

    Parameters
    ----------
    logs
        Of the fleet, of three units at least.
    new
        What the new log says.

    Raises
    ------
    ValueError
        If there are fewer than three units.
    """
    values = LogValues.of(logs)
    if len(values.names) < FEWEST:
        msg = f"a spread between units needs {FEWEST} units at least, got {len(values.names)}"
        raise ValueError(msg)
    posterior = whole_posterior(values, place_of(values))
    one = LogValues.of([new])
    if one.narrow.all():
        return posterior.p_value(*one.unit_centre(0, posterior.omega.ravel()))
    omega = float(posterior.quantiles(posterior.omega, [0.5])[0])
    return float(posterior.p_values(one.squares(), np.array([omega]))[0])


def variance_between(values: FloatArray, errors: FloatArray) -> float:
    """Return the variance of values, shape (n,), beyond their standard errors: by moments, 0 at least."""
    weight = errors**-2.0
    total = float(weight.sum())
    statistic = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
    return max(statistic - (values.size - 1), 0.0) / (total - float(np.square(weight).sum()) / total)


#: A mean square that is not so many deviations above zero, whichever unit is left out, is only bounded.
_SHOWN = 1.959963984540054
#: Points of the mean square's likelihood, up to where its logarithm is so far below the peak.
_BOUNDED_POINTS, _BOUNDED_NOTHING = 1001, -30.0
#: How often its reach is doubled at most.
_DOUBLINGS = 200
#: Units that are added at a time.
_BOUNDED_CHUNK = 1024


def only_bounded(values: LogValues) -> bool:
    """Return whether all logs together do not show the coefficient; one unit alone does not decide."""
    if np.isnan(np.where(np.isnan(values.variance), values.bound, values.variance)).any():
        return False
    # At zero, as the question is.
    units = values.squares().mean_by(values.unit, 0.0)
    square, weight = units.estimate, units.sd**-2.0
    others = (np.sum(weight * square) - weight * square) / np.sqrt(np.sum(weight) - weight)
    return bool(others.min() < _SHOWN)


def rms_bound(values: LogValues, confidence: float) -> float:
    """Return the value that the units' root mean square stays below with a probability `confidence`.

    Of one square for all units, or of the mean of squares that differ, whichever is larger; neither is below
    zero (flat prior).
    """
    units = values.squares().mean_by(values.unit, 0.0)
    return math.sqrt(max(_of_one(units, confidence), _of_different(units, confidence)))


def _of_one(units: Squares, confidence: float) -> float:
    """Return the bound of a square that is the same for all units, from its likelihood."""
    from scipy.integrate import cumulative_simpson

    reach = float(units.sd.min())
    for _ in range(_DOUBLINGS):
        square = np.linspace(0.0, reach, _BOUNDED_POINTS)
        height = _height(units, square)
        height -= height.max()
        if height[-1] < _BOUNDED_NOTHING:
            break
        reach *= 2
    total = cumulative_simpson(np.exp(height), x=square, initial=0.0)
    return float(np.interp(confidence, total / total[-1], square))


def _of_different(units: Squares, confidence: float) -> float:
    """Return the bound of the mean of squares that scatter by more than their errors say, else zero."""
    from scipy.special import ndtr, ndtri

    weight = units.sd**-2.0
    error = units.deviation(max(float(np.average(units.estimate, weights=weight)), 0.0))
    between = variance_between(units.estimate, error)
    if not between:
        return 0.0
    weight = 1 / (error**2 + between)
    mean = float(np.average(units.estimate, weights=weight))
    error_of_mean = 1 / math.sqrt(float(np.sum(weight)))
    beyond = (1 - confidence) * float(ndtr(mean / error_of_mean))
    bound: float = mean - error_of_mean * float(ndtri(beyond))
    return bound


def _height(units: Squares, square: FloatArray) -> FloatArray:
    """Return the log-likelihood of squares, all units together."""
    height = np.zeros(square.size)
    for first in range(0, units.sd.size, _BOUNDED_CHUNK):
        rows = np.arange(first, min(first + _BOUNDED_CHUNK, units.sd.size))
        height += units.take(rows).log_likelihood(square).sum(axis=0)
    return height


def share_bound(values: LogValues, content: float, confidence: float) -> float:
    """Return the value that a share `content` of all units stays below with a probability `confidence`."""
    from scipy.special import ndtri

    return rms_bound(values, confidence) * math.exp(max(float(ndtri(content)), 0.0) ** 2 / 4)


#: Fewer units have no spread that could be told.
_FEWEST = 3
#: Share of bounds above which they are worth a sentence.
_MOSTLY = 0.5
#: Units that are judged by the others alone: the oddest, up to a chance of being so odd at a quick look.
_SUSPECTS, _SUSPECT = 5, 0.2
#: Quantile of the normal law at 95 %, two-sided; and where the interval and the median lie.
_TWO_SIDED = 1.959963984540054
_TAILS = (0.025, 0.5, 0.975)
#: Probability with which the next unit lies in its limits.
_CONTENT = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitValue:
    """One unit of a fleet: its coefficient from all of its logs, None where they only bound it.

    `p_value` is the chance that one of the others is so far off, None where it was not tested; `p_odd` is
    adjusted for the number of units, and `odd` says that it does not belong to the others.
    """

    unit: str
    logs: int
    value: float | None
    low: float
    high: float
    p_value: float | None = None
    p_odd: float | None = None
    odd: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Population:
    """What a coefficient is like over the units of one sensor model.

    Attributes
    ----------
    units
        The units in the order of their first log.
    logs
        How many logs there are.
    median
        Coefficient of the median unit, with its 95 % interval. Where it is `bounded`, the interval begins at
        0, and value and high are its upper limit.
    bounded
        Whether the logs, all together, do not tell the median unit from one without this term. The spreads
        are then not known either.
    spread
        Standard deviation between units, in the logarithm (0.1: 10 %); None below three units.
    within
        Standard deviation between logs of one unit; None where no unit has two logs.
    prediction
        Limits that hold the next unit with probability 0.95; None below three units.
    quantile
        The coefficient that a share `content` of all units stays below: its median estimate.
    tolerance
        The value that bounds it with `confidence`: the number for the config of every unit.
    findings
        What should be known of these numbers.
    """

    units: tuple[UnitValue, ...]
    logs: int
    median: Interval
    spread: Interval | None
    within: Interval | None
    prediction: tuple[float, float] | None
    quantile: float | None
    tolerance: float | None
    content: float
    confidence: float
    findings: tuple[Finding, ...]
    bounded: bool = False


def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return what the units of a fleet are like.

    Parameters
    ----------
    logs
        What each log says of the coefficient, any number of logs a unit.
    content, confidence
        The tolerance bound holds a share `content` of all units with probability `confidence`.

    Raises
    ------
    ValueError
        If there is no log, or a probability is not between 0 and 1.
    """
    if not logs:
        msg = "a population needs at least one log"
        raise ValueError(msg)
    if not (0 < content < 1 and 0 < confidence < 1):
        msg = f"content and confidence must be between 0 and 1, got {content} and {confidence}"
        raise ValueError(msg)
    values = LogValues.of(logs)
    place = place_of(values)
    if len(values.names) < _FEWEST:
        return _too_few(values, place, content, confidence)
    posterior = whole_posterior(values, place)
    within = posterior.quantiles(posterior.omega, _TAILS) if len(posterior.omega) > 1 else None
    spread = posterior.quantiles(posterior.tau, _TAILS)
    scatter = 0.0 if within is None else float(within[1])
    units = _judged(values, unit_likelihoods(values, scatter, place), posterior, place)
    if only_bounded(values):
        return _bounded(values, units, content, confidence)
    quantile, tolerance = np.exp(posterior.reaches(content, (0.5, confidence)))
    low, high = np.exp(posterior.prediction(_TAILS[::2]))
    return Population(
        units=units,
        logs=len(logs),
        median=_interval(np.exp(posterior.quantiles(posterior.mu, _TAILS))),
        spread=_interval(spread),
        within=None if within is None else _interval(within),
        prediction=(float(low), float(high)),
        quantile=float(quantile),
        tolerance=float(tolerance),
        content=content,
        confidence=confidence,
        findings=_weakness(values),
    )


def _bounded(
    values: LogValues, units: tuple[UnitValue, ...], content: float, confidence: float
) -> Population:
    """Return how large a coefficient can be that all logs together do not show."""
    text = (
        "All logs together do not show this term: every number is an upper bound, and the spread between "
        "units is not known. Longer logs would say more than more units."
    )
    highest, median = share_bound(values, content, confidence), rms_bound(values, _TAILS[-1])
    return Population(
        units=units,
        logs=values.centre.size,
        median=Interval(value=median, low=0.0, high=median),
        bounded=True,
        spread=None,
        within=None,
        prediction=(0.0, share_bound(values, _CONTENT, _CONTENT)),
        quantile=min(share_bound(values, content, 0.5), highest),
        tolerance=highest,
        content=content,
        confidence=confidence,
        findings=(Finding(level="info", code="weak-term", text=text),),
    )


def _units(values: LogValues, units: UnitLikelihoods) -> tuple[UnitValue, ...]:
    """Return each unit by itself; those that only bound the coefficient have no value."""
    low, middle, high = (units.centre + side * _TWO_SIDED * units.deviation for side in (-1, 0, 1))
    told = units.normal.copy()
    theta = units.theta
    for unit, curve in zip(np.flatnonzero(~units.normal).tolist(), units.weak, strict=True):
        inside = theta[curve > curve.max() - _TWO_SIDED**2 / 2]
        middle[unit], low[unit], high[unit] = theta[curve.argmax()], inside[0], inside[-1]
        told[unit] = inside[0] > theta[0]
    logs = np.bincount(values.unit)
    return tuple(
        UnitValue(
            unit=name,
            logs=int(logs[i]),
            value=float(np.exp(middle[i])) if told[i] else None,
            low=float(np.exp(low[i])) if told[i] else 0.0,
            high=float(np.exp(high[i])),
        )
        for i, name in enumerate(values.names)
    )


def _judged(
    values: LogValues, units: UnitLikelihoods, posterior: Posterior, place: Place
) -> tuple[UnitValue, ...]:
    """Return each unit with the probability of being so odd by chance."""
    alone = _p_values(values, units, posterior, place)
    return tuple(
        replace(unit, p_value=own, p_odd=p, odd=p <= FALSE_SHARE)
        for unit, own, p in zip(_units(values, units), alone.tolist(), adjusted(alone).tolist(), strict=True)
    )


def _p_values(values: LogValues, units: UnitLikelihoods, posterior: Posterior, place: Place) -> FloatArray:
    """Return how probable each unit is: the oddest in the posterior of the others, to which they are new.

    That allows for how badly the spreads between and within units are known. A quick look finds who is to
    be judged so: Student's t of well told units, else the posterior of all. The rest can only pass.
    """
    told = bool(units.normal.all())
    squares = values.unit_squares(place.centre)
    scatter = posterior.quantiles(posterior.omega, [0.5])
    own = scatter / np.sqrt(np.bincount(values.unit))
    if told:
        tau = float(posterior.quantiles(posterior.tau, [0.5])[0])
        quick = leave_one_out(units.centre, units.deviation, tau)
    else:
        quick = posterior.p_values(squares, own)
    result = np.ones(quick.size)
    oddest = np.argsort(quick)[:_SUSPECTS]
    for unit in oddest[quick[oddest] < _SUSPECT].tolist():
        others = values.without(unit)
        if len(others.names) < _FEWEST:
            continue
        if told:
            alone = posterior_of(others, scatters(others), place)
            result[unit] = alone.p_value(*values.unit_centre(unit, alone.omega.ravel()))
        else:
            alone = posterior_of(others, scatter, place)
            result[unit] = alone.p_values(squares.take([unit]), own[[unit]])[0]
    return result


def _too_few(values: LogValues, place: Place, content: float, confidence: float) -> Population:
    """Return one or two units as they are: they tell nothing of a spread between units."""
    n = len(values.names)
    units = _units(values, unit_likelihoods(values, 0.0, place))
    told = [unit.value for unit in units if unit.value is not None]
    high = max(unit.high for unit in units)
    middle = math.exp(sum(map(math.log, told)) / len(told)) if told else high
    text = (
        f"{n} unit{'s' * (n > 1)}: the spread between units, the next unit and a tolerance bound need "
        f"{_FEWEST} at least; 10 are worth testing."
    )
    return Population(
        units=units,
        logs=values.centre.size,
        median=Interval(value=middle, low=min(u.low for u in units), high=high),
        bounded=not told,
        spread=None,
        within=None,
        prediction=None,
        quantile=None,
        tolerance=None,
        content=content,
        confidence=confidence,
        findings=(Finding(level="info", code="few-units", text=text),),
    )


def _weakness(values: LogValues) -> tuple[Finding, ...]:
    """Say where nearly all logs only bound the term: the median then leans on the bounds."""
    share = float(np.mean(~np.isnan(values.bound)))
    if share <= _MOSTLY:
        return ()
    text = (
        f"{100 * share:.0f} % of the logs only bound this term: longer logs would say more than more units."
    )
    return (Finding(level="info", code="weak-term", text=text),)


def _interval(limits: FloatArray) -> Interval:
    low, value, high = map(float, limits)
    return Interval(value=value, low=low, high=high)
