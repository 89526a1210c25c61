"""decompose: the contribution of each term of a fitted model to a record, with standard errors."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import NoiseFit, keyed
from imucal.fitting.robust import find_spikes
from imucal.fitting.wiener import Component, Progress, smooth
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

#: Largest relative difference of the rates of samples and model.
_SAME_RATE = 0.01
#: Largest number of places on the grid per sample.
_SPARSE = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Decomposition(ReadOnlyArrays):
    """A record as the sum of the terms of its model, on the clock's even grid of n places.

    Attributes
    ----------
    series
        The samples as they were given.
    start_s
        Time of the first good sample since the series' first sample, in s.
    samples
        On the grid, shape (n,), in U; NaN for missing samples and spikes.
    components
        Their values and `residual` add up to `samples`.
    bias
        The sum of the components. Its standard error is smaller than theirs, because their errors are
        anticorrelated.
    """

    series: AxisSeries
    model: NoiseModel
    start_s: float
    samples: FloatArray
    components: tuple[Component, ...]
    bias: Component

    def __getitem__(self, key: str) -> Component:
        return keyed((*self.components, self.bias), key, "the decomposition has")

    @property
    def n(self) -> int:
        """Number of places on the grid."""
        return self.samples.size

    @property
    def time_s(self) -> FloatArray:
        """Time of each place since the series' first sample, shape (n,), in s."""
        return self.start_s + np.arange(self.n, dtype=np.float64) * self.series.tau0

    @property
    def residual(self) -> FloatArray:
        """White and quantization noise: samples less bias, shape (n,), in U; NaN without a sample."""
        return np.asarray(self.samples - self.bias.value)


def decompose(
    series: AxisSeries, fit: NoiseFit | NoiseModel, *, clean: bool = True, progress: Progress | None = None
) -> Decomposition:
    """Return the smoothed components of a record's noise model: how its bias moved.

    The standard errors assume that the model is true. White noise N and quantization noise Q are in the
    residual. A ramp R is estimated again. The level is part of the random walk K, or a component of its own
    in a model without K.

    Parameters
    ----------
    series
        The samples; the standard errors include the missing ones.
    fit
        A fit of the samples, or a model. An output filter, lines, a warm-up, steps, cycles or the effect of
        temperature are not in the model: slow ones appear in the bias.
    clean
        Treat spikes as missing samples.
    progress
        Called with the numbers of samples done and in all.

    Returns
    -------
    Decomposition
        If the model has neither N nor Q, the bias is equal to the samples.

    Raises
    ------
    ValueError
        If the fit has another rate, or a term of its model has no spectral density.
    DataError
        If there are fewer than 2 finite samples, the model has no noise, less than a twentieth of the
        samples are left, or too many are missing to estimate them.
    """
    model = fit.model if isinstance(fit, NoiseFit) else fit
    if isinstance(fit, NoiseFit) and abs(fit.rate_hz / series.rate_hz - 1) > _SAME_RATE:
        msg = f"{series.name}: samples at {series.rate_hz:.6g} Hz, but the fit is for {fit.rate_hz:.6g} Hz"
        raise ValueError(msg)
    if not any(term.coefficient for term in model.terms if term.symbol != "R"):
        msg = "the model has no noise, so there is nothing to separate; fit a longer record"
        raise DataError(msg, place=series.name)
    good = _good(series, clean=clean)
    if good.n < 2:
        raise DataError(f"a decomposition needs at least 2 samples, got {good.n}", place=series.name)
    samples, seen = np.zeros(good.clock.grid_size), np.zeros(good.clock.grid_size, dtype=bool)
    samples[good.clock.grid()], seen[good.clock.grid()] = good.samples, True
    try:
        components = smooth(model, samples, seen, series.tau0, progress=progress)
    except (ArgumentError, DataError) as error:
        raise error.within(series.name) from error
    return Decomposition(
        series=series,
        model=model,
        start_s=float((good.clock.segments[0].offset - series.clock.segments[0].offset) * series.tau0),
        samples=np.where(seen, samples, np.nan),
        components=components[:-1],
        bias=components[-1],
    )


def _good(series: AxisSeries, *, clean: bool) -> AxisSeries:
    """Return the finite samples, without spikes if `clean`; raise a DataError if most are missing."""
    good = series.finite()
    if clean and good.n:
        good = good.keeping(~find_spikes(good.samples)[0])
    if good.n > 1 and good.clock.grid_size > _SPARSE * good.n:
        msg = (
            f"{good.n} samples in {good.duration_s:.4g} s at {good.rate_hz:.6g} Hz are mostly "
            "gaps; use a part of the record with fewer gaps"
        )
        raise DataError(msg, place=series.name)
    return good
