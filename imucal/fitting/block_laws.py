"""A block of samples given the states at its ends: covariances in closed form, and what follows.

Which samples a block misses decides all of it, so that one set of matrices serves all blocks that are
whole.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.latent_states import BIAS, LatentStates


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartLaw:
    """What a component's covariances are, given the states at a block's start of B samples.

    Attributes
    ----------
    variance
        Of the component at each sample, shape (B,).
    with_samples, with_end
        Covariance with each sample, shape (B, B), and with each state at the block's end, (B, d).
    trace
        What the extended start adds to it, shape (B, d + 2).
    """

    variance: FloatArray
    with_samples: FloatArray
    with_end: FloatArray
    trace: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockLaw:
    """The covariances of a block of B samples, given the states at its start, in closed form.

    The states at the start, and level and slope in the block, are the extended start, shape (d + 2,).

    Attributes
    ----------
    samples
        Covariance of the samples, shape (B, B).
    trace
        What the extended start adds to the samples, shape (B, d + 2).
    end, passed
        Variance of the states at the end, shape (d,), and what the extended start adds to them,
        shape (d, d + 2).
    with_end
        Covariance of the samples with the states at the end, shape (B, d).
    parts
        Of each component.
    """

    samples: FloatArray
    trace: FloatArray
    end: FloatArray
    passed: FloatArray
    with_end: FloatArray
    parts: dict[str, PartLaw]

    @classmethod
    def of(cls, states: LatentStates, length: int, share: float) -> "BlockLaw":
        """Return the law of a block of so many samples, `share` of the record, the slope's unit of time."""
        d, B = states.size, length
        t = np.arange(B + 1.0)
        rate = -np.log(np.maximum(states.decay, 1e-300))[:, np.newaxis]
        with np.errstate(invalid="ignore", divide="ignore"):
            grown = np.where(rate > 0, np.expm1(-2 * rate * t) / np.expm1(-2 * rate), t)
        variance = states.drive[:, np.newaxis] * grown
        left = states.decay[:, np.newaxis] ** t
        lag = np.abs(np.subtract.outer(t, t)).astype(int)
        least = np.minimum.outer(t, t).astype(int)
        # Of each state with itself; then of samples with states, and of samples with samples.
        own = left[:, lag] * variance[:, least]
        sampled, trace = own[:, :B].copy(), left[:, :B].copy()
        if states.quantized:
            sampled[0], trace[0] = np.diff(own[0], axis=0), np.diff(left[0])
        between = sampled[:, :, :B].copy()
        if states.quantized:
            between[0] = np.diff(sampled[0], axis=1)
        local = np.stack([np.ones(B), t[:B] / B * share])
        passed = np.zeros((d, d + 2))
        passed[:, :d] = np.diag(left[:, B])
        parts = {}
        for key, group in (*states.groups.items(), (BIAS, states.everything)):
            part = np.zeros((B, d + 2))
            part[:, :d] = np.where(group, left[:, :B].T, 0.0)
            if key == BIAS:
                part[:, d:] = local.T
            parts[key] = PartLaw(
                variance=variance[group, :B].sum(axis=0),
                with_samples=sampled[group][:, :, :B].sum(axis=0).T,
                with_end=np.where(group, own[:, :B, B].T, 0.0),
                trace=part,
            )
        return cls(
            samples=between.sum(axis=0) + np.eye(B),
            trace=np.concatenate([trace, local]).T,
            end=variance[:, B],
            passed=passed,
            with_end=sampled[:, :, B].T,
            parts=parts,
        )


def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a covariance, its rows scaled first."""
    scale = 1 / np.sqrt(np.diagonal(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """What blocks that miss the same samples tell: of their start, and of their end given the start.

    Attributes
    ----------
    information, weights
        Information about the extended start, shape (d+2, d+2), and what it takes of the samples,
        shape (d+2, seen).
    passed, gain, rest
        End = passed @ extended start + gain @ samples + noise of covariance rest.
    inverse
        Of the samples' covariance given the start, shape (seen, seen).
    """

    information: FloatArray
    weights: FloatArray
    passed: FloatArray
    gain: FloatArray
    rest: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, block: BlockLaw, seen: BoolArray) -> "Told":
        inverse: FloatArray = np.asarray(np.linalg.inv(block.samples[np.ix_(seen, seen)]), dtype=np.float64)
        trace, with_end = block.trace[seen], block.with_end[seen]
        weights, gain = trace.T @ inverse, with_end.T @ inverse
        rest = np.diag(block.end) - gain @ with_end
        return cls(
            information=weights @ trace,
            weights=weights,
            passed=block.passed - gain @ trace,
            inverse=inverse,
            gain=gain,
            rest=(rest + rest.T) / 2,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inside:
    """The inside of blocks that miss the same samples, given their ends.

    For each component: mean = of_samples @ samples + of_ends @ (extended start, end), and the
    variance that is left when all of these are known.
    """

    states: LatentStates
    seen: BoolArray
    of_samples: dict[str, FloatArray]
    of_ends: dict[str, FloatArray]
    left: dict[str, FloatArray]

    @classmethod
    def of(cls, states: LatentStates, block: BlockLaw, seen: BoolArray) -> "Inside":
        told = Told.of(block, seen)
        inverse_rest = inverse_of(told.rest)
        of_samples, of_ends, left = {}, {}, {}
        for key, part in block.parts.items():
            cross = part.with_samples[:, seen]
            alone = cross @ told.inverse
            to_end = (part.with_end - alone @ block.with_end[seen]) @ inverse_rest
            to_samples = alone - to_end @ told.gain
            start = part.trace - to_samples @ block.trace[seen] - to_end @ block.passed
            of_samples[key], of_ends[key] = to_samples, np.concatenate([start, to_end], axis=1)
            known = np.sum(to_samples * cross, axis=1) + np.sum(to_end * part.with_end, axis=1)
            left[key] = part.variance - known
        return cls(states=states, seen=seen, of_samples=of_samples, of_ends=of_ends, left=left)
