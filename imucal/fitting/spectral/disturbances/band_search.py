"""Search for the part of the spectrum that noise describes, with the bend of an output filter at its top.

The upper edge of the band is lowered in half octaves until a rich model describes what is below it, with
white noise at the top. A smooth bend may need one curvature coefficient (`band`); one more is free in the
fit, so that the rest of the bend does not bias N. If the spectrum rises above the edge, this is no filter but
a vibration.

White noise behind a one-pole filter has exactly the spectrum of a Gauss-Markov term without white noise, but
every sensor has white noise. So, if such a term makes up the top of the band, or if what looks white is the
rounding of the samples, the search goes on with correlation times that are too long to imitate a filter.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.hump import find_hump
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.maximum import UNLIKELY, fit_blindly, maximize, misfit, octave_score
from imucal.fitting.spectral.models import (
    COLUMN,
    SHORTEST,
    SHORTEST_GIVEN,
    Structure,
    models_of,
    shaped_symbols,
)
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, coarser

#: Returns the variance of the samples' rounding, in scaled units.
Rounding: TypeAlias = Callable[[], float]


def _no_rounding() -> float:
    return 0.0


#: Upper edges to try, as fractions of Nyquist: half octaves.
EDGES = tuple(2.0 ** (-half_octaves / 2) for half_octaves in range(21))
#: Fewest bins of a band.
_MIN_BINS = 24
#: Misfit score below which a description is sound.
_SOUND = 3.0
#: The same for the whole spectrum without curvature: a filter that does not exist widens the limits of N.
_SOUND_FLAT = 4.0
#: Score statistic of one more curvature coefficient below which a description has enough of them.
_BEND = 9.0
#: The same for the whole spectrum without curvature.
_BEND_FLAT = 12.0
#: Misfit score from which a hump is searched.
_UNSURE = 2.0
#: Number of bins that show the top of a band.
_HIGHEST = 8
#: Share of the top above which a Gauss-Markov term hides the white noise.
_MASKING = 0.5
#: Density ratio of a Gauss-Markov term to the white noise above which the white noise may be rounding.
_ABOVE = 4.0
#: Variance ratio of the white noise to the rounding below which it is the rounding.
_ROUNDED = 3.0
#: Factor on the correlation time of a term that imitates a filter: slower terms can't.
_SLOWER = 10.0
#: Curvature coefficients to start from: corners from the edge of the band down to 1/256 of it.
_SIZES = np.concatenate([[0.0], 4.0 ** np.arange(9)])
#: Octaves above the edge in which a rise is searched, in cells of half an octave.
_RISING = 2.0
#: Octaves of a cell in which the corner of a filter is searched.
_CELL = 1 / 6
#: Least number of ordinates of such a cell.
_KNOWN = 60
#: Share of the noise at the corner of a filter: -3 dB.
_HALF = 0.5
#: Least excess of a rise, besides chance.
_RISE = 0.05
#: Standard errors of a rise by chance.
_BY_CHANCE = 4.0
#: A parameter with less information than this does not take part in the score statistic.
_NO_INFORMATION = 1e-8


def find_band(
    ordinates: Ordinates,
    rich: Structure,
    *,
    given: Structure | None = None,
    near: float | None = None,
    rounding: Rounding = _no_rounding,
) -> Band:
    """Return the band and bend that a rich model describes, which contains all candidates.

    Q is only fitted to the whole spectrum, because a bend resembles it. A `given` structure is preferred if
    it describes the whole spectrum. `near` is the edge, a fraction of Nyquist, of a band that is known.
    """
    coarse = _coarse(ordinates)
    if near is None:
        flat = _flat(coarse, rich, given=given, rounding=rounding)
        # A Gauss-Markov term follows a weak hump, but not closely.
        unsure = flat is None or flat.statistic > _UNSURE
        if unsure and (around := _around_hump(coarse, rich, flat)):
            return around
        if flat is not None:
            return flat.band()
    plain = tuple(symbol for symbol in rich if symbol != "Q")
    return _lowered(coarse, plain, [near] if near else list(EDGES), rounding)


def _coarse(ordinates: Ordinates) -> Ordinates:
    return coarser(ordinates.below(1.0), singles=48, merge=3)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """One description of the bins below an edge: a structure, perhaps with curvature coefficients.

    `statistic` is its misfit score, and `octaves` the probability of its octave score.
    """

    seen: Ordinates
    structure: Structure
    edge: float
    fit: Fits
    statistic: float
    octaves: float

    @classmethod
    def of(cls, seen: Ordinates, structure: Structure, edge: float, fit: Fits) -> "_Trial":
        found = bool(np.isfinite(fit.objective[0]))
        return cls(
            seen=seen,
            structure=structure,
            edge=edge,
            fit=fit,
            statistic=misfit(seen, fit).statistic if found else np.inf,
            octaves=octave_score(seen, fit) if found else 0.0,
        )

    @classmethod
    def straight(
        cls, seen: Ordinates, structure: Structure, *, edge: float = 1.0, shortest: float = SHORTEST
    ) -> "_Trial":
        """Return the fit without curvature."""
        models = models_of([structure], seen.names, shortest=shortest)
        return cls.of(seen, structure, edge, fit_blindly(seen, models, keep=(1, 2, 4), tolerance=1e-3))

    @property
    def curvature(self) -> FloatArray:
        return self.fit.theta[0, self.fit.models.response :]

    @property
    def rises(self) -> bool:
        """Whether the spectrum rises towards the edge: no filter does, but shaped quantization."""
        return self.curvature.size > 0 and bool(self.curvature[0] < 0)

    def is_sound(self, *, most: float, bend: float) -> bool:
        """Whether both misfit scores are by chance, and one more coefficient gains less than `bend`."""
        return self.statistic < most and self.octaves > UNLIKELY and self.bend() < bend

    def bent(self) -> "_Trial":
        """Return the fit with one more curvature coefficient."""
        count = self.curvature.size + 1
        starts = _SIZES if count == 1 else np.zeros(1)
        theta = np.column_stack([np.repeat(self.fit.theta, starts.size, axis=0), starts])
        models = models_of(
            [self.structure] * starts.size,
            self.seen.names,
            poles=count,
            shortest=self.fit.models.shortest,
        )
        found = maximize(self.seen, models, theta, tolerance=1e-2, iterations=40)
        best = found[[int(np.argmin(found.objective))]]
        return self.of(self.seen, self.structure, self.edge, best)

    def bend(self) -> float:
        """Return the efficient score statistic of one more curvature coefficient.

        Source: Rao (1948), Proc. Camb. Phil. Soc. 44, 50. The part of the score that the other parameters
        can take is projected out; otherwise flat spectra seem bent.
        """
        seen, fit = self.seen, self.fit
        count = self.curvature.size
        x = seen.lam / seen.top
        response = 1 + x[:, None] ** np.arange(1, count + 1) @ self.curvature
        slope = -(x ** (count + 1)) / response
        weight = 0.5 * seen.size
        others = derivatives(seen, fit.models, fit.theta) / fit.spectrum[0]
        others = others[fit.models.free[0] & (np.square(others) @ weight > _NO_INFORMATION)]
        information = (others * weight) @ others.T
        shared = np.linalg.pinv(information, rcond=1e-10, hermitian=True) @ ((others * weight) @ slope)
        rest = slope - shared @ others
        own = float(np.square(rest) @ weight)
        if own < _NO_INFORMATION:
            return 0.0
        score = float(rest @ (weight - 0.5 * seen.rest(fit.beta[0]) / fit.spectrum[0]))
        return score**2 / own

    def masking(self, rounding: Rounding) -> float:
        """Return the correlation time, in samples, of the term that hides the white noise, or 0."""
        fit, seen = self.fit, self.seen
        variances = fit.models.variances
        times = fit.theta[0, variances : fit.models.response]
        if not times.size:
            return 0.0
        parts = derivatives(seen, fit.models, fit.theta)[:variances]
        top = parts[:, -_HIGHEST:].sum(axis=1)
        hidden = top[SHAPED:].sum() > _MASKING * top.sum()
        if not hidden and np.any(parts[SHAPED:] > _ABOVE * parts[COLUMN["N"]]):
            hidden = float(np.exp(fit.theta[0, COLUMN["N"]])) < _ROUNDED * rounding()
        if not hidden:
            return 0.0
        return float(np.exp(times[np.argmax(parts[SHAPED:].sum(axis=1))]))

    def band(self) -> Band:
        return Band(
            fraction=self.edge,
            response=self.curvature,
            shortest=self.fit.models.shortest,
            statistic=self.statistic,
        )


def _flat(
    coarse: Ordinates, rich: Structure, *, given: Structure | None, rounding: Rounding
) -> _Trial | None:
    """Return the whole spectrum without a bend, if noise describes it; the `given` structure first."""
    if given is not None and shaped_symbols(given):
        own = _Trial.straight(coarse, given, shortest=SHORTEST_GIVEN)
        white_at_the_top = "N" not in given or not own.masking(_no_rounding)
        if white_at_the_top and own.is_sound(most=_SOUND_FLAT, bend=_BEND_FLAT):
            return own
    every = _Trial.straight(coarse, rich)
    sound = every.is_sound(most=_SOUND_FLAT, bend=_BEND_FLAT)
    return every if sound and not every.masking(rounding) else None


def _around_hump(coarse: Ordinates, rich: Structure, flat: _Trial | None) -> Band | None:
    """Return the whole spectrum without a hump, or None."""
    laws = tuple(symbol for symbol in rich if symbol in {"N", "B", "K", "R"})
    hump = find_hump(coarse, laws) if "N" in laws else None
    if hump is None:
        return None
    around = _Trial.straight(coarse[hump.outside(coarse.fraction)], laws)
    if not around.is_sound(most=_SOUND_FLAT, bend=_BEND_FLAT):
        return None
    if flat is not None and around.statistic > flat.statistic - 1:
        return None
    return replace(around.band(), hump=hump)


def _lowered(coarse: Ordinates, structure: Structure, edges: list[float], rounding: Rounding) -> Band:
    """Return the band up to the highest edge with a sound description, else the least bad one."""
    slowest = SHORTEST
    masked = 0.0
    tried: list[_Trial] = []
    for edge in edges:
        seen = coarse.below(edge)
        if seen.size.size < _MIN_BINS:
            break
        straight = _Trial.straight(seen, structure, edge=edge, shortest=max(SHORTEST / edge, slowest))
        tried.append(straight)
        if straight.is_sound(most=_SOUND, bend=_BEND):
            time = straight.masking(rounding)
            if not time:
                return replace(_band_below(coarse, straight), masked=masked)
            masked = time
            slowest = max(slowest, _SLOWER * time)
            straight = _Trial.straight(seen, structure, edge=edge, shortest=max(SHORTEST / edge, slowest))
        bent = straight.bent()
        tried.append(bent)
        if bent.is_sound(most=_SOUND, bend=_BEND) and not bent.rises:
            time = bent.masking(rounding)
            if not time:
                return replace(_band_below(coarse, bent), masked=masked)
            masked = time
            slowest = max(slowest, _SLOWER * time)
    if not tried:
        return Band()
    least_bad = min(tried, key=lambda one: one.statistic)
    return replace(least_bad.band(), masked=masked)


def _band_below(coarse: Ordinates, trial: _Trial) -> Band:
    """Return the band of a sound trial, with one more coefficient, and what is seen above it."""
    beta = trial.fit.beta[0]
    noise = coarse.size * trial.fit.unfiltered(coarse)
    octaves = np.log2(coarse.fraction / trial.edge)
    near = (octaves > 0) & (octaves <= _RISING)
    rise = _rise(2 * octaves[near], coarse.rest(beta)[near], noise[near], coarse.size[near])
    bent = trial.bent()
    corner = None
    if not rise:
        corner = _corner_of_bend(bent)
    if not rise and corner is None:
        corner = _corner_above(octaves, coarse.rest(beta), noise, coarse.size, edge=trial.edge)
    return replace(bent.band(), rise=rise, corner=corner)


def _rise(cells: FloatArray, power: FloatArray, noise: FloatArray, size: FloatArray) -> float:
    """Return the largest density above the edge, relative to the noise without a bend; 0 if it is no rise."""
    cell = np.floor(cells).astype(np.int64)
    count = np.bincount(cell, size)
    known = count > 0
    ratio = np.bincount(cell, power)[known] / np.bincount(cell, noise)[known]
    excess = ratio - 1 - _RISE - _BY_CHANCE * np.sqrt(2 / count[known])
    return float(ratio[np.argmax(excess)]) if np.max(excess, initial=-1.0) > 0 else 0.0


def _corner_of_bend(bent: _Trial) -> float | None:
    """Return where the fitted bend falls to half, as a fraction of Nyquist; None if it does not."""
    fraction = np.linspace(0.0, bent.edge, 2001)[1:]
    x = 4 * np.sin(np.pi / 2 * fraction) ** 2 / bent.seen.top
    inverse = 1 + x[:, None] ** np.arange(1, bent.curvature.size + 1) @ bent.curvature
    below = np.flatnonzero(inverse > 1 / _HALF)
    return float(fraction[below[0]]) if below.size else None


def _corner_above(
    octaves: FloatArray, power: FloatArray, noise: FloatArray, size: FloatArray, *, edge: float
) -> float | None:
    """Return where the density falls to half of the noise without a bend; None if it does not.

    `octaves` are above the edge. Neighbouring cells are interpolated.
    """
    cell = np.floor(octaves / _CELL).astype(np.int64)
    cell -= cell.min()
    total = np.bincount(cell, noise)
    known = np.bincount(cell, size) >= _KNOWN
    ratio = np.bincount(cell, power)[known] / total[known]
    middle = np.bincount(cell, noise * octaves)[known] / total[known]
    below = np.flatnonzero((ratio < _HALF) & (middle > -_CELL))
    if not below.size or below[0] == 0:
        return None
    last = int(below[0])
    share = (ratio[last - 1] - _HALF) / (ratio[last - 1] - ratio[last])
    return float(edge * 2.0 ** (middle[last - 1] + share * (middle[last] - middle[last - 1])))
