"""Which part of the spectrum a model can describe, and the output filter that shapes it.

Sensors filter their output. A model of noise alone can't describe a filtered spectrum, and a fit of
the whole band is then wrong in every term. Two remedies are tried together: a narrower band, and a
response that multiplies the spectrum,

    |H|² = (1 - lam/4)^z / (1 + a_1 x + … + a_j x^j),   x = lam / top,  lam = 4 sin²(theta/2),

which every all-pole filter of order j has exactly (z = 0: one-pole, cascades, resonances), and every
Butterworth filter by the bilinear transform (z = j); any other smooth low-pass is close to one
below its corner. DC gain is 1, so that N keeps its meaning.

A description is sound when the misfit is within chance and the next orders of the response add
nothing. Among the sound ones the one that tells N best is taken, and then one order more than it
needs, so that what the response can't follow does not bias N.

White noise behind a one-pole filter has exactly the spectrum of a Gauss-Markov term without white noise.
Every sensor has white noise. So, if a Gauss-Markov term makes up the top of the spectrum, the search is
repeated with correlation times that are too long to imitate a filter. If this finds a sound
description, N is the level in front of the filter, and a finding names both readings.

The bins of a hump, which vibration or sway makes, are left out.
"""

from collections.abc import Callable
from dataclasses import replace
from math import comb
from typing import TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.hump import Hump, find_hump, hump_finding
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.models import (
    COLUMN,
    SHORTEST,
    SHORTEST_GIVEN,
    Models,
    Structure,
    models_of,
    shaped_symbols,
)
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, band_top, coarser
from imucal.fitting.spectral.scoring import maximize, misfit
from imucal.fitting.spectral.starts import fit_blindly
from imucal.frozen import frozen_alone

_NUMBER = ("no", "one", "two", "three", "four", "five")
#: Largest difference of |H|² from a Butterworth filter's that is called one.
_ALIKE = 0.02
#: Lowest and highest of the corners that a response may start at, as fractions of the band, and their number.
_CORNERS = (0.03, 0.97, 24)

#: Poles and zeros of a response.
Order: TypeAlias = tuple[int, int]


#: Returns the variance of the samples' rounding, in scaled units.
Rounding: TypeAlias = Callable[[], float]


def _no_rounding() -> float:
    return 0.0


@frozen_alone
class Band:
    """The part of the spectrum to fit, up to a `fraction` of Nyquist, and the response there.

    `order` has the poles and zeros of the simplest response that is sound; `poles` and `zeros` are those of
    the one to fit, one more, 0 where it is flat, with coefficients a, shape (poles,).

    Gauss-Markov terms have correlation times of at least `shortest` samples. If such a term could explain
    the spectrum instead of a filter in front of it, `masked` is its correlation time in samples, else 0.
    The bins of a `hump` are left out. `statistic` is the misfit score.
    """

    fraction: float
    order: Order
    poles: int
    zeros: int
    response: FloatArray
    shortest: float = SHORTEST
    masked: float = 0.0
    hump: Hump | None = None
    statistic: float = 0.0

    @property
    def flat(self) -> bool:
        """Whether it is the whole spectrum, without a response or a hump."""
        return self.poles == 0 and self.fraction == 1.0 and self.hump is None

    def holds(self, ordinates: Ordinates) -> BoolArray:
        """Return which bins lie in the band, shape (b,)."""
        fraction = ordinates.fraction
        inside = fraction <= self.fraction * (1 + 1e-9)
        if self.hump:
            inside &= self.hump.outside(fraction)
        return inside

    def select(self, ordinates: Ordinates) -> Ordinates:
        """Return the bins of the band that hold any ordinate."""
        return replace(ordinates[self.holds(ordinates) & (ordinates.size > 0)], top=band_top(self.fraction))


def response_of(fitted: Fits, band: Band, rate_hz: float) -> Response | None:
    """Return the filter's kind and -3 dB corner, or None where it has none inside the band."""
    frequency, power, corner = _fitted_response(fitted, band)
    if not band.order[0] or corner is None:
        return None
    return Response(kind=_kind(band, frequency, power, corner), cutoff_hz=corner * rate_hz / 2)


def corner_of(band: Band) -> float | None:
    """Return the -3 dB corner of a band's response, as a fraction of Nyquist; None where it has none."""
    return _response(band, band.response, band.zeros)[2] if band.order[0] else None


def _fitted_response(fitted: Fits, band: Band) -> tuple[FloatArray, FloatArray, float | None]:
    """Return what `_response` does of the response that a fit has."""
    models = fitted.models
    response = fitted.theta[0, models.response :][: int(models.poles[0])]
    return _response(band, response, int(models.zeros[0]))


def _response(band: Band, response: FloatArray, zeros: int) -> tuple[FloatArray, FloatArray, float | None]:
    """Return fractions of Nyquist up to the band's end, |H|² there, shape (2000,) each, and the corner."""
    frequency = np.linspace(0.0, band.fraction, 2001)[1:]
    power = _power(4 * np.sin(np.pi / 2 * frequency) ** 2, band_top(band.fraction), response, zeros)
    below = np.flatnonzero(power < 0.5)
    return frequency, power, float(frequency[below[0]]) if below.size else None


def _power(lam: FloatArray, top: float, response: FloatArray, zeros: int) -> FloatArray:
    """Return |H|² at each of `lam`, shape (b,), of the coefficients a, shape (poles,)."""
    denominator = 1 + (lam[:, None] / top) ** np.arange(1, response.size + 1) @ response
    return np.asarray(np.maximum(1 - lam / 4, 0.0) ** zeros / denominator)


def _kind(band: Band, frequency: FloatArray, power: FloatArray, corner: float) -> str:
    """Return the name of the family, such as ``one-pole``, ``butterworth-2`` or ``three-pole``."""
    poles, zeros = band.order
    used = frequency < 0.98
    if zeros == poles:
        ratio = np.tan(np.pi / 2 * frequency[used]) / np.tan(np.pi / 2 * corner)
        if np.max(np.abs(power[used] - 1 / (1 + ratio ** (2 * poles)))) < _ALIKE:
            return f"butterworth-{poles}"
    name = f"{_NUMBER[poles]}-pole"
    return name if not zeros else f"{name} {_NUMBER[zeros]}-zero"


def filter_finding(
    fitted: Fits, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> tuple[Finding, ...]:
    """Return what is said about an output filter; nothing where the whole band is flat."""
    top = band.fraction * rate_hz / 2
    if band.flat:
        return ()
    if band.hump:
        return (hump_finding(band.hump, rate_hz=rate_hz, axis=axis, fitted=True),)
    if response is not None:
        text = (
            f"An output filter ({response.kind}, -3 dB at {response.cutoff_hz:.4g} Hz) shapes the spectrum; "
            f"its response is fitted with the noise up to {top:.4g} Hz."
        )
    elif band.order[0]:
        change = 10 * float(np.log10(_fitted_response(fitted, band)[1][-1]))
        why = "a resonance or a vibration" if change > 0 else "an output filter"
        text = (
            f"The white part of the spectrum is not flat ({change:+.1f} dB at {top:.4g} Hz: {why}); a "
            f"response is fitted with the noise up to {top:.4g} Hz."
        )
    else:
        text = f"A filter or a vibration shapes the spectrum above {top:.4g} Hz; the fit uses the rest."
    advice = "The model describes the noise before the filter, at times longer than the filter's."
    if band.masked:
        return (_two_readings(fitted, band, response, rate_hz=rate_hz, axis=axis),)
    return (Finding("info", "output-filter", text, advice, axis=axis),)


def _two_readings(
    fitted: Fits, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> Finding:
    """Return the warning for a spectrum that a filter and a Gauss-Markov term explain equally well."""
    of_filter, time_s = "", band.masked / rate_hz
    if response:
        of_filter = f" ({response.kind}, -3 dB at {response.cutoff_hz:.3g} Hz)"
        time_s = 1 / (2 * np.pi * response.cutoff_hz)
    less = "far less than"
    if band.fraction == 1.0:
        # The density at the highest frequencies, compared with that of N.
        seen = fitted.spectrum[0, -_TOP:].mean()
        below = float(np.sqrt(seen / np.exp(fitted.theta[0, COLUMN["N"]])))
        less = f"less than {below:.2g} times"
    text = (
        f"The spectrum has two explanations: white noise behind a low-pass filter{of_filter}, or a Gauss-"
        f"Markov term of T = {time_s:.3g} s whose white noise is too weak to see. The fit "
        f"assumes the filter. Without one, N would be {less} the reported value."
    )
    advice = (
        "Look for a low-pass filter or smoothing in the sensor's settings and in the driver. Switch it off "
        "and record again, or keep it and use this N."
    )
    return Finding("warning", "output-filter", text, advice, axis=axis)


def start_response(
    seen: Ordinates, low: FloatArray, order: Order, *, width: int, room: int, lowest: float = _CORNERS[0]
) -> FloatArray:
    """Return starting parameters, shape (1, p): slow terms as given, response from the spectrum.

    `low`, shape (1, >= width), holds the slow terms in its first `width` columns; `room` columns for
    the response follow. White noise dominates above `lowest`, a fraction of Nyquist.

    Where white noise dominates, numerator / S = (1 + sum a_i x^i) / N²: a linear regression in 1/N²
    and a/N². Where that is not positive, the flattest response 1 + c x^j that fits best.
    """
    poles, zeros = order
    theta = np.concatenate([low[:, :width], np.zeros((1, room))], axis=1)
    if not poles:
        return theta
    x = seen.lam / seen.top
    high = seen.fraction > min(lowest, 0.3 * float(seen.fraction.max()))
    numerator = np.maximum(1 - seen.lam / 4, 1e-12) ** zeros
    target = (numerator * seen.size / np.maximum(seen.power, 1e-300))[high]
    powers = x[:, None] ** np.arange(poles + 1)
    weight = np.sqrt(seen.size[high]) / target
    solution = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
    for _ in range(2):
        fitted = powers @ solution
        if np.any(fitted <= 0) or solution.sum() <= 0:
            solution = _flattest(seen, high, numerator, order, lowest)
            break
        weight = np.sqrt(seen.size[high]) / fitted[high]
        better = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
        if np.any(powers @ better <= 0) or better.sum() <= 0:
            break
        solution = better
    if solution[0] <= 0:
        # Positive in every bin, and not at zero frequency: no response.
        solution = _flattest(seen, high, numerator, order, lowest)
    theta[0, 1] = -np.log(solution[0])
    theta[0, width : width + poles] = solution[1:] / solution[0]
    return theta


def _flattest(
    seen: Ordinates, high: BoolArray, numerator: FloatArray, order: Order, lowest: float
) -> FloatArray:
    """Return the best of a row of Butterworth responses, as coefficients of numerator / S."""
    poles, zeros = order
    x, best, solution = seen.lam / seen.top, np.inf, np.zeros(poles + 1)
    for corner in np.geomspace(lowest, *_CORNERS[1:]):
        # |H|² = (1 - lam/4)^z / ((1 - lam/4)^z + c lam^j), one half at the corner.
        at = float(np.sin(np.pi / 2 * corner)) ** 2
        binomial = np.array([comb(zeros, i) * (-seen.top / 4) ** i for i in range(zeros + 1)])
        form = np.zeros(poles + 1)
        form[: zeros + 1] = binomial
        form[poles] += (1 - at) ** zeros * (seen.top / 4 / at) ** poles
        shape = numerator / (x[:, None] ** np.arange(poles + 1) @ form)
        ratio = (seen.power / shape)[high]
        level = ratio.sum() / seen.size[high].sum()
        cost = float(np.sum(seen.size[high] * np.log(level * shape[high]) + ratio / level))
        if cost < best:
            best, solution = cost, form / level
    return solution


#: Bands that are tried, as fractions of Nyquist.
BANDS = (
    1.0,
    0.9,
    0.7,
    0.5,
    0.35,
    0.25,
    0.18,
    0.125,
    0.09,
    0.0625,
    0.045,
    0.03125,
    0.022,
    0.016,
    0.011,
    0.008,
)
#: Slow terms are first fitted below this fraction of Nyquist, where most filters are flat.
_LOW = 0.03125
#: Misfit score below which a description is sound.
_SOUND = 3.0
#: The same for the whole band without a response, where no response would help.
_SOUND_FLAT = 4.0
#: Misfit score of the whole band above which a hump is looked for: one in 40 clean records.
_UNSURE = 2.0
#: Twice the log-likelihood that one, or two more orders of the response may gain by chance. A
#: filter where there is none costs N a factor of two, so the flat band has the benefit of the doubt.
_GAIN, _GAIN_FLAT = (9.0, 12.0), (12.0, 15.0)
#: Quantization noise and a response bend the same part of the spectrum: where quantization explains
#: it, a filter instead needs strong reasons.
_GAIN_QUANTIZED, _QUANTIZED = (30.0, 33.0), 0.2
#: Share of the highest frequencies' power from which a Gauss-Markov term hides the white noise.
_MASKING = 0.5
#: A Gauss-Markov term is compared with the rounding where its density is this many times the white noise's;
#: white noise of less than this many times the variance of the rounding is not the sensor's.
_ABOVE, _ROUNDED = 4.0, 3.0
#: A Gauss-Markov term that is this many times slower can't imitate the filter.
_SLOWER = 10.0
#: Highest number of poles.
_ORDERS = 5
#: Above this fraction of Nyquist a response's zeros show; at Nyquist itself they leave nothing.
_NARROW = 0.4
_ALL_POLES: list[Order] = [(poles, 0) for poles in range(_ORDERS + 1)]
_WITH_ZEROS: list[Order] = [
    *_ALL_POLES,
    *((z + more, z) for z in (1, 2, 3, 4) for more in (0, 1, 2) if z + more <= _ORDERS),
]
#: A band needs so many bins.
_FEWEST = 24
#: Bins of the highest frequencies.
_TOP = 8


@frozen_alone
class _Trial:
    """One description: band, order, fit, and how it does."""

    fraction: float
    order: Order
    fit: Fits
    statistic: float
    deviation: float


def find_band(
    ordinates: Ordinates,
    rich: Structure,
    *,
    given: Structure | None = None,
    near: float | None = None,
    rounding: Rounding = _no_rounding,
) -> Band:
    """Return the band, and the response in it, that a rich model describes, which holds all the candidates.

    Its correlation times are `SHORTEST` samples at least; its Q counts only where the response is flat,
    because both bend the top of the spectrum. Terms that the caller gave are believed where those with a
    time of any length describe the whole band beside white noise.
    Of ordinates that are known not to be flat the band up to `near`, a fraction of Nyquist, is tried first,
    and taken if it has a sound description.
    `rounding` returns the variance of the samples' rounding in scaled units.
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
    """Return the filter that explains the spectrum as well as a Gauss-Markov term that hides the noise."""
    if not found.masked:
        return None
    behind = _BandSearch(coarse, plain, _SLOWER * found.masked, rounding).sound(None)
    return replace(behind, masked=found.masked) if behind and not behind.masked else None


def _around_hump(coarse: Ordinates, rich: Structure, flat: Band | None) -> Band | None:
    """Return the whole band without a hump, if power laws describe it, and better than `flat` does."""
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
    """Return the whole band without a response, as `find_band`; None if the data ask for more."""
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
    """Fits of one structure to several bands with several responses."""

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
        """Return parameters of the best blind fit without a response, shape (1, p)."""
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
        """Fit one band with some responses, each from its row of `starts`, shape (k, p)."""
        every = maximize(seen, self.models(orders), starts, tolerance=tolerance, iterations=60)
        return [
            _Trial(
                fraction=fraction,
                order=order,
                fit=(found := every[[row]]),
                statistic=misfit(seen, found).statistic,
                deviation=_deviation_of_white(found),
            )
            for row, order in enumerate(orders)
        ]

    def flat(self) -> Band | None:
        """Return the whole band without a response; None if the data ask for more."""
        orders: list[Order] = [(0, 0), (1, 0), (2, 0)]
        start = np.repeat(self.blind(self.ordinates), 3, axis=0)
        # Gains of ten decide: they need no digits.
        trials = self.fit(self.ordinates, 1.0, orders, start, tolerance=1e-2)
        quantization = float(np.exp(trials[0].fit.theta[0, 0])) * self.ordinates.basis[0, -1]
        bent = "Q" in self.structure and quantization > _QUANTIZED * self.level_at_the_top()
        chance = _GAIN_QUANTIZED if bent else _GAIN_FLAT
        if not _enough(trials, chance, _SOUND_FLAT):
            # The richer fits may have found a better place for the slow terms: try it without them.
            again = np.concatenate([t.fit.theta for t in trials])
            again[:, self.width :] = 0.0
            flat = self.fit(self.ordinates, 1.0, [(0, 0)] * 3, again)
            trials[0] = min(flat, key=lambda t: t.fit.objective[0])
        return self.band(trials[0]) if _enough(trials, chance, _SOUND_FLAT) else None

    def level_at_the_top(self) -> float:
        """Return the mean square of the ordinates of the highest frequencies."""
        last = slice(-_TOP, None)
        return float(self.ordinates.power[last].sum() / self.ordinates.size[last].sum())

    def white_at_the_top(self) -> bool:
        """Whether white noise makes most of the blind fit's power at the highest frequencies."""
        return float(np.exp(self.blind(self.ordinates)[0, 1])) > 0.5 * self.level_at_the_top()

    def sound(self, near: float | None) -> Band | None:
        """Return a sound description `near`, the best sound one of all bands, or None."""
        narrow = self.ordinates.below(_LOW)
        low = self.blind(narrow if narrow.size.size >= _FEWEST else self.ordinates)
        if near is not None and (found := _simplest(self.responses(near, low))):
            return self.simplest(found)
        best: tuple[_Trial, _Trial] | None = None
        for fraction in BANDS:
            seen = self.ordinates.below(fraction)
            if seen.size.size < _FEWEST:
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
        """Return the description with the smallest misfit of those that were tried and are not sound."""
        return self.band(min(self.tried, key=lambda t: t.statistic))

    def responses(self, fraction: float, low: FloatArray) -> list[_Trial]:
        """Return the fits of one band with every order of the response that has a likelihood there."""
        seen = self.ordinates.below(fraction)
        orders = _WITH_ZEROS if _NARROW < fraction < 1 else _ALL_POLES
        lowest = min(_CORNERS[0], 1 / self.shortest)
        starts = [
            start_response(seen, low, order, width=self.width, room=_ORDERS, lowest=lowest)
            for order in orders
        ]
        fits = self.fit(seen, fraction, orders, np.concatenate(starts))
        return [t for t in fits if np.isfinite(t.fit.objective[0])]

    def simplest(self, found: tuple[_Trial, _Trial]) -> Band:
        """Return the band of a sound description: one order more than it needs, unless it is flat."""
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
        """Return the correlation time of the term that hides the white noise, in samples; 0 if none does."""
        found, seen = trial.fit, self.ordinates.below(trial.fraction)
        times = found.theta[0, found.models.variances : found.models.response]
        if not times.size:
            return 0.0
        # White noise is looked for where the response is flat.
        power = _power(seen.lam, seen.top, found.theta[0, self.width :], trial.order[1])
        parts = derivatives(seen, found.models, found.theta)[: found.models.variances, power > 0.5]
        white, shaped = parts[COLUMN["N"]], parts[SHAPED:]
        top = parts[:, -_TOP:].sum(axis=1)
        hidden = top[SHAPED:].sum() > _MASKING * top.sum()
        if not hidden and np.any(shaped > _ABOVE * white):
            # The white noise is visible, but it may be that of the rounding.
            hidden = float(np.exp(found.theta[0, COLUMN["N"]])) < _ROUNDED * self.rounding()
        return float(np.exp(times[np.argmax(top[SHAPED:])])) if hidden else 0.0


def _simplest(trials: list[_Trial]) -> tuple[_Trial, _Trial] | None:
    """Return the simplest sound description of a band, and its next order."""
    by_order = {t.order: t for t in trials}
    for poles, zeros in sorted(by_order, key=lambda order: (sum(order), order)):
        nested = [by_order[o] for more in range(3) if (o := (poles + more, zeros)) in by_order]
        if len(nested) > 1 and _enough(nested):
            return nested[0], nested[1]
    return None


def _enough(trials: list[_Trial], chance: tuple[float, float] = _GAIN, sound: float = _SOUND) -> bool:
    """Whether the first of nested trials is sound and the next orders gain no more than chance."""
    first = trials[0]
    gains = [2 * float(first.fit.objective[0] - t.fit.objective[0]) for t in trials[1:]]
    return first.statistic < sound and all(g < most for g, most in zip(gains, chance, strict=False))


def _deviation_of_white(fit: Fits) -> float:
    """Return the relative standard error of N; infinite if it is undetermined."""
    if not fit.models.has[0, COLUMN["N"]]:
        return float(np.inf)
    return 0.5 * float(np.sqrt(fit.covariance[1, 1]))
