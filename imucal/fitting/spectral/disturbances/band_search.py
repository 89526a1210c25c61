"""Search for the part of the spectrum and the response of the output filter that a model describes.

If a fit ignores the sensor's output filter, every term is wrong. The search combines a narrower band with a
response that multiplies the spectrum (`band`). It takes the sound description that determines N best, with
one order more than necessary, so that the remaining error of the response does not bias N.

White noise behind a one-pole filter has exactly the spectrum of a Gauss-Markov term without white noise, but
every sensor has white noise. So, if a Gauss-Markov term makes up the top of the spectrum, the search is
repeated with correlation times that are too long to imitate a filter.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.disturbances.band import (
    CORNERS,
    HIGHEST,
    Band,
    Order,
    power_response,
    start_response,
)
from imucal.fitting.spectral.disturbances.hump import find_hump
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.maximum import UNLIKELY, fit_blindly, maximize, misfit, octave_score
from imucal.fitting.spectral.models import (
    COLUMN,
    SHORTEST,
    SHORTEST_GIVEN,
    Models,
    Structure,
    models_of,
    shaped_symbols,
)
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, coarser
from imucal.frozen import frozen_alone

#: Returns the variance of the samples' rounding, in scaled units.
Rounding: TypeAlias = Callable[[], float]


def _no_rounding() -> float:
    return 0.0


#: Ends of the bands to try, as fractions of Nyquist.
BANDS = (
    1.0, 0.9, 0.7, 0.5, 0.35, 0.25, 0.18, 0.125, 0.09, 0.0625, 0.045, 0.03125, 0.022, 0.016, 0.011, 0.008
)  # fmt: skip
#: Fraction of Nyquist below which most filters are flat.
_LOW = 0.03125
#: Misfit score below which a description is sound; the same for a flat band.
_SOUND, _SOUND_FLAT = 3.0, 4.0
#: Misfit score from which a hump is searched.
_UNSURE = 2.0
#: Largest gain by chance of one and two more orders, in twice the log-likelihood; larger for a flat band,
#: because a filter that does not exist makes N wrong by a factor of two.
_GAIN, _GAIN_FLAT = (9.0, 12.0), (12.0, 15.0)
#: Gains that a filter needs if quantization has at least this share of the top: both bend it.
_GAIN_QUANTIZED, _QUANTIZED = (30.0, 33.0), 0.2
#: Share of the top above which a Gauss-Markov term hides the white noise.
_MASKING = 0.5
#: Density ratio of a Gauss-Markov term to the white noise above which the white noise may be rounding;
#: variance ratio to the rounding below which it is.
_ABOVE, _ROUNDED = 4.0, 3.0
#: Factor on the shortest correlation time of a term that can't imitate the filter.
_SLOWER = 10.0
#: Highest number of poles.
_ORDERS = 5
#: Fraction of Nyquist above which the zeros of a response are visible; at Nyquist the response is zero.
_NARROW = 0.4
_ALL_POLES: list[Order] = [(poles, 0) for poles in range(_ORDERS + 1)]
_WITH_ZEROS: list[Order] = [
    *_ALL_POLES,
    *((z + more, z) for z in (1, 2, 3, 4) for more in (0, 1, 2) if z + more <= _ORDERS),
]
#: Fewest bins of a band.
_MIN_BINS = 24


@frozen_alone
class _Trial:
    """One description of a band.

    `statistic` is its misfit score, `octaves` the probability of its octave score, and `deviation` the
    relative standard error of N.
    """

    fraction: float
    order: Order
    fit: Fits
    statistic: float
    octaves: float
    deviation: float

    def is_sound(self, limit: float) -> bool:
        return self.statistic < limit and self.octaves > UNLIKELY


def find_band(
    ordinates: Ordinates,
    rich: Structure,
    *,
    given: Structure | None = None,
    near: float | None = None,
    rounding: Rounding = _no_rounding,
) -> Band:
    """Return the band and response that a rich model describes, which contains all candidates.

    Q is only fitted without a response, because both bend the top of the spectrum. A `given` structure is
    preferred if it describes the whole band. A band up to `near`, a fraction of Nyquist, is tried first.
    """
    coarse = _coarse(ordinates)
    plain = tuple(symbol for symbol in rich if symbol != "Q")
    found = flat_band(ordinates, rich, given=given, rounding=rounding) if near is None else None
    # A Gauss-Markov term follows a weak hump, but not closely.
    unsure = found is None or found.statistic > _UNSURE
    if near is None and unsure and (around := _around_hump(coarse, rich, found)):
        return around
    if found is None:
        search = _BandSearch(coarse, plain, SHORTEST, rounding)
        found = search.sound(near) or search.least_bad()
    if near is not None or shaped_symbols(given or ()):
        return found
    return _as_a_filter(found, coarse, plain, rounding) or found


def _as_a_filter(found: Band, coarse: Ordinates, plain: Structure, rounding: Rounding) -> Band | None:
    if not found.masked:
        return None
    behind = _BandSearch(coarse, plain, _SLOWER * found.masked, rounding).sound(None)
    return replace(behind, masked=found.masked) if behind and not behind.masked else None


def _around_hump(coarse: Ordinates, rich: Structure, flat: Band | None) -> Band | None:
    """Return the whole band without a hump, or None."""
    laws = tuple(symbol for symbol in rich if symbol in {"N", "B", "K", "R"})
    hump = find_hump(coarse, laws) if "N" in laws else None
    if hump is None:
        return None
    around = _BandSearch(coarse[hump.outside(coarse.fraction)], laws, SHORTEST).flat()
    if around is None or (flat and around.statistic > flat.statistic - 1):
        return None
    return replace(around, hump=hump)


def flat_band(
    ordinates: Ordinates,
    rich: Structure,
    *,
    given: Structure | None = None,
    rounding: Rounding = _no_rounding,
) -> Band | None:
    """Return the whole band without a response, or None if the data need one."""
    coarse = _coarse(ordinates)
    if given is not None and shaped_symbols(given):
        own = _BandSearch(coarse, given, SHORTEST_GIVEN)
        flat = own.flat()
        if flat and (own.white_at_the_top() or "N" not in given):
            return flat
    return _BandSearch(coarse, rich, SHORTEST, rounding).flat()


def _coarse(ordinates: Ordinates) -> Ordinates:
    return coarser(ordinates.below(1.0), singles=48, merge=3)


class _BandSearch:
    """Fits of one structure to several bands and responses."""

    def __init__(
        self, ordinates: Ordinates, structure: Structure, shortest: float, rounding: Rounding = _no_rounding
    ) -> None:
        self.ordinates, self.structure, self.shortest = ordinates, structure, shortest
        self.rounding = rounding
        self.width = self.models([(0, 0)]).response
        self.tried: list[_Trial] = []

    def models(self, orders: list[Order]) -> Models:
        return models_of(
            [self.structure] * len(orders),
            self.ordinates.names,
            poles=[poles for poles, _ in orders],
            zeros=[zeros for _, zeros in orders],
            room_poles=_ORDERS,
            shortest=self.shortest,
        )

    def blind(self, seen: Ordinates) -> FloatArray:
        models = self.models([(0, 0)])
        return fit_blindly(seen, models, keep=(1, 2, 4), tolerance=1e-3).theta

    def fit(
        self,
        seen: Ordinates,
        fraction: float,
        orders: list[Order],
        starts: FloatArray,
        *,
        tolerance: float = 1e-3,
    ) -> list[_Trial]:
        """Fit one band with some responses, each from its row of `starts`."""
        every = maximize(seen, self.models(orders), starts, tolerance=tolerance, iterations=60)
        return [
            _Trial(
                fraction=fraction,
                order=order,
                fit=(found := every[[row]]),
                statistic=misfit(seen, found).statistic,
                octaves=octave_score(seen, found),
                deviation=_deviation_of_white(found),
            )
            for row, order in enumerate(orders)
        ]

    def flat(self) -> Band | None:
        orders: list[Order] = [(0, 0), (1, 0), (2, 0)]
        start = np.repeat(self.blind(self.ordinates), 3, axis=0)
        # A coarse tolerance is enough: gains of about ten decide.
        trials = self.fit(self.ordinates, 1.0, orders, start, tolerance=1e-2)
        quantization = float(np.exp(trials[0].fit.theta[0, 0])) * self.ordinates.basis[0, -1]
        bent = "Q" in self.structure and quantization > _QUANTIZED * self.level_at_the_top()
        chance = _GAIN_QUANTIZED if bent else _GAIN_FLAT
        if not _enough(trials, chance, _SOUND_FLAT):
            # The richer fits may have found better slow terms.
            again = np.concatenate([t.fit.theta for t in trials])
            again[:, self.width :] = 0.0
            flat = self.fit(self.ordinates, 1.0, [(0, 0)] * 3, again)
            trials[0] = min(flat, key=lambda t: t.fit.objective[0])
        return self.band(trials[0]) if _enough(trials, chance, _SOUND_FLAT) else None

    def level_at_the_top(self) -> float:
        last = slice(-HIGHEST, None)
        return float(self.ordinates.power[last].sum() / self.ordinates.size[last].sum())

    def white_at_the_top(self) -> bool:
        return float(np.exp(self.blind(self.ordinates)[0, 1])) > 0.5 * self.level_at_the_top()

    def sound(self, near: float | None) -> Band | None:
        """Return a sound description that ends at `near`, or the best of all bands."""
        narrow = self.ordinates.below(_LOW)
        low = self.blind(narrow if narrow.size.size >= _MIN_BINS else self.ordinates)
        if near is not None and (found := _simplest(self.responses(near, low))):
            return self.simplest(found)
        best: tuple[_Trial, _Trial] | None = None
        for fraction in BANDS:
            seen = self.ordinates.below(fraction)
            if seen.size.size < _MIN_BINS:
                break
            if best is not None and best[0].deviation < np.sqrt(0.5 / seen.count):
                break
            trials = self.responses(fraction, low)
            self.tried += trials
            found = _simplest(trials)
            if found is not None and (best is None or found[0].deviation < best[0].deviation):
                best = found
        return self.simplest(best) if best else None

    def least_bad(self) -> Band:
        return self.band(min(self.tried, key=lambda t: t.statistic))

    def responses(self, fraction: float, low: FloatArray) -> list[_Trial]:
        seen = self.ordinates.below(fraction)
        orders = _WITH_ZEROS if _NARROW < fraction < 1 else _ALL_POLES
        lowest = min(CORNERS[0], 1 / self.shortest)
        starts = [
            start_response(seen, low, order, width=self.width, room=_ORDERS, lowest=lowest)
            for order in orders
        ]
        fits = self.fit(seen, fraction, orders, np.concatenate(starts))
        return [t for t in fits if np.isfinite(t.fit.objective[0])]

    def simplest(self, found: tuple[_Trial, _Trial]) -> Band:
        """Return the band of a sound description, with one order more unless it is flat."""
        simplest, richer = found
        flat = simplest.order == (0, 0) and simplest.fraction == 1.0
        return self.band(simplest if flat else richer, simplest.order)

    def band(self, trial: _Trial, simplest: Order | None = None) -> Band:
        poles, zeros = trial.order
        return Band(
            fraction=trial.fraction,
            order=simplest or trial.order,
            poles=poles,
            zeros=zeros,
            response=trial.fit.theta[0, self.width : self.width + poles],
            shortest=self.shortest,
            masked=self.masked(trial),
            statistic=trial.statistic,
        )

    def masked(self, trial: _Trial) -> float:
        """Return the correlation time, in samples, of the term that hides the white noise, or 0."""
        found, seen = trial.fit, self.ordinates.below(trial.fraction)
        times = found.theta[0, found.models.variances : found.models.response]
        if not times.size:
            return 0.0
        # Compare where the response is flat.
        power = power_response(seen.lam, seen.top, found.theta[0, self.width :], trial.order[1])
        parts = derivatives(seen, found.models, found.theta)[: found.models.variances, power > 0.5]
        white, shaped = parts[COLUMN["N"]], parts[SHAPED:]
        top = parts[:, -HIGHEST:].sum(axis=1)
        hidden = top[SHAPED:].sum() > _MASKING * top.sum()
        if not hidden and np.any(shaped > _ABOVE * white):
            hidden = float(np.exp(found.theta[0, COLUMN["N"]])) < _ROUNDED * self.rounding()
        return float(np.exp(times[np.argmax(top[SHAPED:])])) if hidden else 0.0


def _simplest(trials: list[_Trial]) -> tuple[_Trial, _Trial] | None:
    """Return the simplest sound description of a band and the one with the next order."""
    by_order = {t.order: t for t in trials}
    for poles, zeros in sorted(by_order, key=lambda order: (sum(order), order)):
        nested = [by_order[o] for more in range(3) if (o := (poles + more, zeros)) in by_order]
        if len(nested) > 1 and _enough(nested):
            return nested[0], nested[1]
    return None


def _enough(trials: list[_Trial], chance: tuple[float, float] = _GAIN, sound: float = _SOUND) -> bool:
    first = trials[0]
    gains = [2 * float(first.fit.objective[0] - t.fit.objective[0]) for t in trials[1:]]
    return first.is_sound(sound) and all(g < most for g, most in zip(gains, chance, strict=False))


def _deviation_of_white(fit: Fits) -> float:
    if not fit.models.has[0, COLUMN["N"]]:
        return float(np.inf)
    return 0.5 * float(np.sqrt(fit.covariance[1, 1]))
