"""Smoothing: what the states of a noise model did, given all samples, in O(n).

The states are those of `imucal.fitting.state_space`; a level and a slope without noise stand beside
them. All is Gaussian, so that the answer is the conditional mean and its standard error, of which
the textbook's Kalman filter and smoother are one way to a result. Here the record is cut into
blocks of samples. Given the states at its start and at its end, a block is independent of the
others, and within it every covariance is known in closed form. So

1. each block says what its samples tell about the states at its ends,
2. a filter and a smoother run from block to block, and
3. each block's inside is a linear map of its samples and its ends.

The maps of 1 and 3 depend on which samples are missing only: one set of small matrices serves all
blocks that are whole, and what is left per sample are a few matrix products. Nothing is
approximated: the result is that of one dense conditioning of the whole record.

Source: Rauch, Tung & Striebel (1965), AIAA J. 3, 1445 (the smoother); Anderson & Moore (1979),
"Optimal filtering", sec. 7.3. It is the E-step of Shumway & Stoffer (1982), J. Time Ser. Anal. 3, 253.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.block_laws import BlockLaw, Inside, Told, inverse_of
from imucal.fitting.latent_states import BIAS, LatentStates

#: Samples in a block; in one of a record of which many blocks have holes of their own.
_WHOLE, _HOLED = 256, 64
#: Share of blocks with holes of their own above which blocks are short.
_MANY = 0.1
#: Standard deviation of a flat prior, beside the largest sample.
_FLAT = 1e5
#: Blocks whose insides are computed at once; so few that each is computed by itself.
_AT_ONCE, _FEW = 512, 4

#: Called with the number of samples done and of all.
Progress: TypeAlias = Callable[[int, int], None]
#: Of a block: information about its extended start, what passes to its end, and the rest there.
_Summary: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """Conditional means and standard errors, shapes (n,), by the components' keys; ``bias`` is their sum."""

    mean: dict[str, FloatArray]
    error: dict[str, FloatArray]


def smooth(
    states: LatentStates, samples: FloatArray, seen: BoolArray, *, progress: Progress | None = None
) -> Smoothed:
    """Return the components given the samples.

    Parameters
    ----------
    states
        What the samples are made of.
    samples
        Shape (n,); any value where `seen`, shape (n,), is false. The first is seen.
    progress
        Called after some blocks.

    Returns
    -------
    Smoothed
        ``level`` and ``R`` (the slope times the time since the first sample) among the components,
        where they are.
    """
    n, scale = samples.size, float(np.sqrt(states.white))
    blocks = _cut(samples / scale, seen)
    unit = states.in_unit_of_white()
    block = BlockLaw.of(unit, blocks.length, 1 / blocks.count)
    ends = _Ends.of(unit, blocks, block)
    mean = {key: np.empty(blocks.samples.shape) for key in _keys(states)}
    error = {key: np.empty(blocks.samples.shape) for key in _keys(states)}
    done = 0
    for members, holes in blocks.alike():
        inside = Inside.of(unit, block, holes)
        for part in np.array_split(members, -(-members.size // _AT_ONCE)):
            for key, value, variance in _components(inside, blocks, ends, part):
                mean[key][part] = scale * value
                error[key][part] = scale * np.sqrt(np.maximum(variance, 0.0))
            done += part.size
            if progress:
                progress(min(done * blocks.length, n), n)
    return Smoothed(
        mean={key: value.reshape(-1)[:n] for key, value in mean.items()},
        error={key: value.reshape(-1)[:n] for key, value in error.items()},
    )


def _keys(states: LatentStates) -> tuple[str, ...]:
    level, slope = (tuple(name for name in states.flat if name == key) for key in ("level", "R"))
    return (*level, *states.groups, *slope, BIAS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Blocks:
    """The record cut into blocks, shape (b, length), the last filled up with missing samples."""

    samples: FloatArray
    seen: BoolArray

    @property
    def count(self) -> int:
        return int(self.samples.shape[0])

    @property
    def length(self) -> int:
        return int(self.samples.shape[1])

    def alike(self) -> Iterator[tuple[IntArray, BoolArray]]:
        """Yield the blocks that miss the same samples: their places, and which are seen, shape (length,)."""
        places: dict[bytes, list[int]] = {}
        for place, packed in enumerate(np.packbits(self.seen, axis=1)):
            places.setdefault(packed.tobytes(), []).append(place)
        for members in places.values():
            yield np.array(members), self.seen[members[0]]


def _cut(samples: FloatArray, seen: BoolArray) -> _Blocks:
    """Cut a record into blocks; short ones where many have holes of their own."""
    count = -(-samples.size // _WHOLE)
    padded = np.zeros(count * _WHOLE, dtype=bool)
    padded[: seen.size] = seen
    whole = padded.reshape(count, _WHOLE)
    kinds = len({packed.tobytes() for packed in np.packbits(whole, axis=1)})
    length = _HOLED if kinds > max(_MANY * count, 3) else _WHOLE
    count = -(-samples.size // length)
    filled = np.zeros((2, count * length))
    filled[0, : samples.size] = np.where(seen, samples, 0.0)
    filled[1, : samples.size] = seen
    shape = (count, length)
    return _Blocks(samples=filled[0].reshape(shape), seen=filled[1].reshape(shape) > 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """Smoothed states at the blocks' starts and ends, level and slope at the end of each.

    Attributes
    ----------
    mean
        Shape (b, 2d + p): states at the start, states at the end, level and slope.
    covariance
        Shape (b, 2d + p, 2d + p).
    """

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, states: LatentStates, blocks: _Blocks, block: BlockLaw) -> "_Ends":
        """Filter forwards and smooth backwards over the blocks."""
        d, p = states.size, len(states.flat)
        told, weighed, gained = _gather(blocks, block)
        steps = [states.extension(i / blocks.count) for i in range(blocks.count)]
        inverse, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
        inverse[:d, :d] = np.diag(np.where(np.isinf(states.start), 0.0, 1 / states.start))
        # A first block of one sample says nothing of a slope, and what has no bound has no inverse.
        inverse[d:, d:] = np.eye(p) / (_FLAT * max(1.0, float(np.abs(blocks.samples).max()))) ** 2
        held = []
        for (information, passed, rest), step, weight, gain in zip(told, steps, weighed, gained, strict=True):
            covariance = inverse_of(inverse + step.T @ information @ step)
            mean = covariance @ (inverse @ mean + step.T @ weight)
            forward = np.concatenate([passed @ step, np.eye(d + p)[d:]])
            ahead = forward @ covariance @ forward.T
            ahead[:d, :d] += rest
            inverse = inverse_of(ahead)
            predicted = forward @ mean
            predicted[:d] += gain
            held.append((mean, covariance, forward @ covariance, ahead, inverse, predicted))
            mean = predicted
        return cls._backwards(held, d, p)

    @classmethod
    def _backwards(cls, held: Sequence[tuple[FloatArray, ...]], d: int, p: int) -> "_Ends":
        """Smooth: each block's start given its end, whose mean and covariance are known from the last on."""
        last = held[-1]
        end_mean, end_covariance = last[5], last[3]
        means = np.empty((len(held), 2 * d + p))
        covariances = np.empty((len(held), 2 * d + p, 2 * d + p))
        for block in range(len(held) - 1, -1, -1):
            mean, covariance, cross, ahead, inverse, predicted = held[block]
            gain = cross.T @ inverse
            start_mean = mean + gain @ (end_mean - predicted)
            start_covariance = covariance + gain @ (end_covariance - ahead) @ gain.T
            joint = gain @ end_covariance
            # Level and slope are the same at both ends, to the last digit.
            start_mean[d:], start_covariance[d:, d:] = end_mean[d:], end_covariance[d:, d:]
            start_covariance[:d, d:], start_covariance[d:, :d] = joint[:d, d:], joint[:d, d:].T
            means[block] = np.concatenate([start_mean[:d], end_mean])
            covariances[block, :d, :d] = start_covariance[:d, :d]
            covariances[block, :d, d:] = joint[:d]
            covariances[block, d:, :d] = joint[:d].T
            covariances[block, d:, d:] = end_covariance
            end_mean, end_covariance = start_mean, start_covariance
        return cls(mean=means, covariance=covariances)


def _gather(blocks: _Blocks, block: BlockLaw) -> tuple[list[_Summary], FloatArray, FloatArray]:
    """Return what each block tells, and its samples weighed for its start and for its end."""
    told: list[_Summary] = [(block.passed, block.passed, block.passed)] * blocks.count
    d = block.end.size
    weighed, gained = np.empty((blocks.count, d + 2)), np.empty((blocks.count, d))
    for members, seen in blocks.alike():
        one = Told.of(block, seen)
        own = blocks.samples[members][:, seen]
        weighed[members] = own @ one.weights.T
        gained[members] = own @ one.gain.T
        for place in members.tolist():
            told[place] = (one.information, one.passed, one.rest)
    return told, weighed, gained


def _components(
    inside: Inside, blocks: _Blocks, ends: _Ends, members: IntArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield each component's key, means and variances in some blocks, shapes (b, length)."""
    own = blocks.samples[members][:, inside.seen]
    extended, covariance = _extended(inside.states, blocks, ends, members)
    for key, of_ends in inside.of_ends.items():
        mean = own @ inside.of_samples[key].T + extended @ of_ends.T
        yield key, mean, _spread(covariance, of_ends) + inside.left[key]
    d, B = inside.states.size, blocks.length
    for i, name in enumerate(inside.states.flat):
        mean, variance = ends.mean[members, 2 * d + i], ends.covariance[members, 2 * d + i, 2 * d + i]
        time = np.ones((members.size, B))
        if name == "R":
            time = (members[:, np.newaxis] + np.arange(B) / B) / blocks.count
        yield name, mean[:, np.newaxis] * time, variance[:, np.newaxis] * time**2


def _spread(covariance: FloatArray, of_ends: FloatArray) -> FloatArray:
    """Return the variances, shape (b, length), of `of_ends`, shape (length, e), times the blocks' ends."""
    if covariance.shape[0] < _FEW:
        return np.asarray(np.sum(of_ends @ covariance * of_ends, axis=2))
    # One product for all blocks: of the pairs of columns with the covariances' upper halves.
    row, column = np.triu_indices(of_ends.shape[1])
    pairs = of_ends[:, row] * of_ends[:, column] * np.where(row == column, 1.0, 2.0)
    spread: FloatArray = covariance[:, row, column] @ pairs.T
    return spread


def _extended(
    states: LatentStates, blocks: _Blocks, ends: _Ends, members: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the blocks' extended starts and ends, shape (b, 2d + 2)."""
    steps = np.array([_step(states, block / blocks.count) for block in members.tolist()])
    mean = np.einsum("bij,bj->bi", steps, ends.mean[members])
    return mean, steps @ ends.covariance[members] @ np.swapaxes(steps, 1, 2)


def _step(states: LatentStates, time: float) -> FloatArray:
    """Return the map from start, end, level and slope to extended start and end."""
    d, p = states.size, len(states.flat)
    step = np.zeros((2 * d + 2, 2 * d + p))
    extension = states.extension(time)
    step[: d + 2, :d], step[: d + 2, 2 * d :] = extension[:, :d], extension[:, d:]
    step[d + 2 :, d : 2 * d] = np.eye(d)
    return step
