"""The variance of anything summed up of a sensor's noise, by a fit: its value and its limits.

A psd, an Allan variance, the variance of an angle after a minute of coasting: each is linear in the
squares of the terms' coefficients, so each is a sum over the terms. Its limits follow from the limits of
the coefficients by the method of variance estimates recovery: the distances of each term's share to
its own limits, added as a quadratic form with the fit's correlations.

Source: Zou & Donner (2008), "Construction of confidence limits about effect measures: a general
approach", Statistics in Medicine 27, 1693.
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

#: What is asked of a term: a value, or one for each time or frequency, linear in its coefficient's square.
Quantity: TypeAlias = Callable[[NoiseTerm], FloatArray]

#: A coast, and the rest before it, are made of so many blocks at least; both together of at most so many.
_BLOCKS, _MOST_BLOCKS = 120, 1 << 18
#: Most sizes of a block that are tried: among so many, one leaves less than 1e-3 over.
_TRIED = 50
#: A correlation time's lower limit counts down to this share of it: below, the term is white noise.
_SHORTEST_TIME = 1 / 30
#: Integrals of a rate that an error is: the sensor once, twice, three times.
ANGLE, POSITION, TILT = 1, 2, 3


class Caution(NamedTuple):
    """How far towards its limit a term counts, as a share of the way in power.

    `bounded` is that of a term that the data do not show, whose value is 0, `shown` of one that they show.
    """

    bounded: float
    shown: float

    @classmethod
    def at(cls, level: float, limits: float) -> "Caution":
        """Return the shares of a one-sided level, where the fit's limits are those of the level `limits`.

        A shown term errs like a normal deviate, one at its bound like half of one.
        """
        normal = NormalDist()
        whole = normal.inv_cdf((1 + limits) / 2)
        return cls(normal.inv_cdf((1 + level) / 2) / whole, normal.inv_cdf(level) / whole)


#: Up to the limits themselves.
LIMITS = Caution(1.0, 1.0)
#: The mean over what the record leaves open: of half a normal deviate, over its 95 % quantile.
MEAN = Caution(math.sqrt(2 / math.pi) / NormalDist().inv_cdf(0.975), 0.0)


#: A parameter's name in the fit, empty of none; how far a quantity moves when that goes to its limit.
_Excursion: TypeAlias = tuple[str, FloatArray]


def modelled(fit: NoiseFit, of: Quantity) -> FloatArray:
    """Return a quantity of the fitted model, shape as `of` gives it; a term that is not in it counts as 0."""
    parts = list(shares(fit, of).values())
    return np.sum(parts, axis=0) if parts else 0.0 * of(TERMS["N"].of(0.0))


def shares(fit: NoiseFit, of: Quantity) -> dict[str, FloatArray]:
    """Return the part of a quantity that each term of the fitted model has, by their estimates' keys."""
    return {e.key: of(_term(e, e.value)) for e, held in _held(fit) if held and e.value is not None}


def upper_limit(fit: NoiseFit, of: Quantity, caution: Caution = LIMITS) -> FloatArray:
    """Return the upper limit of a quantity by a fit and its limits, shape as `of` gives it for one term.

    `caution` says how far towards the limits each term counts: by default wholly, which is the fit's level.
    """
    return modelled(fit, of) + _joint(fit, _excursions(fit, of, caution, up=True))


def lower_limit(fit: NoiseFit, of: Quantity) -> FloatArray:
    """Return the lower limit of a quantity at the fit's level, at least 0, shape as `of` gives it."""
    return np.maximum(modelled(fit, of) - _joint(fit, _excursions(fit, of, LIMITS, up=False)), 0.0)


def coasting_variance(
    term: NoiseTerm, times_s: FloatArray, *, rest_s: float, rate_hz: float, integrals: int = ANGLE
) -> FloatArray:
    """Return the variance of the error after coasting, shape (t,), in (U s^integrals)².

    The bias is the mean of a rest of `rest_s`; then the samples of a term, at `rate_hz`, less the bias are
    integrated so many times, for `times_s`, shape (t,): once for the angle of a gyroscope or the velocity of
    an accelerometer, twice for a position, three times for the position that a tilt makes, per unit of
    gravity. Times that are not positive are a ValueError.

    The error is a sum of samples with weights that add up to zero, -w/2' D w with the mean square differences
    D, whose second sums V(n) each term knows; blocks of samples make the sum short. Right to 1e-3 where a
    block is a hundredth of the rest and of the coast.
    """
    times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
    if not (np.all(times > 0) and rest_s > 0):
        raise ArgumentError(f"times of coasting and resting must be positive, got {times_s} and {rest_s}")
    return np.array([_coasting(term, float(t), rest_s, rate_hz, integrals) for t in times])


def _coasting(term: NoiseTerm, coast_s: float, rest_s: float, rate_hz: float, integrals: int) -> float:
    coast, rest = (max(1, round(t * rate_hz)) for t in (coast_s, rest_s))
    largest = max(1, round(min(coast, rest) / _BLOCKS), math.ceil((coast + rest) / _MOST_BLOCKS))
    # Of the sizes down to half of it, the one of which both are whole blocks most nearly.
    sizes = range(largest, largest // 2, -1)[:_TRIED]
    size = min(sizes, key=lambda size: sum(abs(round(n / size) * size - n) / n for n in (coast, rest)))
    resting, coasting = (max(1, round(n / size)) for n in (rest, coast))
    blocks = resting + coasting
    # The sums of blocks have these covariances, up to a constant that weights of sum zero do not see.
    V = term.sum_variance(np.arange(blocks + 1.0) * size, 1 / rate_hz) / rate_hz**2
    covariance = np.concatenate([V[1:2], (V[2:] - 2 * V[1:-1] + V[:-2]) / 2])
    left = (coasting - 0.5 - np.arange(coasting)) * size / rate_hz
    weights = np.concatenate([np.zeros(resting), left ** (integrals - 1) / math.factorial(integrals - 1)])
    weights[:resting] = -weights.sum() / resting
    # The quadratic form of a Toeplitz matrix, as a product of transforms.
    length = 1 << (2 * blocks).bit_length()
    circulant = np.concatenate([covariance, np.zeros(length - 2 * blocks + 1), covariance[:0:-1]])
    power = np.abs(np.fft.rfft(weights, length)) ** 2 * np.fft.rfft(circulant).real
    return max(float(power[0] + 2 * power[1:-1].sum() + power[-1]) / length, 0.0)


def _held(fit: NoiseFit) -> Iterator[tuple[Estimate, bool]]:
    """Yield the estimates and whether the model holds them, a bounded one that it holds with its value there.

    One with a value that the model does not hold is another name of what its terms are: it counts with them.
    """
    drawn = fit.drawn
    for estimate in fit.estimates:
        value = estimate.drawn
        if estimate.value is not None or value is None or not math.isfinite(estimate.high):
            yield estimate, value is not None
            continue
        times = (Interval(value=t, low=t, high=t) for t in drawn[estimate.key].values[1:])
        time, high = estimate.correlation_time or next(times, None), max(estimate.high, value)
        yield replace(estimate, status="estimated", value=value, high=high, correlation_time=time), True


def _term(estimate: Estimate, coefficient: float, time: float | None = None) -> NoiseTerm:
    """Return the term of an estimate with another coefficient or time.

    A Gauss-Markov term that is only bounded has no T: whatever T is, flicker of the same number covers
    it, since the greatest of 2 sigma² T / (1 + omega² T²) over all T is sigma² / omega.
    """
    if estimate.correlation_time is not None:
        return TERMS[estimate.symbol].of(coefficient, time or estimate.correlation_time.value)
    symbol = "B" if estimate.symbol == GaussMarkov.symbol else estimate.symbol
    return TERMS[symbol].of(coefficient)


def _excursions(fit: NoiseFit, of: Quantity, caution: Caution, *, up: bool) -> Iterator[_Excursion]:
    """Yield how far each term moves a quantity up, or down; a time signed by the limit that does."""
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
        # Nobody knows how large a term without an upper limit may be, nor what it does.
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
