"""Values and limits of quantities that are linear in the squared coefficients of a fit, such as a psd.

The limits follow from the limits of the coefficients by the method of variance estimates recovery (MOVER):
the distances of each term's share to its own limits are added as a quadratic form with the fit's
correlations.

Source: Zou & Donner (2008), "Construction of confidence limits about effect measures: a general approach",
Statistics in Medicine 27, 1693.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from statistics import NormalDist
from typing import NamedTuple, TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError
from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, GaussMarkov

#: Function of a term that is linear in the squared coefficient.
Quantity: TypeAlias = Callable[[NoiseTerm], FloatArray]

#: Least number of blocks of the coast and of the rest.
_BLOCKS = 120
#: Largest number of blocks of both together, which limits memory and time.
_MAX_BLOCKS = 1 << 18
#: Largest number of block sizes to try.
_TRIED = 50
#: Limits of a correlation time are clipped to this share and its inverse.
_SHORTEST_TIME = 1 / 30
#: Number of integrals of the sensor's output: from rate to angle, from acceleration to position, and from
#: rate through a tilt to position.
ANGLE = 1
POSITION = 2
TILT = 3


class Caution(NamedTuple):
    """How far a term is moved from its value to its limit, as a share of the distance in power.

    `bounded` applies to terms with an upper bound only; `shown` to terms with a value.
    """

    bounded: float
    shown: float

    @classmethod
    def at(cls, level: float, limits: float) -> "Caution":
        """Return the shares for a one-sided `level`, if the fit's limits have the level `limits`.

        The error of a shown term is taken as normal, that of a bounded term as half-normal.
        """
        normal = NormalDist()
        whole = normal.inv_cdf((1 + limits) / 2)
        return cls(normal.inv_cdf((1 + level) / 2) / whole, normal.inv_cdf(level) / whole)


#: The limits themselves.
LIMITS = Caution(1.0, 1.0)
#: Mean of a half-normal deviate divided by its 95 % quantile.
MEAN = Caution(math.sqrt(2 / math.pi) / NormalDist().inv_cdf(0.975), 0.0)


#: Name of a parameter of the fit, or empty; change of the quantity if it goes to its limit.
_Excursion: TypeAlias = tuple[str, FloatArray]


def modelled(fit: NoiseFit, of: Quantity) -> FloatArray:
    """Return a quantity of the fitted model, shape as `of` returns it."""
    parts = list(shares(fit, of).values())
    return np.sum(parts, axis=0) if parts else 0.0 * of(TERMS["N"].of(0.0))


def shares(fit: NoiseFit, of: Quantity) -> dict[str, FloatArray]:
    """Return each term's part of a quantity of the fitted model, by the estimates' keys."""
    return {e.key: of(_term(e, e.value)) for e, held in _held(fit) if held and e.value is not None}


def upper_limit(fit: NoiseFit, of: Quantity, caution: Caution = LIMITS) -> FloatArray:
    """Return the upper limit of a quantity, shape as `of` returns it; by default at the fit's level."""
    return modelled(fit, of) + _joint(fit, _excursions(fit, of, caution, up=True))


def lower_limit(fit: NoiseFit, of: Quantity) -> FloatArray:
    """Return the lower limit of a quantity at the fit's level, at least 0, shape as `of` returns it."""
    return np.maximum(modelled(fit, of) - _joint(fit, _excursions(fit, of, LIMITS, up=False)), 0.0)


def coasting_variance(
    term: NoiseTerm, times_s: FloatArray, *, rest_s: float, rate_hz: float, integrals: int = ANGLE
) -> FloatArray:
    """Return the variance of the error after coasting, shape (t,), in (U s^integrals)².

    The bias is the mean of a rest of `rest_s`. The samples of a term minus the bias are then integrated
    `integrals` times over `times_s`, shape (t,). Times that are not positive raise a ValueError.

    The error is a sum of samples with weights w of sum zero. Its variance is -w/2' D w with the mean square
    differences D, whose second sums V(n) are `sum_variance` of the term. Blocks of samples shorten the sum.
    """
    times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
    if not (np.all(times > 0) and rest_s > 0):
        raise ArgumentError(f"times of coasting and resting must be positive, got {times_s} and {rest_s}")
    return np.array([_coasting(term, float(t), rest_s, rate_hz, integrals) for t in times])


def _coasting(term: NoiseTerm, coast_s: float, rest_s: float, rate_hz: float, integrals: int) -> float:
    coast, rest = (max(1, round(t * rate_hz)) for t in (coast_s, rest_s))
    largest = max(1, round(min(coast, rest) / _BLOCKS), math.ceil((coast + rest) / _MAX_BLOCKS))
    # The block size that divides rest and coast with the least remainder.
    sizes = range(largest, largest // 2, -1)[:_TRIED]
    size = min(sizes, key=lambda size: sum(abs(round(n / size) * size - n) / n for n in (coast, rest)))
    resting, coasting = (max(1, round(n / size)) for n in (rest, coast))
    blocks = resting + coasting
    # Covariances of the sums; a constant cancels.
    V = term.sum_variance(np.arange(blocks + 1.0) * size, 1 / rate_hz) / rate_hz**2
    covariance = np.concatenate([V[1:2], (V[2:] - 2 * V[1:-1] + V[:-2]) / 2])
    left = (coasting - 0.5 - np.arange(coasting)) * size / rate_hz
    weights = np.concatenate([np.zeros(resting), left ** (integrals - 1) / math.factorial(integrals - 1)])
    weights[:resting] = -weights.sum() / resting
    # The quadratic form of a Toeplitz matrix by transforms.
    length = 1 << (2 * blocks).bit_length()
    circulant = np.concatenate([covariance, np.zeros(length - 2 * blocks + 1), covariance[:0:-1]])
    power = np.abs(np.fft.rfft(weights, length)) ** 2 * np.fft.rfft(circulant).real
    return max(float(power[0] + 2 * power[1:-1].sum() + power[-1]) / length, 0.0)


def _held(fit: NoiseFit) -> Iterator[tuple[Estimate, bool]]:
    """Yield the estimates and whether the model contains them, bounded ones with the model's value.

    An estimate with a value that is not in the model describes the same noise as terms of the model.
    """
    drawn = fit.terms_in_model
    for estimate in fit.estimates:
        value = estimate.in_model
        if estimate.value is not None or value is None or not math.isfinite(estimate.high):
            yield estimate, value is not None
            continue
        times = (Interval(value=t, low=t, high=t) for t in drawn[estimate.key].values[1:])
        time, high = estimate.correlation_time or next(times, None), max(estimate.high, value)
        yield replace(estimate, status="estimated", value=value, high=high, correlation_time=time), True


def _term(estimate: Estimate, coefficient: float, time: float | None = None) -> NoiseTerm:
    """Return the term of an estimate with another coefficient or time.

    Flicker covers a bounded Gauss-Markov term for every T, since the maximum of 2 sigma² T / (1 + omega² T²)
    over all T is sigma² / omega.
    """
    if estimate.correlation_time is not None:
        return TERMS[estimate.symbol].of(coefficient, time or estimate.correlation_time.value)
    symbol = "B" if estimate.symbol == GaussMarkov.symbol else estimate.symbol
    return TERMS[symbol].of(coefficient)


def _excursions(fit: NoiseFit, of: Quantity, caution: Caution, *, up: bool) -> Iterator[_Excursion]:
    """Yield how far each term moves a quantity up or down; for a time, negative if its lower limit does."""
    for estimate, held in _held(fit):
        value, time, sign = estimate.value, estimate.correlation_time, 1.0 if up else -1.0
        if value is None:
            if up and caution.bounded and 0 < estimate.high < math.inf:
                yield "", caution.bounded * of(_term(estimate, estimate.high))
            continue
        if not (caution.shown and (held or up)):
            continue
        if not held:
            beyond = of(_term(estimate, estimate.high)) - modelled(fit, of)
            yield "", caution.shown * np.maximum(beyond, 0.0)
            continue
        own, end = of(_term(estimate, value)), estimate.high if up else estimate.low
        # If a term has no upper limit, the quantity has none.
        beyond = sign * (of(_term(estimate, end)) - own) if end < math.inf else np.full_like(own, math.inf)
        names = TERMS[estimate.symbol].parameter_names(estimate.key)
        yield names[0], caution.shown * beyond
        if time is not None:
            high = min(max(time.high, time.value), time.value / _SHORTEST_TIME)
            low = max(min(time.low, time.value), time.value * _SHORTEST_TIME)
            longer, shorter = (sign * (of(_term(estimate, value, t)) - own) for t in (high, low))
            by = np.where(longer > 0, longer, np.where(shorter > 0, -shorter, 0.0))
            yield names[-1], caution.shown * by


def _joint(fit: NoiseFit, excursions: Iterator[_Excursion]) -> FloatArray:
    """Return the root of the excursions' quadratic form with the fit's correlations."""
    found = list(excursions)
    if not found:
        return np.zeros(())
    place = {name: i for i, name in enumerate(fit.parameters)}
    at = [place.get(name, -1) for name, _ in found]
    form = np.eye(len(found))
    if fit.parameters:
        known = np.nan_to_num(fit.correlation)
        form += [[known[i, j] * (i >= 0 <= j and i != j) for j in at] for i in at]
    by = np.stack(np.broadcast_arrays(*(by for _, by in found)))
    unknown = np.isinf(by).any(axis=0)
    by = np.where(unknown, 0.0, by)
    square: FloatArray = np.einsum("i...,ij,j...->...", by, form, by)
    return np.where(unknown, math.inf, np.sqrt(np.maximum(square, 0.0)))
