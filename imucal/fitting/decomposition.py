"""decompose: what the parts of a fitted model did in a record, each with its standard error.

The conditional mean of the states given all samples, in O(n). Given the states at its start and at
its end, a block of samples is independent of the others. So a filter and a smoother run from block
to block (`imucal.fitting.state_space`), and each block's inside is a linear map of its samples and
its ends, the same for all blocks that miss the same samples. Nothing is approximated: the result is
that of one dense conditioning of the whole record.

Source: Rauch, Tung & Striebel (1965), AIAA J. 3, 1445 (the smoother); Anderson & Moore (1979),
"Optimal filtering", sec. 7.3. It is the E-step of EM for these models, Shumway & Stoffer (1982),
J. Time Ser. Anal. 3, 253.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from imucal.arguments import takes
from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.errors import DataError
from imucal.fitting.noise_fit import NoiseFit, keyed
from imucal.fitting.robust import find_spikes
from imucal.fitting.state_space import (
    BIAS,
    BlockLaw,
    Blocks,
    StateSpace,
    Step,
    Told,
    filtered,
    inverse_of,
    on_grid,
)
from imucal.frozen import frozen_alone
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

#: Blocks whose insides are computed at once; so few that each is computed by itself.
_AT_ONCE, _FEW = 512, 4
#: Rates of samples and model that differ by more belong to two records.
_SAME_RATE = 0.01
#: Most places on the clock's grid for each sample: beyond, the record is mostly a gap.
_SPARSE = 20

#: Called with the number of samples done and of all.
Progress: TypeAlias = Callable[[int, int], None]


@frozen_alone
class Component(ReadOnlyArrays):
    """One part of the samples, given all of them, on a grid of n places.

    Its `key` is ``level``, ``B``, ``GM`` (``GM1``, ``GM2``), ``K`` or ``R``; or ``bias``, the sum of them.
    `value` is the conditional mean at each place and `error` its standard error, in U, shape (n,) each.
    """

    key: str
    value: FloatArray
    error: FloatArray


@frozen_alone
class Decomposition(ReadOnlyArrays):
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
        """White and quantization noise: samples less bias, shape (n,), in U; NaN where there is none."""
        return np.asarray(self.samples - self.bias.value)


@takes(
    'imucal.decompose(recording["gyro_x"], report["gyro_x"].fit)',
    series=AxisSeries,
    fit=(NoiseFit, NoiseModel),
)
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
    """
    model = fit.model if isinstance(fit, NoiseFit) else fit
    if isinstance(fit, NoiseFit) and abs(fit.rate_hz / series.rate_hz - 1) > _SAME_RATE:
        msg = f"{series.name}: samples at {series.rate_hz:.6g} Hz, but the fit is for {fit.rate_hz:.6g} Hz"
        raise ValueError(msg)
    if not any(term.coefficient for term in model.terms):
        msg = f"{series.name}: the model has no terms, so there is nothing to separate; fit a longer record"
        raise DataError(msg)
    good = _good(series, clean=clean)
    samples, seen = on_grid(good, "a decomposition")
    states = StateSpace.of(model, rate_hz=series.rate_hz, n=samples.size)
    # The mean costs no digits; what holds the level holds it.
    mean = float(samples[seen].mean())
    found = smooth(states, np.where(seen, samples - mean, 0.0), seen, progress=progress)
    holders = {BIAS, "level" if "level" in states.flat else "K"}
    parts = [
        Component(key=key, value=value + mean if key in holders else value, error=error)
        for key, (value, error) in found.items()
    ]
    return Decomposition(
        series=series,
        model=model,
        start_s=float((good.clock.segments[0].offset - series.clock.segments[0].offset) * series.tau0),
        samples=np.where(seen, samples, np.nan),
        components=tuple(part for part in parts if part.key != BIAS),
        bias=next(part for part in parts if part.key == BIAS),
    )


def _good(series: AxisSeries, *, clean: bool) -> AxisSeries:
    """Return the finite samples, without spikes where `clean`; refuse what is mostly gaps."""
    good = series.finite()
    if clean and good.n:
        good = good.keeping(~find_spikes(good.samples)[0])
    if good.n > 1 and good.clock.grid_size > _SPARSE * good.n:
        msg = (
            f"{series.name}: {good.n} samples in {good.duration_s:.4g} s at {good.rate_hz:.6g} Hz are mostly "
            "gaps; use a part of the record with fewer gaps"
        )
        raise DataError(msg)
    return good


def smooth(
    states: StateSpace, samples: FloatArray, seen: BoolArray, *, progress: Progress | None = None
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the components given the samples: key -> conditional means and standard errors, shapes (n,).

    In the order ``level``, the groups of states, ``R`` (the slope times the time since the first sample), as
    far as they are there, and ``bias``, their sum. Samples, shape (n,), count where they are `seen`, shape
    (n,), as the first one is. `progress` is called after some blocks.
    """
    n, scale = samples.size, float(np.sqrt(states.white))
    blocks = Blocks.of(samples / scale, seen)
    unit = states.in_unit_of_white()
    block = BlockLaw.of(unit, blocks.length, 1 / blocks.count)
    ends = _Ends.smoothed(list(filtered(unit, blocks, block)), states.size)
    level, slope = ([name for name in states.flat if name == key] for key in ("level", "R"))
    keys = (*level, *states.groups, *slope, BIAS)
    found = {key: np.empty((2, *blocks.samples.shape)) for key in keys}
    done = 0
    for members, holes in blocks.alike():
        inside = _insides(unit, block, holes)
        for some in np.array_split(members, -(-members.size // _AT_ONCE)):
            for key, value, variance in _components(unit, inside, blocks, ends, some):
                found[key][0, some] = scale * value
                found[key][1, some] = scale * np.sqrt(np.maximum(variance, 0.0))
            done += some.size
            if progress:
                progress(min(done * blocks.length, n), n)
    return {key: (both[0].reshape(-1)[:n], both[1].reshape(-1)[:n]) for key, both in found.items()}


#: A component inside blocks that miss the same samples: its key, of_samples, of_ends, left. Its mean is
#: of_samples @ samples + of_ends @ (extended start, end), its variance `left` when all of these are known.
_Inside: TypeAlias = tuple[str, FloatArray, FloatArray, FloatArray]


def _insides(states: StateSpace, block: BlockLaw, seen: BoolArray) -> list[_Inside]:
    """Return every component's inside of the blocks of which the samples `seen`, shape (B,), are there."""
    told = Told.of(block, seen)
    inverse_rest = inverse_of(told.rest)
    d, B = states.size, seen.size
    insides = []
    for key, group in (*states.groups.items(), (BIAS, states.everything)):
        # Given the start: what that adds to the component, its covariance with the end and the samples.
        start = np.zeros((B, d + 2))
        start[:, :d] = np.where(group, states.decay ** np.arange(B)[:, np.newaxis], 0.0)
        if key == BIAS:
            start[:, d:] = block.trace[:, d:]
        with_end = np.where(group, block.own[:, :B, B].T, 0.0)
        cross = block.sampled[group][:, seen, :B].sum(axis=0).T
        alone = cross @ told.inverse
        to_end = (with_end - alone @ block.with_end[seen]) @ inverse_rest
        to_samples = alone - to_end @ told.gain
        start -= to_samples @ block.trace[seen] + to_end @ block.passed
        left = np.einsum("dii->i", block.own[group])[:B]
        left = left - np.sum(to_samples * cross, axis=1) - np.sum(to_end * with_end, axis=1)
        insides.append((key, to_samples, np.concatenate([start, to_end], axis=1), left))
    return insides


@frozen_alone
class _Ends:
    """What all samples tell of each block's ends: the states at its start and at its end, level and slope.

    Their mean and covariance have shapes (b, 2d + p) and (b, 2d + p, 2d + p).
    """

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def smoothed(cls, steps: Sequence[Step], d: int) -> "_Ends":
        """Smooth: each block's start given its end, whose mean and covariance are known from the last on."""
        size = d + steps[-1].mean.size
        means, covariances = np.empty((len(steps), size)), np.empty((len(steps), size, size))
        end_mean, end_covariance = steps[-1].predicted, steps[-1].ahead
        for block in range(len(steps) - 1, -1, -1):
            step = steps[block]
            gain = step.cross.T @ step.inverse
            start_mean = step.mean + gain @ (end_mean - step.predicted)
            start_covariance = step.covariance + gain @ (end_covariance - step.ahead) @ gain.T
            joint = gain @ end_covariance
            # Level and slope are the same at both ends, to the last digit.
            start_mean[d:], start_covariance[d:, d:] = end_mean[d:], end_covariance[d:, d:]
            start_covariance[:d, d:], start_covariance[d:, :d] = joint[:d, d:], joint[:d, d:].T
            means[block] = np.concatenate([start_mean[:d], end_mean])
            covariances[block, :d, :d] = start_covariance[:d, :d]
            covariances[block, :d, d:], covariances[block, d:, :d] = joint[:d], joint[:d].T
            covariances[block, d:, d:] = end_covariance
            end_mean, end_covariance = start_mean, start_covariance
        return cls(mean=means, covariance=covariances)

    def extended(self, states: StateSpace, members: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and covariance of some blocks' extended starts and their ends, shape (b, 2d + 2)."""
        d = states.size
        maps = np.zeros((members.size, 2 * d + 2, self.mean.shape[1]))
        for map_, place in zip(maps, members.tolist(), strict=True):
            extension = states.extension(place / len(self.mean))
            map_[: d + 2, :d], map_[: d + 2, 2 * d :] = extension[:, :d], extension[:, d:]
        maps[:, d + 2 :, d : 2 * d] = np.eye(d)
        mean = np.einsum("bij,bj->bi", maps, self.mean[members])
        return mean, maps @ self.covariance[members] @ np.swapaxes(maps, 1, 2)


def _components(
    states: StateSpace, insides: list[_Inside], blocks: Blocks, ends: _Ends, members: IntArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield each component's key, means and variances in some blocks, shapes (b, length)."""
    own = blocks.samples[members][:, blocks.seen[members[0]]]
    extended, covariance = ends.extended(states, members)
    for key, of_samples, of_ends, left in insides:
        yield key, own @ of_samples.T + extended @ of_ends.T, _spread(covariance, of_ends) + left
    for i, name in enumerate(states.flat, start=2 * states.size):
        time = np.ones((members.size, blocks.length))
        if name == "R":
            time = (members[:, np.newaxis] + np.arange(blocks.length) / blocks.length) / blocks.count
        mean, variance = ends.mean[members, i], ends.covariance[members, i, i]
        yield name, mean[:, np.newaxis] * time, variance[:, np.newaxis] * time**2


def _spread(covariance: FloatArray, of_ends: FloatArray) -> FloatArray:
    """Return the variances, shape (b, length), of `of_ends`, shape (length, e), times the blocks' ends."""
    if covariance.shape[0] < _FEW:
        return np.asarray(np.sum(of_ends @ covariance * of_ends, axis=2))
    # One product for all blocks: of the pairs of columns with the covariances' upper halves.
    row, column = np.triu_indices(of_ends.shape[1])
    pairs = of_ends[:, row] * of_ends[:, column] * np.where(row == column, 1.0, 2.0)
    return np.asarray(covariance[:, row, column] @ pairs.T)
