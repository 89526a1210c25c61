"""Maximum of the likelihood -> estimates in SI, with their profile-likelihood limits and covariance.

At a limit, twice the drop of the log-likelihood, maximised over all other parameters, is the square of a
normal quantile, or of Student's quantile if few degrees of freedom determine a variance.

Source: Pawitan (2001), In All Likelihood, ch. 3; at a boundary: Self & Liang (1987), JASA 82; few degrees of
freedom: Satterthwaite (1946), Biometrics Bulletin 2, 110.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from imucal.arrays import FloatArray, IntArray
from imucal.fitting.homogeneity import symbol_of
from imucal.fitting.noise_fit import MISFIT, Estimate, Goodness, Interval
from imucal.fitting.spectral.likelihood import Fits, covariance
from imucal.fitting.spectral.maximum import bounds, maximize, misfit_factors
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, term_keys

#: Column number of the ramp, a regressor.
RAMP = -1

#: Accuracy of a limit, as a share of the reach.
_CLOSE = 0.01
_ROUNDS = 40
#: Factor by which steps grow until one passes the limit.
_STRIDE = 1.7
#: Lower limit of the degrees of freedom; the expansion underestimates them near zero.
_MIN_DOF = 10.0


def quantile(level: float) -> float:
    """Return the two-sided normal quantile of a confidence level."""
    return float(scipy.special.ndtri((1 + level) / 2))


def student_quantile(level: float, deviation: FloatArray) -> FloatArray:
    """Return Student's two-sided quantiles for variances whose logarithms have these standard errors.

    The standard error for n degrees of freedom is the root of 2/n.
    """
    freedom = np.maximum(2 / deviation**2, _MIN_DOF)
    return np.asarray(scipy.special.stdtrit(freedom, (1 + level) / 2), dtype=np.float64)


def profile_limits(
    ordinates: Ordinates, fits: Fits, columns: IntArray, *, reach: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper limits of parameter `columns[i]` of fit i, shape (k,) each.

    Limits are in log units, except for the ramp (column `RAMP`), and infinite if there is none. `reach` is
    the root of twice the drop at the limits.
    """
    both = np.concatenate([np.arange(columns.size)] * 2)
    toward = np.repeat([-1.0, 1.0], columns.size)
    limit = _ProfileSearch(ordinates, fits[both], columns[both]).run(toward, reach[both])
    return limit[: columns.size], limit[columns.size :]


class _ProfileSearch:
    """The root of z(u) = ± quantile for many parameters at once.

    z, the signed root of twice the drop, is almost linear in u: the deviation for a variance, the logarithm
    for a time, and the slope for a ramp.
    """

    def __init__(self, ordinates: Ordinates, fits: Fits, columns: IntArray) -> None:
        self.ordinates, self.columns = ordinates, columns
        self.models = models = fits.models
        self.theta, self.peak = fits.theta.copy(), fits.objective
        self.ramp = columns == RAMP
        self.variance = (columns >= 0) & (columns < models.variances)
        self.free = models.free.copy()
        plain = np.flatnonzero(~self.ramp)
        self.free[plain, columns[plain]] = False
        low, high = bounds(ordinates, models)
        self.low = np.where(self.ramp, -np.inf, self.to_u(low[columns]))
        self.high = np.where(self.ramp | self.variance, np.inf, high[columns])
        estimate = self.theta[np.arange(columns.size), columns]
        self.centre = np.where(self.ramp, fits.beta[:, 0], self.to_u(estimate))
        self.width = self._width(fits, low)

    def to_u(self, log: FloatArray) -> FloatArray:
        return np.where(self.variance, np.exp(0.5 * np.minimum(log, 600.0)), log)

    def _width(self, fits: Fits, low: FloatArray) -> FloatArray:
        width = np.sqrt(fits.beta_covariance[:, 0, 0])
        for i in np.flatnonzero(~self.ramp).tolist():
            column = int(self.columns[i])
            inverse = covariance(fits.information[i], self.models.free[i])
            deviation = float(np.sqrt(max(inverse[column, column], 1e-12)))
            if self.variance[i]:
                guess = 0.5 * deviation * float(self.centre[i])
                visible = float(np.exp(0.5 * (low[column] + 12.0)))
                width[i] = guess if deviation < 1 else max(min(guess, float(self.centre[i])), visible)
            else:
                width[i] = min(deviation, 1.0)
        return width

    def run(self, toward: FloatArray, z: FloatArray) -> FloatArray:
        """Return the limits in log units, ±inf if there is none."""
        size = toward.size
        inside, outside = self.centre.copy(), np.full(size, np.nan)
        z_inside, z_outside = -z, np.full(size, np.nan)
        limit = np.full(size, np.nan)
        step = z * self.width
        active = np.ones(size, dtype=bool)
        for _ in range(_ROUNDS):
            rows = np.flatnonzero(active)
            if not rows.size:
                break
            secant = inside - z_inside * (outside - inside) / (z_outside - z_inside)
            bracketed = np.isfinite(outside)
            u = np.where(bracketed, secant, inside + toward * step)[rows]
            u = np.clip(u, self.low[rows], self.high[rows])
            drop, theta = self.drop(rows, u)
            found = drop - z[rows]
            within = found < 0
            # Start only from inside: far outside may be another maximum.
            self.theta[rows[within]] = theta[within]
            edge = np.where(toward[rows] < 0, u <= self.low[rows], u >= self.high[rows])
            unlimited = within & edge
            ins, out = rows[within], rows[~within]
            # Illinois rule: halve the weight of the end that stays.
            z_outside[ins] *= 0.5
            z_inside[out] *= np.where(bracketed[out], 0.5, 1.0)
            inside[ins], z_inside[ins] = u[within], found[within]
            outside[out], z_outside[out] = u[~within], found[~within]
            step[ins] *= _STRIDE
            near = np.abs(found) < _CLOSE * z[rows]
            narrow = np.abs(outside[rows] - inside[rows]) < 1e-4 * np.abs(inside[rows])
            limit[rows] = np.where(unlimited, toward[rows] * np.inf, self.from_u(rows, u))
            active[rows[unlimited | near | narrow]] = False
        return limit

    def from_u(self, rows: IntArray, u: FloatArray) -> FloatArray:
        return np.where(self.variance[rows], 2 * np.log(np.maximum(u, 1e-200)), u)

    def drop(self, rows: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the root of twice the drop at fixed `u`, and the parameters there."""
        start = self.theta[rows].copy()
        plain = ~self.ramp[rows]
        held = np.flatnonzero(plain)
        start[held, self.columns[rows][held]] = self.from_u(rows, u)[held]
        found = maximize(
            self.ordinates,
            self.models[rows],
            start,
            free=self.free[rows],
            ramp=np.where(plain, np.nan, u),
            tolerance=1e-4,
            iterations=50,
        )
        drop = found.objective - self.peak[rows]
        root: FloatArray = np.sqrt(2 * np.maximum(drop, 0.0))
        return root, found.theta


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """The data, the confidence `level` of the limits, and the sampling period `tau0` in s.

    `widening` maps symbols to factors by which their intervals are wider than those of the likelihood.
    """

    ordinates: Ordinates
    level: float
    tau0: float
    widening: dict[str, float]

    def deviation(self, symbol: str) -> float:
        """Return the coefficient, in SI, of a unit deviation per sample."""
        return self.ordinates.scale / TERMS[symbol].per_sample(self.tau0)

    def limits(self, fitted: Fits, columns: list[int]) -> tuple[FloatArray, FloatArray]:
        places = np.array(columns)
        reach = np.full(places.size, quantile(self.level))
        variances = (places >= 0) & (places < fitted.models.variances)
        deviation = np.sqrt(np.diag(fitted.covariance)[places[variances]])
        reach[variances] = student_quantile(self.level, deviation)
        return profile_limits(self.ordinates, fitted[[0] * places.size], places, reach=reach)


def estimate(problem: Problem, fitted: Fits) -> tuple[Estimate, ...]:
    """Return an estimate of each term of a fit, or its bound if its interval contains 0."""
    columns = fitted.columns()
    if "R" in fitted.structure:
        columns.append(("R", RAMP))
    lows, highs = problem.limits(fitted, [column for _, column in columns])
    found = fitted
    values = [found.beta[0, 0] if name == "R" else found.theta[0, column] for name, column in columns]
    table = {
        name: (float(value), float(low), float(high))
        for (name, _), value, low, high in zip(columns, values, lows, highs, strict=True)
    }
    keys = term_keys(fitted.structure)
    return tuple(_term(problem, key, s, table) for key, s in zip(keys, fitted.structure, strict=True))


def _term(problem: Problem, key: str, symbol: str, table: dict[str, tuple[float, float, float]]) -> Estimate:
    unit = problem.deviation(symbol)
    if symbol == "R":
        value, low, high = (unit * x for x in table[key])
        if low <= 0 <= high:
            return Estimate.bounded(key, symbol, max(-low, high))
        low, high = sorted((abs(low), abs(high)))
        return Estimate(key=key, symbol=symbol, status="estimated", value=abs(value), low=low, high=high)
    value, low, high = table[TERMS[symbol].parameter_names(key)[0]]
    widening = problem.widening.get(symbol, 1.0)
    high = value + widening * (high - value)
    if np.isneginf(low):
        return Estimate.bounded(key, symbol, float(unit * np.exp(high / 2)))
    low = value - widening * (value - low)
    value, low, high = (float(unit * np.exp(x / 2)) for x in (value, low, high))
    found = Estimate(key=key, symbol=symbol, status="estimated", value=value, low=low, high=high)
    if f"{key}.T" not in table:
        return found
    value, low, high = (problem.tau0 * float(np.exp(x)) for x in table[f"{key}.T"])
    return replace(found, correlation_time=Interval(value=value, low=low, high=high))


def covariance_of(
    problem: Problem, fitted: Fits, estimates: tuple[Estimate, ...]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the parameters and their covariance in SI."""
    slopes = {name: own for e in estimates if e.value is not None for name, own in e.slopes().items()}
    columns = {name: at for name, at in fitted.columns() if name in slopes}
    names, places = list(columns), list(columns.values())
    slope = np.array([slopes[name] * problem.widening.get(name, 1.0) for name in names])
    matrix = fitted.covariance[np.ix_(places, places)] * np.outer(slope, slope)
    if "R" in slopes:
        names.append("R")
        variance = float(fitted.beta_covariance[0, 0, 0]) * problem.deviation("R") ** 2
        matrix = np.pad(matrix, (0, 1))
        matrix[-1, -1] = variance
    return tuple(names), matrix


def misfits_of(problem: Problem, fitted: Fits, found: Goodness) -> dict[str, float]:
    """Return the factors by which a misfit widens each symbol's interval; {} for no misfit."""
    if found.statistic < MISFIT:
        return {}
    factors = misfit_factors(problem.ordinates, fitted)
    largest: dict[str, float] = {}
    for key, column in fitted.variances(fitted.missing).items():
        symbol = symbol_of(key)
        largest[symbol] = max(largest.get(symbol, 1.0), float(factors[column]))
    return largest


def model_of(problem: Problem, fitted: Fits, estimates: tuple[Estimate, ...]) -> NoiseModel:
    """Return the model of the estimated terms; its ramp has a sign, the ramp's estimate has none."""
    ramp = float(fitted.beta[0, 0]) * problem.deviation("R")
    return NoiseModel(
        terms=tuple(
            found.term(ramp if found.symbol == "R" else found.value)
            for found in estimates
            if found.value is not None
        )
    )
