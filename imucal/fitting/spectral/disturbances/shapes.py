"""Search for disturbances at low frequencies: temperature, warm-up, steps and cycles.

A fit would mistake them for random walk or flicker. The search adds one shape at a time to the regressors of
a rich noise model: the one that gains most, if the gain exceeds its price and a margin.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar, cast

import numpy as np

from imucal.fitting.regressors import (
    Bump,
    LevelChange,
    Ramp,
    Regressor,
    Step,
    TemperatureEffect,
    WarmUp,
    Wave,
)
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.disturbances.whitened import Whitened
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.maximum import fit_blindly
from imucal.fitting.spectral.models import COLUMN, Structure, models_of
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates
from imucal.recording import AxisSeries

#: A rich model, so that a shape gains only what no noise explains.
_STRUCTURE = ("N", "B", "GM", "K", "R")
#: Number of the lowest ordinates, which contain slow shapes.
_LOWEST = 4000
#: Time constants of a warm-up, as parts of the record.
_WARM_UPS = np.geomspace(0.01, 2.0, 12)
#: Time constants around the best one, relative to it.
_NEAR_WARM_UPS = np.geomspace(1 / 1.5, 1.5, 9)
#: Lags of a temperature, as parts of the record.
_LAGS = np.geomspace(3e-4, 0.1, 16)
#: Fewest periods per record of a cycle: with fewer, it is a slow cycle.
_MIN_PERIODS = 2.0
#: Most periods per record of a cycle: with more, it is a line.
_MAX_PERIODS = 24.0
#: Fewest periods per record of a slow cycle: with fewer, it is a drift.
_MIN_SLOW_PERIODS = 0.7
#: Number of ordinates for a slow cycle.
_OF_SLOW = 128
#: Spacing of the search in periods per record: a peak is about one period wide.
_SPACING = 0.25
#: Spacing around the peak of the search.
_FINE = 1 / 64
#: Least gain beyond the price, in twice the log-likelihood.
_MARGIN = 7.0
#: False alarm rate of steps in clean records of known spectrum.
_CHANCE_STEP = 0.002
#: Price of a cycle, independent of the rate. Source: Baluev (2008), MNRAS 385, 1279.
_PRICE_CYCLE = 16.0
#: Gain beyond its price from which a cycle is doubtful.
_DOUBT = -0.5
#: Price of a slow cycle, which a random walk often resembles.
_PRICE_SLOW_CYCLE = 20.0
#: Price of a warm-up, which a random walk resembles too.
_PRICE_WARM_UP = 20.0
#: Gain on the rich model from which a warm-up is as likely as a walk.
_RIVAL_WARM_UP = 6.0
#: The same of a change of level, which has a place and a width to choose.
_RIVAL_LEVEL = 12.0
#: The same of a bump; a walk resembles it more often.
_RIVAL_BUMP = 14.0
#: The same of the logged temperature: there is nothing to choose.
_RIVAL_TEMPERATURE = 0.0
#: The same of the temperature behind a lag to choose.
_RIVAL_LAGGED = 6.0
#: Widths of changes of level and bumps, as parts of the record.
_WIDTHS = np.geomspace(0.002, 0.2, 9)
#: Distance of two places to try, in widths.
_SPACING_OF_LEVELS = 0.5
#: Least distance of two places to try, as a part of the record.
_NEAREST_LEVELS = 1 / 400
#: Number of ordinates for changes of level.
_OF_LEVELS = 256
#: Ratio of the spectra with and without a walk from which there is one.
_NO_WALK = 2.0
#: Logarithm of a variance that is zero.
_ABSENT = -300.0
#: Share of the best gain from which shapes with a cause are preferred to cycles.
_CAUSED = 0.9
#: Steps nearer than the record's length over this are collinear.
_MAX_PLACES = 65536
#: Least gain of a shape, at the spectrum without it, for a fit.
_WORTH_A_FIT = 15.0
#: The same of a cycle or warm-up: less, because the spectrum contains its power.
_SMOOTH_WORTH_A_FIT = 9.0
#: Largest number of shapes to take out.
_MAX_SHAPES = 8


#: Returns a step's exact place from an approximate one, other steps' places and the least distance.
ExactPlace = Callable[[float, Sequence[float], float], int]


_Shape = TypeVar("_Shape", bound=Regressor)
_Shape_co = TypeVar("_Shape_co", bound=Regressor, covariant=True)


@dataclass(frozen=True, kw_only=True)
class Disturbance(Generic[_Shape_co]):
    """A shape in the samples that is not noise, such as a temperature, a warm-up, a step or a cycle.

    A cycle has two `regressors`, the others one. `size` are the coefficients in scaled units. `price` is the
    gain that the shape needs in addition to a margin. `excess` is the gain of a rival of a random walk beyond
    the gain that makes both equally likely.
    """

    regressors: tuple[_Shape_co, ...]
    price: float
    size: tuple[float, ...] = ()
    excess: float = 0.0

    @property
    def shape(self) -> _Shape_co:
        """The first regressor."""
        return self.regressors[0]

    @property
    def amplitude(self) -> float:
        """Norm of the coefficients, in scaled units."""
        return float(np.linalg.norm(self.size))


def with_shape(
    disturbances: Iterable[Disturbance[Regressor]], shape: type[_Shape]
) -> list[Disturbance[_Shape]]:
    """Return the disturbances whose regressors are of one class."""
    return [cast("Disturbance[_Shape]", one) for one in disturbances if isinstance(one.shape, shape)]


def regressors_of(disturbances: Iterable[Disturbance[Regressor]]) -> tuple[Regressor, ...]:
    """Return the regressors of all disturbances."""
    return tuple(regressor for one in disturbances for regressor in one.regressors)


def find_disturbances(
    blocks: Sequence[Block], *, exact: ExactPlace | None = None
) -> tuple[tuple[Disturbance[Regressor], ...], tuple[Disturbance[Regressor], ...]]:
    """Return the shapes to take out in addition to the ramp, the strongest first; and the doubtful ones.

    `exact` returns the exact place of a step: otherwise the next best shape would be a second step that
    corrects the error of the first.
    """
    low = [block.lowest(max(_LOWEST // len(blocks), 64)) for block in blocks]
    length = blocks[-1].offset + blocks[-1].bins.n
    found: list[Disturbance[Regressor]] = []
    doubtful: tuple[Disturbance[Regressor], ...] = ()
    plain = bin_blocks(low, 1.0, ())
    base = _fits(low, [()])
    while len(found) < _MAX_SHAPES:
        taken = regressors_of(found)
        whitened = Whitened.by(low, base.unfiltered(plain), (Ramp(), *taken))
        kinds = [*_candidates(whitened, length, found)]
        kinds += _step(whitened, max(length / _MAX_PLACES, 1.0), found, exact)
        candidates = [one for one in kinds if not set(one.regressors) & set(taken)]
        if not candidates:
            break
        fits = _fits(low, [(*taken, *one.regressors) for one in candidates])
        gains = 2 * (base.objective[0] - fits.objective)
        net = gains - np.array([one.price for one in candidates])
        cycle = np.array([isinstance(one.shape, Wave) for one in candidates])
        caused = ~cycle & (net > _MARGIN) & (gains > _CAUSED * gains.max())
        allowed = caused if caused.any() else np.ones(net.size, dtype=bool)
        best = int(np.argmax(np.where(allowed, net, -np.inf)))
        if net[best] <= _MARGIN:
            likely = np.where(cycle, net, -np.inf)
            row = int(np.argmax(likely))
            if likely[row] > _DOUBT:
                doubtful = _sized([candidates[row]], fits, row)
            break
        strongest, base = _taken_out(candidates[best], low, plain, taken)
        found.append(strongest)
    return _sized(found, base), (*doubtful, *_rival(low, plain, base, found))


def _taken_out(
    strongest: Disturbance[Regressor], low: Sequence[Block], plain: Ordinates, taken: tuple[Regressor, ...]
) -> tuple[Disturbance[Regressor], Fits]:
    """Return the strongest disturbance and the fit with it.

    The spectrum without a warm-up contains its power, so its time constant is searched again.
    """
    base = _fits(low, [(*taken, *strongest.regressors)])
    if not isinstance(strongest.shape, WarmUp):
        return strongest, base
    whitened = Whitened.by(low, base.unfiltered(plain), (Ramp(), *taken))
    _, warm_up = _warm_up(whitened, low[-1].offset + low[-1].bins.n)
    return warm_up, _fits(low, [(*taken, *warm_up.regressors)])


def _sized(
    found: Sequence[Disturbance[Regressor]], fits: Fits, row: int = 0
) -> tuple[Disturbance[Regressor], ...]:
    coefficients = dict(zip(fits.models.names, fits.beta[row].tolist(), strict=True))
    sized = []
    for disturbance in found:
        size = tuple(coefficients[regressor.name] for regressor in disturbance.regressors)
        sized.append(replace(disturbance, size=size))
    return tuple(sized)


def _fits(
    low: Sequence[Block], sets: Sequence[tuple[Regressor, ...]], structure: Structure = _STRUCTURE
) -> Fits:
    shapes = dict.fromkeys(shape for regressors in sets for shape in regressors)
    ordinates = bin_blocks(low, 1.0, (Ramp(), *shapes))
    seen = ordinates[ordinates.size > 0]
    has = np.array([[shape in {Ramp(), *own} for shape in ordinates.regressors] for own in sets])
    models = replace(models_of([structure] * len(sets), ordinates.names), regressors=has)
    return fit_blindly(seen, models, keep=(1, 2, 2), tolerance=1e-2)


def _candidates(
    whitened: Whitened, length: int, found: Sequence[Disturbance[Regressor]]
) -> Iterator[Disturbance[Regressor]]:
    """Yield the best shape of each kind, except steps, if it may be worth a fit."""
    if not with_shape(found, TemperatureEffect):
        for gain, temperature in _temperatures(whitened, length):
            if gain > _SMOOTH_WORTH_A_FIT:
                yield temperature
    for slow in (False, True):
        gain, cycle = best_cycle(whitened, length, slow=slow)
        if gain > _SMOOTH_WORTH_A_FIT:
            yield cycle
    if not with_shape(found, WarmUp):
        gain, warm_up = _warm_up(whitened, length)
        if gain > _SMOOTH_WORTH_A_FIT:
            yield warm_up


def _temperatures(whitened: Whitened, length: int) -> list[tuple[float, Disturbance[TemperatureEffect]]]:
    """Return the logged temperature, and behind the best lag, with their gains; [] if none is logged."""
    if not all(b.temperature is not None and np.ptp(b.temperature) > 0 for b in whitened.blocks):
        return []
    price = float(np.log(length))
    at_once = Disturbance(regressors=(TemperatureEffect(),), price=price)
    lags = [TemperatureEffect(lag=lag) for lag in (_LAGS * length).tolist()]
    gains = [whitened.gain((lag,)) for lag in lags]
    best = int(np.argmax(gains))
    lagged = Disturbance(regressors=(lags[best],), price=2 * price)
    return [(whitened.gain(at_once.regressors), at_once), (gains[best], lagged)]


def _level(whitened: Whitened, length: int, shape: type[LevelChange] | type[Bump]) -> Disturbance[Regressor]:
    """Return the change of level, or the bump, that gains most."""
    lowest = whitened.lowest(_OF_LEVELS)
    gain, best = -1.0, (0.0, 0.0)
    for width in (_WIDTHS * length).tolist():
        apart = max(_SPACING_OF_LEVELS * width, _NEAREST_LEVELS * length)
        places = np.arange(apart, length - apart / 2, apart)
        gains = lowest.levels(shape, places, width)
        row = int(np.argmax(gains))
        if gains[row] > gain:
            gain, best = float(gains[row]), (float(places[row]), width)
    place, width = best
    return Disturbance(regressors=(shape(place=place, width=width),), price=0.0)


def _warm_up(whitened: Whitened, length: int) -> tuple[float, Disturbance[WarmUp]]:
    lowest, best, gain = whitened.lowest(), 1.0, 0.0
    for factors in (_WARM_UPS * length, _NEAR_WARM_UPS):
        times = best * factors
        gains = lowest.gains_alone([WarmUp(time_constant=time) for time in times.tolist()])
        row = int(np.argmax(gains))
        best, gain = float(times[row]), float(gains[row])
    return gain, Disturbance(regressors=(WarmUp(time_constant=best),), price=_PRICE_WARM_UP)


def _rival(
    low: Sequence[Block], plain: Ordinates, base: Fits, found: Sequence[Disturbance[Regressor]]
) -> tuple[Disturbance[Regressor], ...]:
    """Return the shape that explains a record as well as a random walk does, or ()."""
    theta, length = base.theta.copy(), low[-1].offset + low[-1].bins.n
    theta[:, [COLUMN["K"], SHAPED]] = _ABSENT
    still = replace(base, theta=theta).unfiltered(plain)
    if np.max(base.unfiltered(plain) / still) < _NO_WALK:
        return ()
    taken = regressors_of(found)
    whitened = Whitened.by(low, still, (Ramp(), *taken))
    rivals: dict[Disturbance[Regressor], float] = {
        _level(whitened, length, LevelChange): _RIVAL_LEVEL,
        _level(whitened, length, Bump): _RIVAL_BUMP,
    }
    if not with_shape(found, WarmUp):
        rivals[_warm_up(whitened, length)[1]] = _RIVAL_WARM_UP
    if not with_shape(found, TemperatureEffect):
        needs = (_RIVAL_TEMPERATURE, _RIVAL_LAGGED)
        for (_, temperature), need in zip(_temperatures(whitened, length), needs, strict=False):
            rivals[temperature] = need
    fits = _fits(low, [(*taken, *one.regressors) for one in rivals], ("N", "B", "R"))
    excess = 2 * (base.objective[0] - fits.objective) - np.array([*rivals.values()])
    row = int(np.argmax(excess))
    likeliest = replace([*rivals][row], excess=float(excess[row]))
    return _sized([likeliest], fits, row) if likeliest.excess > 0 else ()


def _step(
    whitened: Whitened, apart: float, found: Sequence[Disturbance[Regressor]], exact: ExactPlace | None
) -> Iterator[Disturbance[Step]]:
    taken = [one.shape.place for one in with_shape(found, Step)]
    place, gain, choice = whitened.step(taken, apart)
    if gain <= _WORTH_A_FIT:
        return
    nearest = round(place) if exact is None else exact(place, taken, apart)
    price = 2 * np.log(max(choice, 1.0) / _CHANCE_STEP) - _MARGIN
    yield Disturbance(regressors=(Step(place=nearest),), price=price)


def best_cycle(whitened: Whitened, length: int, *, slow: bool = False) -> tuple[float, Disturbance[Wave]]:
    """Return the gain and shape of the best cycle, or slow cycle."""
    unit = 2 * np.pi / length
    fewest, most = (_MIN_SLOW_PERIODS, _MIN_PERIODS) if slow else (_MIN_PERIODS, _MAX_PERIODS)
    coarse = np.arange(fewest, most + _SPACING / 2, _SPACING)
    lowest = whitened.lowest(_OF_SLOW) if slow else whitened.lowest()
    near = coarse[int(np.argmax(lowest.cycles(unit * coarse)))]
    fine = near + _FINE * np.arange(-round(_SPACING / _FINE), round(_SPACING / _FINE) + 1)
    fine = fine[fine >= fewest]
    gains = lowest.cycles(unit * fine)
    best = int(np.argmax(gains))
    omega = float(unit * fine[best])
    price = _PRICE_SLOW_CYCLE if slow else _PRICE_CYCLE
    return float(gains[best]), Disturbance(regressors=Wave.pair(omega), price=price)


#: Accuracy of the search, as a share of the record.
_COARSE = 1 / 1000


def exact_places(series: AxisSeries) -> ExactPlace:
    """Return the function that moves a step to the sample that splits its surroundings best."""

    def exact(about: float, taken: Sequence[float], apart: float) -> int:
        clock = series.clock
        reach = max(int(_COARSE * (clock.grid_size - 1)), 8)
        low = max([about - 2 * reach, *(place for place in taken if place <= about)])
        high = min([about + 2 * reach, *(place for place in taken if place > about)])
        first, stop = clock.index_from(math.ceil(low)), clock.index_from(math.ceil(high))
        samples, places = series.samples[first:stop], clock.grid(first + 1, stop)
        allowed = np.abs(places - about) <= reach
        for place in taken:
            allowed &= np.abs(places - place) >= apart
        if samples.size < 4 or not allowed.any():
            return round(about)
        left = np.cumsum(samples - samples.mean())[:-1]
        count = np.arange(1.0, samples.size)
        contrast = np.where(allowed, left**2 / (count * (samples.size - count)), -1.0)
        return int(places[int(np.argmax(contrast))])

    return exact
