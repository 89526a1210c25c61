"""The part of the spectrum to fit, and the response of the output filter in it.

A response multiplies the spectrum of the noise:

    |H|² = (1 - lam/4)^z / (1 + a_1 x + … + a_j x^j),   x = lam / top,  lam = 4 sin²(theta/2).

It is exact for every all-pole filter of order j (z = 0) and, by the bilinear transform, for every Butterworth
filter (z = j). The gain at zero frequency is 1, so that N keeps its meaning.
"""

from dataclasses import replace
from math import comb
from typing import TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.disturbances.hump import Hump, hump_finding
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import COLUMN, SHORTEST
from imucal.fitting.spectral.ordinates import Ordinates, band_top
from imucal.frozen import frozen_alone

_NUMBER = ("no", "one", "two", "three", "four", "five")
#: Largest difference of |H|² from a Butterworth filter's.
_SAME_RESPONSE = 0.02
#: Lowest and highest starting corner, as fractions of the band, and number of corners.
CORNERS = (0.03, 0.97, 24)
#: Number of bins that show the highest frequencies of the band.
HIGHEST = 8

#: Poles and zeros of a response.
Order: TypeAlias = tuple[int, int]


@frozen_alone
class Band:
    """The part of the spectrum to fit, up to a `fraction` of Nyquist, and the response there.

    `order` has the poles and zeros of the simplest sound response. The response to fit has `poles` and
    `zeros`, one order more, or 0 if it is flat. Correlation times are at least `shortest` samples. `masked`
    is the correlation time, in samples, of a term that could explain the spectrum instead of the filter, or
    0. The bins of a `hump` are excluded.
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
        """Whether it is the whole spectrum without a response or hump."""
        return self.poles == 0 and self.fraction == 1.0 and self.hump is None

    def holds(self, ordinates: Ordinates) -> BoolArray:
        fraction = ordinates.fraction
        inside = fraction <= self.fraction * (1 + 1e-9)
        if self.hump:
            inside &= self.hump.outside(fraction)
        return inside

    def select(self, ordinates: Ordinates) -> Ordinates:
        """Return the bins of the band that are not empty."""
        return replace(ordinates[self.holds(ordinates) & (ordinates.size > 0)], top=band_top(self.fraction))


def response_of(fitted: Fits, band: Band, rate_hz: float) -> Response | None:
    """Return the filter's kind and -3 dB corner, or None if the corner is not in the band."""
    frequency, power, corner = _fitted_response(fitted, band)
    if not band.order[0] or corner is None:
        return None
    return Response(kind=_kind(band, frequency, power, corner), cutoff_hz=corner * rate_hz / 2)


def corner_of(band: Band) -> float | None:
    """Return the -3 dB corner of a band's response, as a fraction of Nyquist."""
    return _response(band, band.response, band.zeros)[2] if band.order[0] else None


def _fitted_response(fitted: Fits, band: Band) -> tuple[FloatArray, FloatArray, float | None]:
    models = fitted.models
    response = fitted.theta[0, models.response :][: int(models.poles[0])]
    return _response(band, response, int(models.zeros[0]))


def _response(band: Band, response: FloatArray, zeros: int) -> tuple[FloatArray, FloatArray, float | None]:
    """Return frequencies of the band as fractions of Nyquist, their |H|², and the corner."""
    frequency = np.linspace(0.0, band.fraction, 2001)[1:]
    power = power_response(4 * np.sin(np.pi / 2 * frequency) ** 2, band_top(band.fraction), response, zeros)
    below = np.flatnonzero(power < 0.5)
    return frequency, power, float(frequency[below[0]]) if below.size else None


def power_response(lam: FloatArray, top: float, response: FloatArray, zeros: int) -> FloatArray:
    """Return |H|² at `lam`, for the coefficients a, shape (poles,)."""
    denominator = 1 + (lam[:, None] / top) ** np.arange(1, response.size + 1) @ response
    return np.asarray(np.maximum(1 - lam / 4, 0.0) ** zeros / denominator)


def _kind(band: Band, frequency: FloatArray, power: FloatArray, corner: float) -> str:
    """Return the name of the family, such as ``one-pole`` or ``butterworth-2``."""
    poles, zeros = band.order
    used = frequency < 0.98
    if zeros == poles:
        ratio = np.tan(np.pi / 2 * frequency[used]) / np.tan(np.pi / 2 * corner)
        if np.max(np.abs(power[used] - 1 / (1 + ratio ** (2 * poles)))) < _SAME_RESPONSE:
            return f"butterworth-{poles}"
    name = f"{_NUMBER[poles]}-pole"
    return name if not zeros else f"{name} {_NUMBER[zeros]}-zero"


def filter_finding(
    fitted: Fits, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> tuple[Finding, ...]:
    """Return the finding about an output filter or a hump."""
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
    of_filter, time_s = "", band.masked / rate_hz
    if response:
        of_filter = f" ({response.kind}, -3 dB at {response.cutoff_hz:.3g} Hz)"
        time_s = 1 / (2 * np.pi * response.cutoff_hz)
    less = "far less than"
    if band.fraction == 1.0:
        seen = fitted.spectrum[0, -HIGHEST:].mean()
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
    seen: Ordinates, low: FloatArray, order: Order, *, width: int, room: int, lowest: float = CORNERS[0]
) -> FloatArray:
    """Return starting parameters, shape (1, p): the given slow terms, and a response from the spectrum.

    The first `width` columns of `low` contain the slow terms. Above `lowest`, a fraction of Nyquist,
    numerator / S = (1 + sum a_i x^i) / N² is a linear regression. If its result is not positive, use the best
    Butterworth response.
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
        # Positive in every bin, but not at zero frequency.
        solution = _flattest(seen, high, numerator, order, lowest)
    theta[0, 1] = -np.log(solution[0])
    theta[0, width : width + poles] = solution[1:] / solution[0]
    return theta


def _flattest(
    seen: Ordinates, high: BoolArray, numerator: FloatArray, order: Order, lowest: float
) -> FloatArray:
    """Return the Butterworth response with the best corner, as coefficients of numerator / S."""
    poles, zeros = order
    x, best, solution = seen.lam / seen.top, np.inf, np.zeros(poles + 1)
    for corner in np.geomspace(lowest, *CORNERS[1:]):
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
