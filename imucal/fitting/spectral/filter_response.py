"""The output filter: the band of a fit and the response in it, its starting values, and its name."""

from dataclasses import dataclass
from math import comb
from typing import TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.estimates import Fitted
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates

_NUMBER = ("no", "one", "two", "three", "four", "five")
#: Largest difference of |H|² from a Butterworth filter's that is called one.
_ALIKE = 0.02
#: Lowest and highest of the corners that a response may start at, as fractions of the band, and their number.
_CORNERS = (0.03, 0.97, 24)

#: Poles and zeros of a response.
Order: TypeAlias = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """The part of the spectrum to fit, and the response there.

    Attributes
    ----------
    fraction
        Its upper end as a fraction of Nyquist.
    order
        Poles and zeros of the simplest response that is sound.
    poles, zeros
        Order of the response to fit, 0 where it is flat: one more than the simplest.
    response
        Its coefficients a, shape (poles,).
    """

    fraction: float
    order: Order
    poles: int
    zeros: int
    response: FloatArray


def response_of(ordinates: Ordinates, fitted: Fitted, band: Band, rate_hz: float) -> Response | None:
    """Return the filter's kind and -3 dB corner, or None where it has none inside the band."""
    if not band.order[0]:
        return None
    frequency = np.linspace(0.0, band.fraction, 2001)[1:]
    power = _power(ordinates, fitted, frequency)
    below = np.flatnonzero(power < 0.5)
    if not below.size:
        return None
    corner = float(frequency[below[0]])
    return Response(kind=_kind(band, frequency, power, corner), cutoff_hz=corner * rate_hz / 2)


def _power(ordinates: Ordinates, fitted: Fitted, frequency: FloatArray) -> FloatArray:
    """Return |H|² at fractions of Nyquist."""
    lam = 4 * np.sin(np.pi / 2 * frequency) ** 2
    poles, zeros = int(fitted.candidate.poles[0]), int(fitted.candidate.zeros[0])
    first = MARKOV + 2 * fitted.candidate.room_markov
    response = fitted.maximum.theta[0, first : first + poles]
    denominator = 1 + (lam[:, None] / ordinates.top) ** np.arange(1, poles + 1) @ response
    power: FloatArray = (1 - lam / 4) ** zeros / denominator
    return power


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
    ordinates: Ordinates, fitted: Fitted, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> tuple[Finding, ...]:
    """Return what is said about an output filter; nothing where the whole band is flat."""
    top = band.fraction * rate_hz / 2
    if band.poles == 0 and band.fraction == 1.0:
        return ()
    if response is not None:
        text = (
            f"An output filter ({response.kind}, -3 dB at {response.cutoff_hz:.4g} Hz) shapes the spectrum; "
            f"its response is fitted with the noise up to {top:.4g} Hz."
        )
    elif band.order[0]:
        change = 10 * float(np.log10(_power(ordinates, fitted, np.array([band.fraction]))[0]))
        why = "a resonance or a vibration" if change > 0 else "an output filter"
        text = (
            f"The spectrum is not flat where its noise is white ({change:+.1f} dB at {top:.4g} Hz: {why}); "
            f"a response is fitted with the noise up to {top:.4g} Hz."
        )
    else:
        text = (
            f"Above {top:.4g} Hz an output filter, or a vibration, shapes the spectrum; "
            "the fit uses what is below."
        )
    return (
        Finding(
            level="info",
            code="output-filter",
            axis=axis,
            text=text,
            advice="The model is that of the noise before the filter, right at times beyond the filter's.",
        ),
    )


def start_response(seen: Ordinates, low: FloatArray, order: Order, *, width: int, room: int) -> FloatArray:
    """Return starting parameters, shape (1, p): slow terms as given, response from the spectrum.

    `low`, shape (1, >= width), holds the slow terms in its first `width` columns; `room` columns for
    the response follow.

    Where white noise dominates, numerator / S = (1 + sum a_i x^i) / N²: a linear regression in 1/N²
    and a/N². Where that is not positive, the flattest response 1 + c x^j that fits best.
    """
    poles, zeros = order
    theta = np.concatenate([low[:, :width], np.zeros((1, room))], axis=1)
    if not poles:
        return theta
    x = seen.lam / seen.top
    high = seen.fraction > min(0.03, 0.3 * float(seen.fraction.max()))
    numerator = np.maximum(1 - seen.lam / 4, 1e-12) ** zeros
    target = (numerator * seen.size / np.maximum(seen.power, 1e-300))[high]
    powers = x[:, None] ** np.arange(poles + 1)
    weight = np.sqrt(seen.size[high]) / target
    solution = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
    for _ in range(2):
        fitted = powers @ solution
        if np.any(fitted <= 0) or solution.sum() <= 0:
            solution = _flattest(seen, high, numerator, order)
            break
        weight = np.sqrt(seen.size[high]) / fitted[high]
        better = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
        if np.any(powers @ better <= 0) or better.sum() <= 0:
            break
        solution = better
    if solution[0] <= 0:
        # Positive in every bin, and not at zero frequency: no response.
        solution = _flattest(seen, high, numerator, order)
    theta[0, 1] = -np.log(solution[0])
    theta[0, width : width + poles] = solution[1:] / solution[0]
    return theta


def _flattest(seen: Ordinates, high: BoolArray, numerator: FloatArray, order: Order) -> FloatArray:
    """Return the best of a row of Butterworth responses, as coefficients of numerator / S."""
    poles, zeros = order
    x, best, solution = seen.lam / seen.top, np.inf, np.zeros(poles + 1)
    for corner in np.geomspace(*_CORNERS):
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
