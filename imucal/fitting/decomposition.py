"""decompose: what the parts of a fitted model did in a record, each with its standard error."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, read_only
from imucal.errors import DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.robust import find_spikes
from imucal.fitting.state_space import BIAS, LatentStates, Progress, Smoothed, smooth
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

#: Rates of samples and model that differ by more belong to two records.
_SAME_RATE = 0.01
#: Most places on the clock's grid for each sample: beyond, the record is mostly a gap.
_SPARSE = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Component:
    """One part of the samples, given all of them.

    Attributes
    ----------
    key
        ``level``, ``B``, ``GM`` (``GM1``, ``GM2``), ``K``, ``R``; or ``bias``, the sum of them.
    value
        Conditional mean at each place of the grid, shape (n,), in U.
    error
        Its standard error, shape (n,), in U.
    """

    key: str
    value: FloatArray
    error: FloatArray

    def __post_init__(self) -> None:
        for name in ("value", "error"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decomposition:
    """A record as the sum of what its model is made of, on the clock's even grid of n places.

    Attributes
    ----------
    series
        The samples as they were given.
    model
        What they were decomposed by.
    start_s
        Time of the first place, where the first good sample is, since the series' first sample, in s.
    samples
        On the grid, shape (n,), in U; NaN where a sample is missing or was taken for a spike.
    components
        The parts: their values and `residual` add up to `samples`.
    bias
        The sum of the components, with the standard error of the sum, which is smaller than theirs:
        what is given to one is taken from another.
    """

    series: AxisSeries
    model: NoiseModel
    start_s: float
    samples: FloatArray
    components: tuple[Component, ...]
    bias: Component

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", read_only(self.samples))

    def __getitem__(self, key: str) -> Component:
        for component in (*self.components, self.bias):
            if component.key == key:
                return component
        found = ", ".join(component.key for component in (*self.components, self.bias))
        msg = f"{key!r}; the decomposition has {found}"
        raise KeyError(msg)

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
        """White and quantization noise: samples less bias, shape (n,), in U; NaN where there is none."""
        return np.asarray(self.samples - self.bias.value)


def decompose(
    series: AxisSeries, fit: NoiseFit | NoiseModel, *, clean: bool = True, progress: Progress | None = None
) -> Decomposition:
    """Return what the bias of a record did: the smoothed parts of its noise model.

    Each part is its mean given all samples, before and after, and the model; the standard errors hold
    for that model. White noise N is what the samples are measured with; quantization noise Q stays
    with it in the residual, its correlation taken into account. A ramp R is estimated anew, with a
    flat prior. Flicker B is its bank of Gauss-Markov terms, within 1 % of its density (12 % near half
    the rate). The level is part of the random walk K where there is one, since a walk may start
    anywhere; else it is a component of its own.

    Parameters
    ----------
    series
        The samples; gaps are bridged, and the standard errors say how well.
    fit
        A fit of them, or a model. What the fit took for an output filter or lines, a warm-up, steps,
        cycles or the effect of temperature is not modelled here: what is slow shows in the bias.
    clean
        Take spikes for missing samples.
    progress
        Called with the number of places done and of all.

    Returns
    -------
    Decomposition
        Exact for the model: equal to one conditioning of all samples at once, in O(n). With no N and
        no Q in the model the samples are their own bias.

    Raises
    ------
    ValueError
        If the fit is of another rate, or a term of its model has no states.
    DataError
        If there are fewer than 2 finite samples, the model has no terms, or gaps are 20 times as
        long as the samples.

    Notes
    -----
    Source: the fixed-interval smoother of Rauch, Tung & Striebel (1965), AIAA J. 3, 1445; it is the
    E-step of EM for these models, Shumway & Stoffer (1982), J. Time Ser. Anal. 3, 253.
    """
    model = fit.model if isinstance(fit, NoiseFit) else fit
    if isinstance(fit, NoiseFit) and abs(fit.rate_hz / series.rate_hz - 1) > _SAME_RATE:
        msg = f"{series.name}: samples at {series.rate_hz:.6g} Hz, but the fit is of {fit.rate_hz:.6g} Hz"
        raise ValueError(msg)
    if not any(term.coefficient for term in model.terms):
        msg = f"{series.name}: the model has no terms, so there is nothing to tell apart; fit a longer record"
        raise DataError(msg)
    samples, seen, start_s = _on_grid(series, clean=clean)
    states = LatentStates.of(model, rate_hz=series.rate_hz, n=samples.size)
    # The mean and the unit cost no digits.
    mean = float(samples[seen].mean())
    found = smooth(states, np.where(seen, samples - mean, 0.0), seen, progress=progress)
    return Decomposition(
        series=series,
        model=model,
        start_s=start_s,
        samples=np.where(seen, samples, np.nan),
        components=tuple(_component(found, key, mean, states) for key in found.mean if key != BIAS),
        bias=_component(found, BIAS, mean, states),
    )


def _component(found: Smoothed, key: str, mean: float, states: LatentStates) -> Component:
    """Return a component; what holds the level holds the mean that was taken off."""
    holder = "level" if "level" in states.flat else "K"
    value = found.mean[key] + mean if key in (BIAS, holder) else found.mean[key]
    return Component(key=key, value=value, error=found.error[key])


def _on_grid(series: AxisSeries, *, clean: bool) -> tuple[FloatArray, BoolArray, float]:
    """Return the samples on the clock's even grid, where there are any, and the time of the first, in s."""
    finite = series.finite()
    if clean and finite.n:
        spike, _, _ = find_spikes(finite.samples)
        finite = finite.keeping(~spike)
    if finite.n < 2:
        msg = f"{series.name}: a decomposition needs at least 2 samples, got {finite.n}"
        raise DataError(msg)
    size = finite.clock.grid_size
    if size > _SPARSE * finite.n:
        msg = (
            f"{series.name}: {finite.n} samples in {finite.duration_s:.4g} s at {finite.rate_hz:.6g} Hz "
            "are mostly gaps; take a part of the record with fewer"
        )
        raise DataError(msg)
    samples, seen = np.zeros(size), np.zeros(size, dtype=bool)
    place = finite.clock.grid()
    samples[place], seen[place] = finite.samples, True
    return (
        samples,
        seen,
        float((finite.clock.segments[0].offset - series.clock.segments[0].offset) * series.tau0),
    )
