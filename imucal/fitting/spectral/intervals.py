"""Profile-likelihood limits of each parameter, also where zero is a possible value.

A limit is where twice the drop of the log-likelihood, maximised over all other parameters, reaches
the square of a quantile: the normal one, which makes it that of chi-squared, or Student's where few
degrees of freedom tell a variance. An interval that holds zero is [0, U].

Source: Pawitan (2001), In All Likelihood, ch. 3; at a boundary: Self & Liang (1987), JASA 82; few degrees
of freedom: Satterthwaite (1946), Biometrics Bulletin 2, 110.
"""

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates
from imucal.fitting.spectral.scoring import Maximum, bounds, covariance, maximize

#: Column of the ramp, which is a regressor and not a parameter of the spectrum.
RAMP = -1

#: A limit is found to this part of a standard error.
_CLOSE = 0.01
_ROUNDS = 40
#: A step that ends inside the limit is followed by one that is longer by this factor.
_STRIDE = 1.7
#: Fewest degrees of freedom that tell a variance: less is said of one near zero, whose logarithm the
#: expansion about the maximum makes too unsure.
_FEWEST = 10.0


def quantile(level: float) -> float:
    """Return the two-sided normal quantile z of a confidence level; z² is that of chi-squared."""
    from scipy.special import ndtri

    return float(ndtri((1 + level) / 2))


def student_quantile(level: float, deviation: FloatArray) -> FloatArray:
    """Return Student's two-sided quantiles for variances whose logarithms have these standard errors.

    That of a variance told by n degrees of freedom is the root of 2/n.
    """
    from scipy.special import stdtrit

    freedom = np.maximum(2 / deviation**2, _FEWEST)
    return np.asarray(stdtrit(freedom, (1 + level) / 2), dtype=np.float64)


def profile_limits(
    ordinates: Ordinates,
    candidates: Candidates,
    maximum: Maximum,
    columns: IntArray,
    *,
    reach: FloatArray,
    shortest: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper limits of parameter `columns[i]` of candidate i, shape (k,) each.

    In log units; of a ramp, in its own. The lower is -inf where the parameter may vanish, the upper
    inf where it may grow past its bound.

    Parameters
    ----------
    candidates, maximum
        One row for each parameter that is profiled; a model stands once for each of them.
    columns
        Place of the parameter in the row, or `RAMP`.
    reach
        Root of twice the drop at the limits of each, shape (k,): a quantile of its level.
    """
    both = np.concatenate([np.arange(columns.size)] * 2)
    toward = np.repeat([-1.0, 1.0], columns.size)
    search = _ProfileSearch(
        ordinates, candidates.take(both), maximum, both, columns=columns[both], shortest=shortest
    )
    limit = search.run(toward, reach[both])
    return limit[: columns.size], limit[columns.size :]


class _ProfileSearch:
    """The root of z(u) = ± quantile for many parameters at once.

    z is the signed root of twice the drop; it is almost linear in u, which is the deviation for a
    variance, the logarithm for a time, and the slope itself for a ramp.
    """

    def __init__(
        self,
        ordinates: Ordinates,
        candidates: Candidates,
        maximum: Maximum,
        rows: IntArray,
        *,
        columns: IntArray,
        shortest: float,
    ) -> None:
        self.ordinates, self.candidates, self.shortest = ordinates, candidates, shortest
        self.columns = columns
        self.theta = maximum.theta[rows].copy()
        self.peak = maximum.objective[rows]
        self.ramp = columns == RAMP
        room = candidates.room_markov
        self.variance = (columns >= 0) & (columns < MARKOV + room)
        self.free = candidates.free.copy()
        plain = np.flatnonzero(~self.ramp)
        self.free[plain, columns[plain]] = False
        low, high = bounds(ordinates, candidates, shortest=shortest)
        self.low = np.where(self.ramp, -np.inf, self.to_u(low[columns]))
        self.high = np.where(self.ramp | self.variance, np.inf, high[columns])
        estimate = self.theta[np.arange(rows.size), columns]
        self.centre = np.where(self.ramp, maximum.beta[rows, 0], self.to_u(estimate))
        self.width = self._width(maximum, rows, low)

    def to_u(self, log: FloatArray) -> FloatArray:
        return np.where(self.variance, np.exp(0.5 * np.minimum(log, 600.0)), log)

    def _width(self, maximum: Maximum, rows: IntArray, low: FloatArray) -> FloatArray:
        """Return a first guess of the standard error of u."""
        width = np.empty(rows.size)
        for i, row in enumerate(rows.tolist()):
            if self.ramp[i]:
                width[i] = float(np.sqrt(maximum.beta_covariance[row, 0, 0]))
                continue
            column = int(self.columns[i])
            inverse = covariance(maximum.information[row], self.candidates.free[i])
            deviation = float(np.sqrt(max(inverse[column, column], 1e-12)))
            if self.variance[i]:
                told = 0.5 * deviation * float(self.centre[i])
                visible = float(np.exp(0.5 * (low[column] + 12.0)))
                width[i] = told if deviation < 1 else max(min(told, float(self.centre[i])), visible)
            else:
                width[i] = min(deviation, 1.0)
        return width

    def run(self, toward: FloatArray, z: FloatArray) -> FloatArray:
        """Return the limits in log units, ±inf where there is none."""
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
            # From inside only: far outside the other parameters may have gone to another maximum.
            self.theta[rows[within]] = theta[within]
            edge = np.where(toward[rows] < 0, u <= self.low[rows], u >= self.high[rows])
            unlimited = within & edge
            ins, out = rows[within], rows[~within]
            # Illinois: the end that stays gets half the weight, so that neither end stalls.
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
        """Return the root of twice the drop of the log-likelihood with `u` held, and where that is."""
        start = self.theta[rows].copy()
        plain = ~self.ramp[rows]
        held = np.flatnonzero(plain)
        start[held, self.columns[rows][held]] = self.from_u(rows, u)[held]
        found = maximize(
            self.ordinates,
            self.candidates.take(rows),
            start,
            free=self.free[rows],
            ramp=np.where(plain, np.nan, u),
            shortest=self.shortest,
            tolerance=1e-4,
            iterations=50,
        )
        drop = found.objective - self.peak[rows]
        root: FloatArray = np.sqrt(2 * np.maximum(drop, 0.0))
        return root, found.theta
