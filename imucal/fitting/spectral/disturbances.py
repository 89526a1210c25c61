"""What is not noise at low frequencies: temperature, warm-up, steps and cycles, found and taken out.

Each would be fitted as a random walk or flicker. One at a time, the shape that gains most beside a
rich noise model is added to the regressors, as long as it gains more than chance and its price give.
The search is by the whitened ordinates; what it finds is fitted before it is believed.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.likelihood import Candidates, evaluate
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.fitting.spectral.scoring import Maximum, maximize
from imucal.fitting.spectral.starts import find_starts
from imucal.fitting.spectral.structures import candidates_of
from imucal.fitting.spectral.transform import bin_blocks
from imucal.fitting.spectral.whitened import Whitened

#: A rich model, shortest correlation time in it, in samples, and the ordinates that slow shapes live in.
_STRUCTURE = ("N", "B", "GM", "K", "R")
_SHORTEST = 2.0
_LOWEST = 4000
#: Time constants of a warm-up, and lags of a temperature, as parts of the record.
_WARM_UPS = np.geomspace(0.01, 0.3, 8)
_LAGS = np.geomspace(3e-4, 0.1, 16)
#: Periods a record of the cycles that are looked for: fewer are drifts, more are lines. And their
#: spacing, at first and where a peak was found.
_FEWEST_PERIODS, _MOST_PERIODS = 2.0, 24.0
_SPACING, _FINE = 0.25, 1 / 64
#: What a shape must gain beyond the price of its parameters, in twice the log-likelihood.
_MARGIN = 7.0
#: Share of clean records in which a step would gain what it must, were their spectrum known.
_CHANCE_STEP = 0.002
#: Nearer than the record's length over this, two steps are too alike in the lowest ordinates to be fitted.
_TELLABLE = 65536
#: A shape that gains less at the spectrum of the fit without it is not fitted: chance gives so much.
_WORTH_A_FIT = 15.0
#: Most shapes that are taken out.
_MOST = 8


#: From about where a step lies, where others lie and how far it is from those, to where it lies exactly.
ExactPlace = Callable[[float, Sequence[float], float], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """A shape of the samples that is no noise.

    Attributes
    ----------
    kind
        ``temperature``, ``warm-up``, ``step`` or ``cycle``.
    names
        Its regressors.
    price
        What it must gain in twice the log-likelihood, beside a margin. The price of a parameter is the
        logarithm of the record's length; that of a step follows from how often chance makes one.
    size
        Coefficients of the regressors, in scaled units; () before it is fitted.
    """

    kind: str
    names: tuple[str, ...]
    price: float
    size: tuple[float, ...] = ()

    @property
    def amplitude(self) -> float:
        """Size of the regressors together, in scaled units."""
        return float(np.linalg.norm(self.size))

    @property
    def value(self) -> float:
        """What follows the colon of the first regressor's name; 0 where nothing does."""
        return float(self.names[0].partition(":")[2] or 0.0)


def find_disturbances(
    blocks: Sequence[Block], *, steps: bool = True, exact: ExactPlace | None = None
) -> tuple[Disturbance, ...]:
    """Return what the data ask to be taken out beside the ramp, the strongest first.

    Without `steps` none are looked for: a level that jumps to and fro is not a few of them. `exact` puts
    each step where it lies exactly before it is fitted: beside a step that is fitted a little off its
    place, the next best shape is another step there, which mends it.
    """
    low = [block.lowest(max(_LOWEST // len(blocks), 64)) for block in blocks]
    length = blocks[-1].offset + blocks[-1].bins.n
    found: list[Disturbance] = []
    base = _fits(low, [()])
    while len(found) < _MOST:
        names = tuple(name for one in found for name in one.names)
        whitened = Whitened.by(low, base.spectrum, ("R", *names))
        kinds = [*_candidates(whitened, length, found)]
        if steps:
            kinds += _step(whitened, max(length / _TELLABLE, 1.0), found, exact)
        candidates = [one for one in kinds if not set(one.names) & set(names)]
        if not candidates:
            break
        fits = _fits(low, [(*names, *one.names) for one in candidates])
        gains = 2 * (base.objective - fits.maximum.objective)
        net = [gain - one.price for gain, one in zip(gains, candidates, strict=True)]
        best = int(np.argmax(net))
        if net[best] <= _MARGIN:
            break
        found.append(candidates[best])
        base = _fits(low, [(*names, *candidates[best].names)])
    return _with_sizes(found, base)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fits:
    """A rich structure fitted with sets of regressors, one row each."""

    ordinates: Ordinates
    candidates: Candidates
    maximum: Maximum

    @property
    def objective(self) -> float:
        return float(self.maximum.objective[0])

    @property
    def spectrum(self) -> FloatArray:
        """Of the first set, at the bins, shape (b,); 1 in bins without ordinates."""
        row = np.array([0])
        found = evaluate(self.ordinates, self.candidates.take(row), self.maximum.theta[row])
        return np.asarray(found.spectrum[0])


def _fits(low: Sequence[Block], sets: Sequence[tuple[str, ...]]) -> _Fits:
    """Return the best fit of a rich structure with each set of regressors beside the ramp."""
    names = ("R", *dict.fromkeys(name for names in sets for name in names))
    ordinates = bin_blocks(low, 1.0, names)
    seen = ordinates.take(ordinates.size > 0)
    candidates = candidates_of([(*_STRUCTURE, *names) for names in sets], names)
    owner, theta = find_starts(seen, candidates, shortest=_SHORTEST, keep=(1, 2, 2))
    every = maximize(seen, candidates.take(owner), theta, shortest=_SHORTEST, tolerance=1e-2, iterations=40)
    rows = [np.flatnonzero(owner == index) for index in range(len(sets))]
    best = np.array([own[np.argmin(every.objective[own])] for own in rows])
    return _Fits(ordinates=ordinates, candidates=candidates, maximum=every.take(best))


def _candidates(whitened: Whitened, length: int, found: Sequence[Disturbance]) -> Iterator[Disturbance]:
    """Yield the best shape of each kind but steps that may be worth a fit."""
    kinds = [best_cycle(whitened, length)]
    once = {one.kind for one in found}
    if "warm-up" not in once:
        kinds.append(_best_of(whitened, _warm_ups(length)))
    measured = all(b.temperature is not None and np.ptp(b.temperature) > 0 for b in whitened.blocks)
    if measured and "temperature" not in once:
        at_once = Disturbance(kind="temperature", names=("temperature",), price=np.log(length))
        kinds += [_best_of(whitened, [at_once]), _best_of(whitened, _lags(length))]
    yield from (one for gain, one in kinds if gain > _WORTH_A_FIT)


def _best_of(whitened: Whitened, shapes: Sequence[Disturbance]) -> tuple[float, Disturbance]:
    gains = [whitened.gain(shape.names) for shape in shapes]
    best = int(np.argmax(gains))
    return gains[best], shapes[best]


def _warm_ups(length: int) -> list[Disturbance]:
    price = 2 * np.log(length)
    times = (_WARM_UPS * length).tolist()
    return [Disturbance(kind="warm-up", names=(f"exp:{time!r}",), price=price) for time in times]


def _lags(length: int) -> list[Disturbance]:
    lags = (_LAGS * length).tolist()
    return [
        Disturbance(kind="temperature", names=(f"temperature:{lag!r}",), price=2 * np.log(length))
        for lag in lags
    ]


def _step(
    whitened: Whitened, apart: float, found: Sequence[Disturbance], exact: ExactPlace | None
) -> Iterator[Disturbance]:
    """Yield the best step if it may be worth a fit; nearer than `apart` to another it is the same one."""
    taken = [one.value for one in found if one.kind == "step"]
    place, gain, choice = whitened.step(taken, apart)
    if gain <= _WORTH_A_FIT:
        return
    place = round(place) if exact is None else exact(place, taken, apart)
    price = 2 * np.log(max(choice, 1.0) / _CHANCE_STEP) - _MARGIN
    yield Disturbance(kind="step", names=(f"step:{place}",), price=price)


def best_cycle(whitened: Whitened, length: int) -> tuple[float, Disturbance]:
    """Return the best cycle on a grid, its frequency refined."""
    unit = 2 * np.pi / length
    coarse = np.arange(_FEWEST_PERIODS, _MOST_PERIODS + _SPACING / 2, _SPACING)
    near = coarse[int(np.argmax(whitened.cycles(unit * coarse)))]
    fine = near + _FINE * np.arange(-round(_SPACING / _FINE), round(_SPACING / _FINE) + 1)
    fine = fine[fine >= _FEWEST_PERIODS]
    gains = whitened.cycles(unit * fine)
    best = int(np.argmax(gains))
    omega = float(unit * fine[best])
    return float(gains[best]), Disturbance(
        kind="cycle", names=(f"cos:{omega!r}", f"sin:{omega!r}"), price=3 * np.log(length)
    )


def _with_sizes(found: Sequence[Disturbance], fits: _Fits) -> tuple[Disturbance, ...]:
    beta = dict(zip(fits.ordinates.names, fits.maximum.beta[0].tolist(), strict=True))
    return tuple(replace(one, size=tuple(beta[name] for name in one.names)) for one in found)
