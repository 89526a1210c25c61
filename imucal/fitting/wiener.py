"""Wiener filter of a noise model: its components, given all samples.

In the basis of the likelihood, the DCT-II, the terms of a model are independent at each ordinate, with
variances S_c that add up to S. The mean of a component given all samples is S_c / S times the ordinate, and
the variance of its error is S_c - S_c² / S. Missing samples are replaced by their mean given the others.

Source: Wiener (1949), "Extrapolation, interpolation, and smoothing of stationary time series"; draws:
Papandreou & Yuille (2010), NIPS 23.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import TypeAlias

import numpy as np
import scipy

from imucal.allan.dct import dct2, idct2, ramp_ordinates
from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.errors import ArgumentError, DataError
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import Quantization, RateRandomWalk, term_keys

#: Ordinates whose variances are computed at a time. 2^20 of N + B + K need 1.5 times the time and 2.7 times
#: the memory of parts of this size.
_PART = 1 << 16
#: Key of the sum of all components.
BIAS = "bias"
#: Terms that stay in the residual.
_NOISE = frozenset({"Q", "N"})
#: Samples in all draws of the errors together, so that the time hardly depends on the length of the record.
_DRAWN_SAMPLES = 2_000_000
#: Fewest draws: a standard error from 12 draws is uncertain by 20 %, 1/sqrt(2 · 12).
_MIN_DRAWS = 12
#: Most draws: a standard error from 200 draws is uncertain by 5 %. The errors of fewer samples are exact.
_MAX_DRAWS = 200
#: Conjugate gradients stop at this fraction of the standard error, far below the scatter of the draws.
_CLOSE = 1e-3
#: Conjugate gradients fail after this many steps. Models with N needed 2 to 12, and Q + K with half of the
#: samples missing 435.
_STEPS = 5000
#: Called with the numbers of samples done and in all.
Progress: TypeAlias = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Component(ReadOnlyArrays):
    """One part of the samples, given all samples, on a grid of n places.

    Its `key` is ``level``, ``B``, ``GM`` (``GM1``, ``GM2``), ``K`` or ``R``; or ``bias``, their sum. `value`
    is the conditional mean and `error` its standard error, in U, shape (n,) each.
    """

    key: str
    value: FloatArray
    error: FloatArray


def smooth(
    model: NoiseModel,
    samples: FloatArray,
    seen: BoolArray,
    tau0: float,
    *,
    progress: Progress | None = None,
) -> tuple[Component, ...]:
    """Return the components given the `seen` samples, shape (n,): ``level``, the terms, ``R``, ``bias``.

    The first and the last sample must be seen.
    """
    n = samples.size
    filters, law = _filters(model, n, tau0)
    quantization = sum(term.variance(tau0) for term in model.terms if isinstance(term, Quantization))
    unknown = _Unknown.of(law, seen, quantization)
    mean = float(samples[seen].mean())
    values = {key: np.zeros(n) for key in filters}
    variances = {key: one.variance for key, one in filters.items()}
    done, steps = 0, len(filters) * (1 + unknown.count)
    for part in chain([unknown.complete(np.where(seen, samples - mean, 0.0))], unknown.errors()):
        ordinates = dct2(part)
        for key, one in filters.items():
            value = one.mean(ordinates, law)
            if done < len(filters):
                values[key] = value + one.gain[0] * mean
            else:
                variances[key] = variances[key] + value**2
            done += 1
            if progress:
                progress(n * done // steps, n)
    return tuple(
        Component(key=key, value=value, error=np.sqrt(np.maximum(variances[key], 0.0)))
        for key, value in values.items()
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Law:
    """Distribution of the ordinates: variance 1 / `weight`, flat prior on level and slope.

    The slope multiplies the ordinates of a `ramp`. Its estimate is `slope` @ ordinates, with variance
    `slope_variance`. Arrays have shape (n,).
    """

    weight: FloatArray
    ramp: FloatArray
    slope: FloatArray
    slope_variance: float

    @classmethod
    def of(cls, spectrum: FloatArray, *, has_ramp: bool) -> "_Law":
        n = spectrum.size
        weight = np.concatenate([[0.0], 1 / spectrum[1:]])
        ramp, slope, variance = np.zeros(n), np.zeros(n), 0.0
        if has_ramp:
            ramp = np.concatenate([[np.sqrt(n) * (n - 1) / 2], ramp_ordinates(n, n - 1)])
            variance = 1 / float(ramp @ (weight * ramp))
            slope = variance * weight * ramp
        return cls(weight=weight, ramp=ramp, slope=slope, slope_variance=variance)

    def weigh(self, samples: FloatArray) -> FloatArray:
        ordinates = dct2(samples)
        if self.slope_variance:
            ordinates -= (self.slope @ ordinates) * self.ramp
        return idct2(self.weight * ordinates)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return a vector whose covariance is the precision matrix."""
        ordinates = np.sqrt(self.weight) * rng.standard_normal(self.weight.size)
        return idct2(ordinates - (self.ramp @ ordinates) * self.slope)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Filter:
    """One component: its `gain` at each ordinate, and its `variance` at each sample."""

    gain: FloatArray
    variance: FloatArray
    rises: bool

    @classmethod
    def of(cls, law: _Law, own: FloatArray, *, level: bool, left: float, rises: bool = False) -> "_Filter":
        """Return the filter of a component with variances `own` of the ordinates, shape (n,).

        `left` is the variance of its error at ordinate 0. A component with the `level` contains all of it.
        """
        n, gain = own.size, own * law.weight
        error = own * (1 - gain)
        gain[0], error[0] = level, left
        # The square of a cosine is 1/2 plus half a cosine of twice its frequency, folded at n.
        twice = np.zeros(n)
        twice[2::2] = error[1 : (n + 1) // 2]
        twice[2 * n - 2 * np.arange(n // 2 + 1, n)] -= error[n // 2 + 1 :]
        variance = error.sum() / n + idct2(twice) / np.sqrt(2 * n)
        if law.slope_variance:
            variance += law.slope_variance * idct2((rises - gain) * law.ramp) ** 2
        return cls(gain=gain, variance=np.asarray(variance), rises=rises)

    def mean(self, ordinates: FloatArray, law: _Law) -> FloatArray:
        filtered = self.gain * ordinates
        if law.slope_variance:
            filtered += (law.slope @ ordinates) * (self.rises - self.gain) * law.ramp
        return idct2(filtered)


def _filters(model: NoiseModel, n: int, tau0: float) -> tuple[dict[str, _Filter], _Law]:
    keys = term_keys(term.symbol for term in model.terms)
    spectra = {
        key: _spectrum(term, n, tau0)
        for key, term in zip(keys, model.terms, strict=True)
        if term.symbol != "R" and term.coefficient
    }
    slow = {key: own for key, own in spectra.items() if key not in _NOISE}
    total, bias = sum(spectra.values(), np.zeros(n)), sum(slow.values(), np.zeros(n))
    law = _Law.of(total, has_ramp="R" in keys)

    # The prior of the level is flat: the other terms leave it the rest of ordinate 0.
    filters = {}
    if "K" not in slow:
        filters["level"] = _Filter.of(law, np.zeros(n), level=True, left=float(total[0]))
    for key, own in slow.items():
        filters[key] = _Filter.of(law, own, level=key == "K", left=float(total[0] if key == "K" else own[0]))
    if "R" in keys:
        filters["R"] = _Filter.of(law, np.zeros(n), level=False, left=0.0, rises=True)
    filters[BIAS] = _Filter.of(law, bias, level=True, left=float(total[0] - bias[0]), rises=True)
    return filters, law


def _spectrum(term: NoiseTerm, n: int, tau0: float) -> FloatArray:
    """Return the variances of the ordinates 0 … n-1 of a term.

    Ordinate 0 of a walk is its level, with a flat prior: it is 0 here. `_Unknown` adds the part of
    quantization noise at both ends.
    """
    first = np.arange(1, n, dtype=np.int64)
    if isinstance(term, Quantization):
        return np.concatenate([[0.0], term.psd(first / (2 * n * tau0), tau0) / tau0])
    parts = np.array_split(first, 1 + n // _PART)
    expected = np.concatenate([term.dct_slopes(n, part, np.ones_like(part), tau0)[0] for part in parts])
    if not expected.any():
        msg = (
            f"{term.symbol} ({term.names[0]}) has no spectral density, so it can't be separated; leave it out"
        )
        raise ArgumentError(msg)
    if isinstance(term, RateRandomWalk):
        return np.concatenate([[0.0], expected])
    # n times the variance of the mean. Half the structure function at a long lag is the variance of a sample;
    # for flicker, which has none, cycles of more than 3 n samples do not matter for the level.
    far = np.array([(3.0 if isinstance(term, PowerLawTerm) else 1e9) * n])
    lags = np.arange(1.0, n)
    own = n * term.structure(far, tau0) / 2 - term.structure(lags, tau0) @ (1 - lags / n)
    return np.concatenate([np.maximum(own, 0.0), expected])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Unknown:
    """The samples to estimate: missing ones, and the first and the last one if they have extra noise.

    `places`, shape (u,), are indices and `known` the precision of their observation, zero for missing ones.
    `covariance` of their errors is None if they are more than `count`, the number of draws. `runs`
    precondition: the indices in `places` of all runs of one length, shape (r, length), and the variances of
    their sines.
    """

    law: _Law
    places: IntArray
    known: FloatArray
    count: int
    runs: list[tuple[IntArray, FloatArray]]
    covariance: FloatArray | None = None

    @classmethod
    def of(cls, law: _Law, seen: BoolArray, quantization: float) -> "_Unknown":
        n, unknown, precision = seen.size, ~seen, np.zeros(seen.size)
        if quantization:
            unknown[[0, -1]], precision[[0, -1]] = True, 1 / quantization
        places = np.flatnonzero(unknown)
        starts = np.flatnonzero(np.diff(places, prepend=-2) > 1)
        lengths = np.diff(starts, append=places.size)
        runs = []
        for length in np.unique(lengths).tolist():
            own = starts[lengths == length, np.newaxis] + np.arange(length)
            at = np.arange(1, length + 1) * n / (length + 1)
            runs.append((own, 1 / np.interp(at, np.arange(n), law.weight)))
        count = int(min(places.size, np.clip(_DRAWN_SAMPLES // n, _MIN_DRAWS, _MAX_DRAWS)))
        result = cls(law=law, places=places, known=precision[places], count=count, runs=runs)
        if places.size > count:
            return result
        matrix = np.array([result._weigh(one) for one in np.eye(count)]).reshape(count, count)
        return replace(result, covariance=np.linalg.inv(matrix))

    def complete(self, samples: FloatArray) -> FloatArray:
        full, missing = samples.copy(), self.places[self.known == 0]
        others = np.delete(np.arange(samples.size), missing)
        full[missing] = np.interp(missing, others, samples[others])
        full[self.places] -= self._solve(self.law.weigh(full)[self.places])
        return full

    def errors(self) -> Iterator[FloatArray]:
        """Yield errors of the completed samples, shape (n,); their squares add up to the variances."""
        if self.covariance is not None:
            yield from map(self._padded, np.linalg.cholesky((self.covariance + self.covariance.T) / 2).T)
            return
        rng = np.random.default_rng(2024)
        for _ in range(self.count):
            right = self.law.draw(rng)[self.places]
            right += np.sqrt(self.known) * rng.standard_normal(right.size)
            yield self._padded(self._solve(right) / np.sqrt(self.count))

    def _padded(self, values: FloatArray) -> FloatArray:
        full = np.zeros(self.law.weight.size)
        full[self.places] = values
        return full

    def _weigh(self, values: FloatArray) -> FloatArray:
        return self.law.weigh(self._padded(values))[self.places] + self.known * values

    def _solve(self, right: FloatArray) -> FloatArray:
        if self.covariance is not None:
            return np.asarray(self.covariance @ right)
        x, rest = np.zeros(right.size), right.copy()
        direction = self._nearly(rest)
        size = rest @ direction
        for _ in range(_STEPS):
            if size <= _CLOSE**2:
                return x
            image = self._weigh(direction)
            step = size / (direction @ image)
            x += step * direction
            rest -= step * image
            near = self._nearly(rest)
            previous, size = size, rest @ near
            direction = near + size / previous * direction
        msg = (
            f"{right.size} missing samples could not be estimated in {_STEPS} steps of conjugate gradients; "
        )
        raise DataError(f"{msg}use a part of the record with fewer gaps, or add N to the model")

    def _nearly(self, right: FloatArray) -> FloatArray:
        """Precondition: sines that end with a run are nearly independent of each other."""
        result = np.empty(right.size)
        for places, variance in self.runs:
            waves = scipy.fft.dst(right[places], type=1, norm="ortho") * variance
            result[places] = scipy.fft.idst(waves, type=1, norm="ortho")
        return result
