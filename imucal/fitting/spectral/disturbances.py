"""Detection of disturbances at low frequencies: temperature, warm-up, steps and cycles.

A fit would mistake them for random walk or flicker. The search adds one shape at a time to the regressors
of a rich noise model: the one that gains most, if the gain exceeds its price and a margin.

The whitened ordinates select the shapes worth a fit: at a given spectrum, the log-likelihood that a regressor
gains is half its squared correlation with them, after both are made orthogonal to the fit's regressors.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.findings import Finding, Level
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import COLUMN, Structure, models_of
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, cycle_ordinates
from imucal.fitting.spectral.starts import fit_blindly
from imucal.frozen import frozen, frozen_alone
from imucal.recording import AxisSeries
from imucal.units import pretty

#: Number of places in a block that are searched for a step.
_PLACES = 8192
#: Ordinates of all blocks that contain nearly all power of a cycle of 24 periods or of a warm-up.
_OF_SMOOTH = 512
#: Ordinates for a slow cycle.
_OF_SLOW = 128
#: Share of a block at each end where a step can't be distinguished from the block's mean.
_CLEAR = 0.005
#: Remainder of a shape, after subtracting the fit's regressors, below which it is collinear with them.
_ALIKE = 1e-6


@frozen_alone
class Whitened:
    """The lowest ordinates of blocks, divided by the root of their spectrum, minus the fitted regressors.

    `weight` is 1/sqrt(S) of each block's ordinates, 0 if they are left out, shapes (k,). `rest` are the
    whitened ordinates of all blocks, shape (K,), and `base` an orthonormal basis of the whitened regressors,
    (K, r).
    """

    blocks: tuple[Block, ...]
    weight: tuple[FloatArray, ...]
    rest: FloatArray
    base: FloatArray

    @classmethod
    def by(cls, blocks: Sequence[Block], spectrum: FloatArray, names: Sequence[str]) -> "Whitened":
        """Return the ordinates whitened by the bins' `spectrum`, shape (b,); the fit has `names`."""
        parts = np.split(spectrum, np.cumsum([block.bins.size for block in blocks])[:-1])
        weights = []
        for block, part in zip(blocks, parts, strict=True):
            # Missing samples reduce the power.
            share = 1.0 if block.loss is None else 1 - block.loss
            own = np.repeat(np.sqrt(share / part), block.bins.count)
            weights.append(own if block.kept is None else np.where(block.kept, own, 0.0))
        own = np.concatenate([block.ordinates * w for block, w in zip(blocks, weights, strict=True)])
        plain = cls(blocks=tuple(blocks), weight=tuple(weights), rest=own, base=np.zeros((own.size, 0)))
        base = np.linalg.qr(plain.columns(names))[0]
        return replace(plain, rest=own - base @ (base.T @ own), base=base)

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return whitened regressors, shape (K, r)."""
        pairs = list(zip(self.blocks, self.weight, strict=True))
        every = [np.concatenate([block.regressor(name) * w for block, w in pairs]) for name in names]
        return np.stack(every, axis=1) if every else np.zeros((self.rest.size, 0))

    def gain(self, names: Sequence[str]) -> float:
        """Return twice the log-likelihood that regressors gain together."""
        columns = self.columns(names)
        columns -= self.base @ (self.base.T @ columns)
        solution = np.linalg.lstsq(columns, self.rest, rcond=_ALIKE)[0]
        return float(self.rest @ (columns @ solution))

    def lowest(self, count: int = _OF_SMOOTH) -> "Whitened":
        """Return the lowest ordinates, which contain nearly all of a smooth shape, with truncated basis."""
        blocks = tuple(block.lowest(max(count // len(self.blocks), 1)) for block in self.blocks)
        sizes = [block.ordinates.size for block in self.blocks]
        starts = np.cumsum([0, *sizes[:-1]])
        rows = np.concatenate([s + np.arange(b.ordinates.size) for s, b in zip(starts, blocks, strict=True)])
        weight = tuple(w[: b.ordinates.size] for w, b in zip(self.weight, blocks, strict=True))
        return Whitened(blocks=blocks, weight=weight, rest=self.rest[rows], base=self.base[rows])

    def gains_alone(self, names: Sequence[str]) -> FloatArray:
        """Return the gain of each regressor alone, shape (r,)."""
        columns = self.columns(names)
        whole = np.sum(columns**2, axis=0)
        columns -= self.base @ (self.base.T @ columns)
        size = np.sum(columns**2, axis=0)
        return np.where(size > _ALIKE**2 * whole, (self.rest @ columns) ** 2 / np.maximum(size, 1e-300), 0.0)

    def cycles(self, omega: FloatArray) -> FloatArray:
        """Return the gain of a cycle of each angular frequency, rad/sample, shape of `omega`."""
        # Cosine and sine of each frequency, shapes (2, w, k).
        shapes, quarter = [], np.array([0.0, -np.pi / 2])[:, np.newaxis, np.newaxis]
        for block, own in zip(self.blocks, self.weight, strict=True):
            theta = np.pi / block.bins.n * np.arange(1, block.ordinates.size + 1, dtype=np.float64)
            shift = omega[:, np.newaxis] * block.offset + quarter
            shapes.append(cycle_ordinates(block.bins.n, theta, omega[:, np.newaxis], shift) * own)
        pairs = np.concatenate(shapes, axis=-1)
        pairs -= (pairs @ self.base) @ self.base.T
        products = np.moveaxis(pairs @ self.rest, 0, -1)
        size, vectors = np.linalg.eigh(np.einsum("iwk,jwk->wij", pairs, pairs))
        # Use the principal axes of each pair, without nearly empty ones.
        along = np.einsum("wij,wi->wj", vectors, products)
        told = size > _ALIKE**2 * size[:, -1:]
        return np.asarray(np.sum(np.where(told, along**2 / np.where(told, size, 1.0), 0.0), axis=-1))

    def step(self, taken: Sequence[float] = (), apart: float = 0.0) -> tuple[float, float, float]:
        """Return the place of the step that gains most, in samples of the record, its gain, and the choice.

        Places nearer than `apart` to one of `taken` are left out. The choice is the effective number of
        independent places: in pure noise the best gain exceeds u with a probability of about this number
        times exp(-u/2), if that is small.
        """
        first, choice, best = 0, 0.0, (0.0, 0.0)
        near = [(place - apart, place + apart) for place in taken]
        for block, weight in zip(self.blocks, self.weight, strict=True):
            rows = slice(first, first + weight.size)
            place, gain, places = _best_step(block, weight, self.rest[rows], self.base[rows], near)
            best = max(best, (place, gain), key=lambda b: b[1])
            choice += places
            first += weight.size
        return (*best, choice)


def _best_step(
    block: Block,
    weight: FloatArray,
    rest: FloatArray,
    base: FloatArray,
    without: Sequence[tuple[float, float]],
) -> tuple[float, float, float]:
    """Return place and gain of the best step inside one block, and the number of places to choose among.

    A step's ordinates are sines of its place, so sine transforms give the products of all places at once. The
    number is the expected count of zero crossings of the root of the gain in pure noise, by Rice (1945),
    Bell Syst. Tech. J. 24, 46: the length of the path of whitened steps of size one, over pi.
    """
    n, count = block.bins.n, weight.size
    places = max(_PLACES, 2 * count)
    half = np.pi / (2 * n) * np.arange(1, count + 1)
    size = np.sqrt(2 / n) / (2 * np.sin(half)) * weight

    def along(values: FloatArray) -> FloatArray:
        """Return sum of values_k sin(pi k j / places) at j = 1 … places-1; shape (…, places-1)."""
        padded = np.zeros((*values.shape[:-1], places - 1))
        padded[..., :count] = values
        return np.asarray(scipy.fft.dst(padded, type=1, axis=-1) / 2)

    def of_twice(values: FloatArray) -> FloatArray:
        """Return sum of values_k cos(2 pi k j / places) at j = 1 … places-1."""
        square = np.zeros(places + 1)
        square[2 : 2 * count + 1 : 2] = values
        return np.asarray((scipy.fft.dct(square, type=1) + square[-1]) / 2)[1:-1]

    # sin² = (1 - cos of twice the angle) / 2, and its slope's square is k² cos² = k² (1 + cos) / 2.
    power = 0.5 * (np.sum(size**2) - of_twice(size**2))
    slope = (size * np.pi / places * np.arange(1, count + 1)) ** 2
    slope = 0.5 * (np.sum(slope) + of_twice(slope))
    left = power - np.sum(along((base * size[:, None]).T) ** 2, axis=0)
    product = along(rest * size)
    gain = np.where(left > _ALIKE * power + 1e-300, product**2 / np.maximum(left, 1e-300), 0.0)
    clear = int(_CLEAR * places) + 1
    gain[:clear] = gain[gain.size - clear :] = 0.0
    where = block.offset + np.arange(1, places) * n / places
    for low, high in without:
        gain[(where > low) & (where < high)] = 0.0
    at = int(np.argmax(gain))
    # Length of the path of the normalised steps: changes of size alone do not count.
    way = slope / power - (np.gradient(power) / (2 * power)) ** 2
    choice = float(np.sqrt(np.maximum(way, 0.0))[clear : gain.size - clear].sum()) / np.pi
    return float(where[at]), float(gain[at]), choice


#: A rich model, and the number of ordinates that contain slow shapes.
_STRUCTURE = ("N", "B", "GM", "K", "R")
_LOWEST = 4000
#: Time constants of a warm-up, as parts of the record; the slowest is already a ramp and a parabola.
_WARM_UPS = np.geomspace(0.01, 2.0, 12)
#: Time constants around the best one, relative to it.
_NEAR_WARM_UPS = np.geomspace(1 / 1.5, 1.5, 9)
#: Lags of a temperature, as parts of the record.
_LAGS = np.geomspace(3e-4, 0.1, 16)
#: Periods per record of cycles: fewer are drifts, more are lines.
_FEWEST_PERIODS, _MOST_PERIODS = 2.0, 24.0
#: Fewest periods per record of a slow cycle, which resembles a random walk; fewer are a drift.
_FEWEST_SLOW = 0.7
#: Spacing of the periods per record, in the search and around its peak.
_SPACING, _FINE = 0.25, 1 / 64
#: Least gain of a shape beyond its price, in twice the log-likelihood.
_MARGIN = 7.0
#: False alarm rate of steps in clean records of known spectrum.
_CHANCE_STEP = 0.002
#: Price of a cycle, independent of the rate. With a known spectrum one of 500 clean records gains 21 by
#: Baluev (2008), MNRAS 385, 1279; with a fitted one 23.
_PRICE_CYCLE = 16.0
#: Gain beyond its price above which a cycle below the margin is doubtful: 95 of 100 clean records gain less.
_DOUBT = -0.5
#: Price of a slow cycle, which a random walk often resembles, and of a warm-up.
_PRICE_SLOW_CYCLE, _PRICE_WARM_UP = 20.0, 20.0
#: Gain on the rich model from which a warm-up or slow cycle with N and B explains a record as well as a
#: walk. Of 60 simulated records with a weak walk 8 reach either gain, with flicker alone 5.
_RIVAL_WARM_UP, _RIVAL_CYCLE = 5.0, 14.0
#: Ratio of the spectra with and without walk below which the record shows no walk.
_NO_WALK = 2.0
#: Logarithm of a variance that is zero.
_ABSENT = -300.0
#: Other shapes, which have a cause, are preferred to cycles if they gain at least this share of the best.
_CAUSED = 0.9
#: Steps nearer than the record's length over this are collinear in the lowest ordinates.
_TELLABLE = 65536
#: Least gain, at the spectrum without the shape, for a fit. Slow cycles and warm-ups need less: this spectrum
#: contains their power, so the fit gains far more.
_WORTH_A_FIT, _SMOOTH_WORTH_A_FIT = 15.0, 9.0
#: Largest number of shapes to take out.
_MOST = 8


#: Returns a step's exact place from its approximate place, other steps' places and the least distance.
ExactPlace = Callable[[float, Sequence[float], float], int]


@frozen
class Disturbance:
    """A shape in the samples that is not noise.

    Its `kind` is ``temperature``, ``warm-up``, ``step`` or ``cycle``. `names` are its regressors, and `size`
    their coefficients in scaled units, () if not fitted yet. `price` is the gain in twice the log-likelihood
    that it needs in addition to a margin: per parameter the logarithm of the record's length; for a step or a
    cycle it follows from the false alarm rate.
    """

    kind: str
    names: tuple[str, ...]
    price: float
    size: tuple[float, ...] = ()

    @property
    def amplitude(self) -> float:
        """Amplitude of all regressors together, in scaled units."""
        return float(np.linalg.norm(self.size))

    @property
    def value(self) -> float:
        """Number after the colon of the first regressor's name; 0 if there is none."""
        return float(self.names[0].partition(":")[2] or 0.0)


def find_disturbances(
    blocks: Sequence[Block], *, exact: ExactPlace | None = None
) -> tuple[tuple[Disturbance, ...], tuple[Disturbance, ...]]:
    """Return the shapes to take out in addition to the ramp, the strongest first; and the doubtful ones.

    `exact` returns the exact place of a step before its fit: otherwise the next best shape would be a second
    step that corrects the error of the first.
    """
    low = [block.lowest(max(_LOWEST // len(blocks), 64)) for block in blocks]
    length = blocks[-1].offset + blocks[-1].bins.n
    found: list[Disturbance] = []
    doubtful: tuple[Disturbance, ...] = ()
    plain = bin_blocks(low, 1.0, ())
    base = _fits(low, [()])
    while len(found) < _MOST:
        names = tuple(name for one in found for name in one.names)
        whitened = Whitened.by(low, base.unfiltered(plain), ("R", *names))
        kinds = [*_candidates(whitened, length, found)]
        kinds += _step(whitened, max(length / _TELLABLE, 1.0), found, exact)
        candidates = [one for one in kinds if not set(one.names) & set(names)]
        if not candidates:
            break
        fits = _fits(low, [(*names, *one.names) for one in candidates])
        gains = 2 * (base.objective[0] - fits.objective)
        net = gains - np.array([one.price for one in candidates])
        cycle = np.array([one.kind == "cycle" for one in candidates])
        caused = ~cycle & (net > _MARGIN) & (gains > _CAUSED * gains.max())
        best = int(np.argmax(np.where(caused, net, -np.inf) if caused.any() else net))
        if net[best] <= _MARGIN:
            likely = np.where(cycle, net, -np.inf)
            row = int(np.argmax(likely))
            if likely[row] > _DOUBT:
                doubtful = _sized([candidates[row]], fits, row)
            break
        taken, base = _taken_out(candidates[best], low, plain, names)
        found.append(taken)
    return _sized(found, base), (*doubtful, *_rival(low, plain, base, found))


def _taken_out(
    one: Disturbance, low: Sequence[Block], plain: Ordinates, names: tuple[str, ...]
) -> tuple[Disturbance, Fits]:
    """Return a shape and the fit with it and the regressors `names`.

    The spectrum without a warm-up contains the warm-up's power, so its time constant is searched again
    with the spectrum of the fit with it.
    """
    base = _fits(low, [(*names, *one.names)])
    if one.kind != "warm-up":
        return one, base
    whitened = Whitened.by(low, base.unfiltered(plain), ("R", *names))
    one = _warm_up(whitened, low[-1].offset + low[-1].bins.n)[1]
    return one, _fits(low, [(*names, *one.names)])


def _sized(found: Sequence[Disturbance], fits: Fits, row: int = 0) -> tuple[Disturbance, ...]:
    """Return shapes with their coefficients in one of the fits."""
    beta = dict(zip(fits.models.names, fits.beta[row].tolist(), strict=True))
    return tuple(replace(one, size=tuple(beta[name] for name in one.names)) for one in found)


def _fits(low: Sequence[Block], sets: Sequence[tuple[str, ...]], structure: Structure = _STRUCTURE) -> Fits:
    """Return the best fit of a structure with the ramp and each set of regressors."""
    names = ("R", *dict.fromkeys(name for names in sets for name in names))
    ordinates = bin_blocks(low, 1.0, names)
    seen = ordinates[ordinates.size > 0]
    has = np.array([[name in {"R", *own} for name in names] for own in sets])
    models = replace(models_of([structure] * len(sets), names), regressors=has)
    return fit_blindly(seen, models, keep=(1, 2, 2), tolerance=1e-2)


def _candidates(whitened: Whitened, length: int, found: Sequence[Disturbance]) -> Iterator[Disturbance]:
    """Yield the best shape of each kind, except steps, if it may be worth a fit."""
    price = np.log(length)
    families: list[list[Disturbance]] = []
    once = {one.kind for one in found}
    measured = all(b.temperature is not None and np.ptp(b.temperature) > 0 for b in whitened.blocks)
    if measured and "temperature" not in once:
        families.append([Disturbance(kind="temperature", names=("temperature",), price=price)])
        names = [f"temperature:{lag!r}" for lag in (_LAGS * length).tolist()]
        families.append([Disturbance(kind="temperature", names=(name,), price=2 * price) for name in names])
    for slow in (False, True):
        gain, cycle = best_cycle(whitened, length, slow=slow)
        if gain > _SMOOTH_WORTH_A_FIT:
            yield cycle
    if "warm-up" not in once:
        gain, warm_up = _warm_up(whitened, length)
        if gain > _SMOOTH_WORTH_A_FIT:
            yield warm_up
    for shapes in families:
        gains = [whitened.gain(shape.names) for shape in shapes]
        best = int(np.argmax(gains))
        if gains[best] > _WORTH_A_FIT:
            yield shapes[best]


def _warm_up(whitened: Whitened, length: int) -> tuple[float, Disturbance]:
    """Return the gain and shape of the best warm-up on a grid, its time constant refined."""
    lowest, best, gain = whitened.lowest(), 1.0, 0.0
    for factors in (_WARM_UPS * length, _NEAR_WARM_UPS):
        times = best * factors
        gains = lowest.gains_alone([f"exp:{time!r}" for time in times.tolist()])
        row = int(np.argmax(gains))
        best, gain = float(times[row]), float(gains[row])
    return gain, Disturbance(kind="warm-up", names=(f"exp:{best!r}",), price=_PRICE_WARM_UP)


def _rival(
    low: Sequence[Block], plain: Ordinates, base: Fits, found: Sequence[Disturbance]
) -> tuple[Disturbance, ...]:
    """Return the warm-up or slow cycle that explains a record as well as a random walk does, or ().

    A rich model with a walk fits the lowest ordinates of either shape, so the shape gains little with it.
    The shape with N and B alone is compared with the rich model instead.
    """
    theta, length = base.theta.copy(), low[-1].offset + low[-1].bins.n
    theta[:, [COLUMN["K"], SHAPED]] = _ABSENT
    still = replace(base, theta=theta).unfiltered(plain)
    if np.max(base.unfiltered(plain) / still) < _NO_WALK:
        return ()
    names = tuple(name for one in found for name in one.names)
    whitened = Whitened.by(low, still, ("R", *names))
    rivals = {best_cycle(whitened, length, slow=True)[1]: _RIVAL_CYCLE}
    if all(one.kind != "warm-up" for one in found):
        rivals[_warm_up(whitened, length)[1]] = _RIVAL_WARM_UP
    fits = _fits(low, [(*names, *one.names) for one in rivals], ("N", "B", "R"))
    excess = 2 * (base.objective[0] - fits.objective) - np.array([*rivals.values()])
    row = int(np.argmax(excess))
    return _sized([[*rivals][row]], fits, row) if excess[row] > 0 else ()


def _step(
    whitened: Whitened, apart: float, found: Sequence[Disturbance], exact: ExactPlace | None
) -> Iterator[Disturbance]:
    """Yield the best step at least `apart` from the others, if it may be worth a fit."""
    taken = [one.value for one in found if one.kind == "step"]
    place, gain, choice = whitened.step(taken, apart)
    if gain <= _WORTH_A_FIT:
        return
    place = round(place) if exact is None else exact(place, taken, apart)
    price = 2 * np.log(max(choice, 1.0) / _CHANCE_STEP) - _MARGIN
    yield Disturbance(kind="step", names=(f"step:{place}",), price=price)


def best_cycle(whitened: Whitened, length: int, *, slow: bool = False) -> tuple[float, Disturbance]:
    """Return the gain and shape of the best cycle, or slow cycle, on a grid, its frequency refined."""
    unit = 2 * np.pi / length
    fewest, most = (_FEWEST_SLOW, _FEWEST_PERIODS) if slow else (_FEWEST_PERIODS, _MOST_PERIODS)
    coarse = np.arange(fewest, most + _SPACING / 2, _SPACING)
    lowest = whitened.lowest(_OF_SLOW if slow else _OF_SMOOTH)
    near = coarse[int(np.argmax(lowest.cycles(unit * coarse)))]
    fine = near + _FINE * np.arange(-round(_SPACING / _FINE), round(_SPACING / _FINE) + 1)
    fine = fine[fine >= fewest]
    gains = lowest.cycles(unit * fine)
    best = int(np.argmax(gains))
    omega = float(unit * fine[best])
    price = _PRICE_SLOW_CYCLE if slow else _PRICE_CYCLE
    return float(gains[best]), Disturbance(
        kind="cycle", names=(f"cos:{omega!r}", f"sin:{omega!r}"), price=price
    )


#: Time constants after which a warm-up has settled: 5 % of it is left.
_SETTLED = 3.0
#: Share of the record within which jumps in one direction are one shift.
_ONE_SHIFT = 0.02
#: Accuracy of the search for a step's place, as a share of the record.
_COARSE = 1 / 1000


def exact_places(series: AxisSeries) -> ExactPlace:
    """Return the function that moves a step to the sample that splits its surroundings best.

    For two levels in white noise, the least-squares place maximises the weighted square of their difference.
    The surroundings end at other steps.
    """

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


def disturbance_findings(
    found: Sequence[Disturbance], series: AxisSeries, scale: float, *, fitted: bool
) -> tuple[Finding, ...]:
    """Return a finding for each kind that was found; `scale` is U per scaled unit.

    If they are `fitted` with the noise, the finding explains it.
    """
    kinds = {kind: [one for one in found if one.kind == kind] for kind in _WORDS}
    return tuple(_WORDS[kind](own, series, scale, fitted=fitted) for kind, own in kinds.items() if own)


def _temperature_finding(
    found: list[Disturbance], series: AxisSeries, scale: float, *, fitted: bool
) -> Finding:
    (one,) = found
    lag = f", with a lag of {one.value * series.tau0:.3g} s" if one.value else ""
    text = f"The axis follows the temperature ({_amount(one, series, scale)} per degree C{lag})"
    if fitted:
        text += "; the fit removes a linear effect"
        advice = "Use the noise model together with a temperature compensation."
    else:
        advice = "Record at a steady temperature, or compensate first; K and B include the thermal drift."
    level: Level = "info" if fitted else "warning"
    return Finding(level, "temperature", f"{text}.", advice, axis=series.name)


def _warm_up_finding(found: list[Disturbance], series: AxisSeries, _: float, *, fitted: bool) -> Finding:
    (one,) = found
    time = one.value * series.tau0
    end = "; the fit removes this drift" if fitted else ": a warm-up"
    settled, length = _SETTLED * time, series.duration_s
    keep_s = (round(settled, 1), round(length, 1)) if settled < length / 2 else None
    text = f"The axis settles exponentially, with a time constant of {time:.3g} s{end}."
    advice = "Leave out the first part of the record, or let the sensor warm up before recording."
    code = "warm-up-fitted" if fitted else "warm-up"
    return Finding("warning", code, text, advice, axis=series.name, keep_s=keep_s)


def _step_finding(found: list[Disturbance], series: AxisSeries, scale: float, *, fitted: bool) -> Finding:
    """Name the jumps in order of time; the longest part without one is worth keeping.

    Jumps in one direction shortly after each other are reported as one gradual shift.
    """
    found = sorted(found, key=lambda one: one.value)
    times = [one.value * series.tau0 for one in found]
    shifts: list[tuple[float, float, float]] = []
    for one, time in zip(found, times, strict=True):
        size = one.size[0] * scale
        first, before, last = shifts[-1] if shifts else (0.0, 0.0, 0.0)
        if before * size > 0 and time - last < _ONE_SHIFT * series.duration_s:
            shifts[-1] = (first, before + size, time)
        else:
            shifts.append((time, size, time))
    jumps = [
        f"{size:+.3g} {pretty(series.unit)} "
        + (f"from {first:.1f} to {last:.1f} s" if last > first else f"at {first:.1f} s")
        for first, size, last in shifts
    ]
    several = len(shifts) > 1
    stays = "" if several else " and stays there"
    taken_out = f"; the fit removes the jump{'s' * several}" if fitted else ""
    ends = np.array([0.0, *times, series.duration_s])
    longest = int(np.argmax(np.diff(ends)))
    keep_s = (round(float(ends[longest]), 1), round(float(ends[longest + 1]), 1))
    text = f"The level jumps by {', '.join(jumps)}{stays}{taken_out}."
    advice = "Fix the IMU so that nothing tilts it, or look for a bias that switches."
    return Finding("warning", "step", text, advice, axis=series.name, keep_s=keep_s)


def _cycle_finding(found: list[Disturbance], series: AxisSeries, scale: float, *, fitted: bool) -> Finding:
    taken_out = "; the fit removes it" if fitted else ""
    text = f"The axis swings with a period of {_periods(found, series, scale)}{taken_out}."
    advice = "Look for a heater or cooler that switches, and record at a steady temperature."
    return Finding("warning", "cycle", text, advice, axis=series.name)


#: Kind of disturbance -> function that returns its finding, in order of the report.
_WORDS = {
    "temperature": _temperature_finding,
    "warm-up": _warm_up_finding,
    "step": _step_finding,
    "cycle": _cycle_finding,
}


def doubtful_finding(
    doubtful: Sequence[Disturbance], series: AxisSeries, scale: float
) -> tuple[Finding, ...]:
    """Return a finding for doubtful warm-ups or cycles; `scale` is U per scaled unit."""
    if not doubtful:
        return ()
    cycles = [one for one in doubtful if one.kind == "cycle"]
    shapes = [
        f"a warm-up with a time constant of about {one.value * series.tau0:.2g} s"
        for one in doubtful
        if one.kind == "warm-up"
    ]
    code = "warm-up-doubtful" if shapes else "cycle-doubtful"
    advice = (
        "Let the sensor warm up, leave out the first part (--skip), or record for longer."
        if shapes
        else "Record for longer to see whether it continues."
    )
    if cycles:
        shapes.append(f"a cycle with a period of {_periods(cycles, series, scale)}")
    text = (
        f"There may be {' and '.join(shapes)}, or a random walk that looks like it: the record can't "
        "distinguish them. The limits of N, B and K allow for both."
    )
    return (Finding("info", code, text, advice, axis=series.name),)


def _periods(found: Sequence[Disturbance], series: AxisSeries, scale: float) -> str:
    return ", ".join(
        f"{2 * np.pi / one.value * series.tau0:.4g} s (amplitude {_amount(one, series, scale)})"
        for one in sorted(found, key=lambda one: -one.amplitude)
    )


def _amount(one: Disturbance, series: AxisSeries, scale: float) -> str:
    return f"{one.amplitude * scale:.3g} {pretty(series.unit)}"
