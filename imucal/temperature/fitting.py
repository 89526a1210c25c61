"""Blocks of a ramp -> curve, by least squares; the error in parts of the log that a fit has not seen."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.settings import CRITERIA
from imucal.temperature.curve import KINDS, Curve, Kind
from imucal.temperature.ramp import AxisBlocks, Ramp
from imucal.temperature.slow_noise import BlockNoise

#: Largest order of a polynomial: higher ones follow the noise of a ramp.
MAX_ORDER = 5
#: Number of lags that are tried; neighbours differ by a factor of about 1.15.
_LAGS = 24
#: The longest lag as a share of the log: a slower one is a drift.
_LONGEST_LAG = 1 / 16
#: Price of a parameter in the criterion of a noise fit, for a log with a single branch.
_PRICE = CRITERIA["chance"](0.0)
#: A lower order is chosen if its error is larger by at most this factor.
_ABOUT_EQUAL = 1.05
#: A lag must divide the error by this factor: in a random walk, the best of many lags divides it by 1.4 in a
#: sixth of the logs, and by 1.6 in one of twenty.
_CLEARLY = 1.6
#: Curves whose error is larger by at most this factor predict about as well.
_NEAR = 1.25
#: Most folds: more cycles are left out together.
_FOLDS = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class Lags:
    """Lags that are tried, in s, and the temperature behind each, shape (l, b), in degrees Celsius."""

    seconds: FloatArray
    temperature: FloatArray

    @classmethod
    def of(cls, ramp: Ramp) -> "Lags":
        seconds = np.geomspace(ramp.block_s / 2, _LONGEST_LAG * ramp.edges_s[-1], _LAGS)
        return cls(seconds=seconds, temperature=np.array([ramp.lagging(lag) for lag in seconds.tolist()]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """What a curve follows in m blocks, shape (m,), in degrees Celsius, and its range.

    `difference`, shape (m,), is the temperature behind the lag minus the present one. `middle` and `half` are
    those of the range of the whole ramp, so that curves of all designs have the same reference.
    """

    kind: Kind
    lag_s: float
    followed: FloatArray
    difference: FloatArray
    middle: float
    half: float

    @property
    def low_c(self) -> float:
        return float(self.followed.min())

    @property
    def high_c(self) -> float:
        return float(self.followed.max())

    @property
    def first(self) -> int:
        """Number of columns before the first power of the temperature."""
        return 2 if self.kind == "gradient" else 1

    def columns(self, order: int) -> FloatArray:
        """Return the regressors, shape (m, r): 1, the gradient, powers of (x - middle) / half."""
        powers = np.vander((self.followed - self.middle) / self.half, order + 1, increasing=True)[:, 1:]
        extra = [self.difference] if self.kind == "gradient" else []
        return np.column_stack([np.ones(self.followed.size), *extra, powers])

    def least_squares(self, order: int, means: FloatArray) -> Curve:
        """Return the curve of an order through the means of the blocks, without its uncertainty."""
        solution = np.asarray(np.linalg.lstsq(self.columns(order), means)[0], np.float64)
        return self.curve(solution, np.zeros((solution.size, solution.size)))

    def curve(self, solution: FloatArray, covariance: FloatArray) -> Curve:
        """Return the curve of coefficients of `columns`, shape (r,), with their covariance (r, r)."""
        first = self.first
        # From powers of (x - middle) / half to powers of x - middle.
        scales = self.half ** -np.arange(1.0, solution.size - first + 1)
        return Curve(
            kind=self.kind,
            reference_c=self.middle,
            low_c=self.low_c,
            high_c=self.high_c,
            coefficients=np.concatenate([solution[:1], solution[first:] * scales]),
            covariance=covariance[first:, first:] * np.outer(scales, scales),
            lag_s=self.lag_s,
            gradient=float(solution[1]) if self.kind == "gradient" else 0.0,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A curve, and what it leaves of the blocks: `rest`, shape (m,), in U.

    `variances`, shape (3,), are those of white, flicker and walk noise of the blocks. `held_out` is the rms
    error in U, without white noise, in parts that the curve was not fitted to; None if there are none.
    """

    curve: Curve
    rest: FloatArray
    variances: FloatArray
    held_out: float | None


def fit_axis(ramp: Ramp, lags: Lags, axis: AxisBlocks) -> Fit:
    """Return the simplest curve that predicts parts of the log nearly as well as any.

    Each half of a branch is left out in turn: the others have both directions and nearly all temperatures.
    The fit to the others finds its lag itself. A log with one branch shows no lag; its order is the largest
    whose last coefficient is shown, by the price of a parameter of a noise fit.

    All blocks have the same weight, and the intervals are those under the noise behind the curve. Weights by
    the noise are not better: what a curve leaves is mostly hysteresis, whose spectrum is that of a random
    walk, and weights against a walk fit the differences of blocks. The covariance also contains the spread of
    the curves that predict about as well.

    Source: Buckland, Burnham & Augustin (1997), Biometrics 53, "Model selection: an integral part of
    inference" (spread of models).
    """
    noise = BlockNoise.of(axis, ramp.block_s)
    if ramp.heats.size < 2:
        return _shown_order(_present(ramp, axis), axis, noise)
    errors = {
        (kind, order): error
        for kind in KINDS
        for order, error in enumerate(held_out(ramp, lags, axis, kind).tolist())
    }
    best = [_lowest_order(errors, kind) for kind in KINDS]
    chosen = min(best, key=lambda one: errors[one] * (1.0 if one[0] == "present" else _CLEARLY))
    designs = {kind: _designs(ramp, lags, axis, kind) for kind in KINDS}
    kind, order = chosen
    found = _fit(designs[kind][order], order, axis, noise, errors[chosen])
    near = [choice for choice, error in errors.items() if error <= _NEAR * errors[chosen]]
    others = [designs[kind][order].least_squares(order, axis.means).coefficients for kind, order in near]
    return replace(found, curve=found.curve.with_spread(others))


def _lowest_order(errors: Mapping[tuple[Kind, int], float], kind: Kind) -> tuple[Kind, int]:
    """Return the kind with the lowest order whose error is about the least."""
    least = min(error for (one, _), error in errors.items() if one == kind)
    return min(
        choice for choice, error in errors.items() if choice[0] == kind and error <= _ABOUT_EQUAL * least
    )


def cubic_of(ramp: Ramp, axis: AxisBlocks, order: int) -> Curve:
    """Return the polynomial of the present temperature by least squares, for programs that know no lag."""
    return _fit(_present(ramp, axis), order, axis, BlockNoise.of(axis, ramp.block_s), None).curve


def _present(ramp: Ramp, axis: AxisBlocks) -> Design:
    present = ramp.temperature[axis.places]
    return Design(
        kind="present",
        lag_s=0.0,
        followed=present,
        difference=np.zeros(present.size),
        middle=ramp.middle_c,
        half=ramp.half_k,
    )


def _behind(ramp: Ramp, axis: AxisBlocks, kind: Kind, lag_s: float, lagging: FloatArray) -> Design:
    """Return the design of a lag; `lagging`, shape (b,), is the temperature behind it in all blocks."""
    present, behind = ramp.temperature[axis.places], lagging[axis.places]
    return Design(
        kind=kind,
        lag_s=lag_s,
        followed=behind if kind == "lagged" else present,
        difference=behind - present,
        middle=ramp.middle_c,
        half=ramp.half_k,
    )


def _designs(ramp: Ramp, lags: Lags, axis: AxisBlocks, kind: Kind) -> list[Design]:
    """Return the design of each order, 0 to `MAX_ORDER`, with the lag that explains most."""
    if kind == "present":
        return [_present(ramp, axis)] * (MAX_ORDER + 1)
    tried = [
        _behind(ramp, axis, kind, lag_s, lagging)
        for lag_s, lagging in zip(lags.seconds.tolist(), lags.temperature, strict=True)
    ]
    # The columns of an order are the first ones of a higher order, so one basis serves all orders.
    bases = np.linalg.qr(np.array([design.columns(MAX_ORDER) for design in tried]))[0]
    explained = np.cumsum((axis.means @ bases) ** 2, axis=1)[:, tried[0].first - 1 :]
    return [_refined(ramp, lags, axis, tried, squares) for squares in explained.T]


def _refined(ramp: Ramp, lags: Lags, axis: AxisBlocks, tried: list[Design], explained: FloatArray) -> Design:
    """Return the design of the lag that explains most, from what those of `tried` explain, shape (l,)."""
    best = int(np.argmax(explained))
    if not 0 < best < len(tried) - 1:
        return tried[best]
    # The top of a parabola through the best lag and its neighbours, in log of the lag.
    before, top, after = explained[best - 1 : best + 2].tolist()
    bend = before - 2 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    ratio = lags.seconds[best + 1] / lags.seconds[best]
    lag_s = float(lags.seconds[best] * ratio**shift)
    return _behind(ramp, axis, tried[best].kind, lag_s, ramp.lagging(lag_s))


def held_out(ramp: Ramp, lags: Lags, axis: AxisBlocks, kind: Kind) -> FloatArray:
    """Return the rms error of each order, 0 to `MAX_ORDER`, in parts that the curve was not fitted to.

    It is in U and without white noise.
    """
    squares = np.zeros(MAX_ORDER + 1)
    for fold in _folds(ramp, axis):
        seen, tested = axis.take(~fold), axis.take(fold)
        white = axis.white_variance / tested.counts
        for order, design in enumerate(_designs(ramp, lags, seen, kind)):
            curve = design.least_squares(order, seen.means)
            rest = tested.means - curve_on(curve, ramp, tested.places)
            squares[order] += float(np.sum(rest**2 - white))
    least = axis.white_variance / axis.counts.sum()
    return np.asarray(np.sqrt(np.maximum(squares / axis.means.size, least)))


def curve_on(curve: Curve, ramp: Ramp, places: IntArray) -> FloatArray:
    """Return the bias of a curve in blocks, shape (m,)."""
    return curve.bias(ramp.temperature[places], ramp.lagging(curve.lag_s)[places])


def _folds(ramp: Ramp, axis: AxisBlocks) -> Iterator[BoolArray]:
    """Yield which blocks to leave out, shape (m,): the halves of the branches by temperature."""
    halves = np.zeros(ramp.blocks, dtype=np.int64)
    for branch in range(ramp.heats.size):
        own = ramp.branch == branch
        ends = ramp.temperature[own]
        warm = ramp.temperature > (ends.min() + ends.max()) / 2
        halves[own] = 2 * branch + warm[own]
    fold = halves[axis.places] % _FOLDS
    for number in np.unique(fold):
        yield fold == number


def _shown_order(design: Design, axis: AxisBlocks, noise: BlockNoise) -> Fit:
    """Return the curve of the largest order whose last coefficient is shown."""
    for order in range(MAX_ORDER, 0, -1):
        found = _fit(design, order, axis, noise, None)
        if found.curve.coefficients[-1] ** 2 > _PRICE * found.curve.covariance[-1, -1]:
            return found
    return _fit(design, 0, axis, noise, None)


def _fit(design: Design, order: int, axis: AxisBlocks, noise: BlockNoise, error: float | None) -> Fit:
    """Return the curve of least squares, with the covariance of its coefficients under the noise."""
    columns = design.columns(order)
    # The coefficients are linear in the samples.
    linear = np.linalg.pinv(columns)
    solution = linear @ axis.means
    variances = noise.variances(axis.means, columns)
    return Fit(
        curve=design.curve(solution, linear @ noise.covariance(variances) @ linear.T),
        rest=axis.means - columns @ solution,
        variances=variances,
        held_out=error,
    )
