"""The lowest ordinates of a record, whitened: how much each of many shapes would gain in the fit.

At a given spectrum, the log-likelihood that a regressor gains is half the square of its correlation
with the whitened ordinates, less what the regressors that are in the fit explain of both. So a
search over hundreds of shapes costs no fit; the few best are then fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.regressors import cycle_ordinates

#: Places in a block at which a step is looked for.
_PLACES = 8192
#: Ordinates, of all blocks, that hold nearly all of a cycle of 24 periods a record.
_OF_CYCLES = 512
#: Nearer to the ends of a block than this share of it, a step is not told from the block's mean.
_CLEAR = 0.005
#: What is left of a shape beside the regressors of the fit, below which it is one of them.
_ALIKE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Whitened:
    """Ordinates over the roots of their spectrum, less what the fit's regressors explain.

    Attributes
    ----------
    blocks
        Their lowest ordinates.
    weight
        1/sqrt(S) of each block's ordinates, 0 where they are left out; shapes (k,).
    rest
        The whitened ordinates of all blocks, shape (K,).
    base
        Orthonormal basis of the whitened regressors, shape (K, r).
    """

    blocks: tuple[Block, ...]
    weight: tuple[FloatArray, ...]
    rest: FloatArray
    base: FloatArray

    @classmethod
    def by(cls, blocks: Sequence[Block], spectrum: FloatArray, names: Sequence[str]) -> "Whitened":
        """Return the ordinates whitened by the bins' `spectrum`, shape (b,); the fit has `names`."""
        stops = np.cumsum([block.bins.size for block in blocks])
        parts = np.split(spectrum, stops[:-1])
        weight = tuple(_weight(block, part) for block, part in zip(blocks, parts, strict=True))
        own = np.concatenate([block.ordinates * w for block, w in zip(blocks, weight, strict=True)])
        plain = cls(blocks=tuple(blocks), weight=weight, rest=own, base=np.zeros((own.size, 0)))
        base = np.linalg.qr(plain.columns(names))[0] if names else plain.base
        return cls(blocks=tuple(blocks), weight=weight, rest=own - base @ (base.T @ own), base=base)

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return whitened regressors, shape (K, r)."""
        pairs = list(zip(self.blocks, self.weight, strict=True))
        every = [np.concatenate([block.regressor(name) * w for block, w in pairs]) for name in names]
        return np.stack(every, axis=1) if every else np.zeros((self.rest.size, 0))

    def gain(self, names: Sequence[str]) -> float:
        """Return twice the log-likelihood that regressors gain together."""
        columns = self.columns(names)
        columns -= self.base @ (self.base.T @ columns)
        solution = np.linalg.lstsq(columns, self.rest, rcond=_ALIKE)[0]
        return float(self.rest @ (columns @ solution))

    def cycles(self, omega: FloatArray) -> FloatArray:
        """Return the gain of a cycle of each angular frequency, rad/sample, shape of `omega`."""
        blocks = tuple(block.lowest(_OF_CYCLES // len(self.blocks)) for block in self.blocks)
        sizes = [block.ordinates.size for block in self.blocks]
        starts = np.cumsum([0, *sizes[:-1]])
        rows = np.concatenate([s + np.arange(b.ordinates.size) for s, b in zip(starts, blocks, strict=True)])
        weight = [w[: b.ordinates.size] for w, b in zip(self.weight, blocks, strict=True)]
        shapes = [_cycles(block, omega) * w for block, w in zip(blocks, weight, strict=True)]
        return _gains_of_pairs(np.concatenate(shapes, axis=-1), self.rest[rows], self.base[rows])

    def step(self, taken: Sequence[float] = (), apart: float = 0.0) -> tuple[float, float, float]:
        """Return the place of the step that gains most, in samples of the record, its gain, and the choice.

        Places nearer than `apart` to one that is `taken` are left out.
        The choice is the number of places that noise may choose among: by chance the gain of the best
        exceeds u with a probability of that number times exp(-u/2), where it is small.
        """
        first, choice, best = 0, 0.0, (0.0, 0.0)
        near = [(place - apart, place + apart) for place in taken]
        for block, weight in zip(self.blocks, self.weight, strict=True):
            rows = slice(first, first + weight.size)
            place, gain, places = _best_step(block, weight, self.rest[rows], self.base[rows], near)
            best = max(best, (place, gain), key=lambda b: b[1])
            choice += places
            first += weight.size
        return (*best, choice)


def _cycles(block: Block, omega: FloatArray) -> FloatArray:
    """Return a block's ordinates of the cosine and the sine of each angular frequency, shape (2, w, k)."""
    theta = np.pi / block.bins.n * np.arange(1, block.ordinates.size + 1, dtype=np.float64)
    quarter = np.array([0.0, -np.pi / 2])[:, np.newaxis, np.newaxis]
    shift = omega[:, np.newaxis] * block.offset + quarter
    return cycle_ordinates(block.bins.n, theta, omega[:, np.newaxis], shift)


def _gains_of_pairs(pairs: FloatArray, rest: FloatArray, base: FloatArray) -> FloatArray:
    """Return the gain of each of w pairs of whitened regressors, shape (2, w, K), together; shape (w,)."""
    pairs = pairs - (pairs @ base) @ base.T
    products = np.moveaxis(pairs @ rest, 0, -1)
    size, vectors = np.linalg.eigh(np.einsum("iwk,jwk->wij", pairs, pairs))
    # Along the axes of each pair; one along which there is next to nothing is no regressor of its own.
    along = np.einsum("wij,wi->wj", vectors, products)
    told = size > _ALIKE**2 * size[:, -1:]
    return np.asarray(np.sum(np.where(told, along**2 / np.where(told, size, 1.0), 0.0), axis=-1))


def _weight(block: Block, spectrum: FloatArray) -> FloatArray:
    """Return 1/sqrt(S) of each ordinate; less where missing samples took of it, 0 where it is left out."""
    share = 1.0 if block.loss is None else 1 - block.loss
    weight: FloatArray = np.repeat(np.sqrt(share / spectrum), block.bins.count)
    return weight if block.kept is None else np.where(block.kept, weight, 0.0)


def _best_step(
    block: Block,
    weight: FloatArray,
    rest: FloatArray,
    base: FloatArray,
    without: Sequence[tuple[float, float]],
) -> tuple[float, float, float]:
    """Return place and gain of the best step inside one block, and the number of places to choose among.

    A step's ordinates are sines of its place, so sine transforms give its products with everything
    at all places at once. The number is how often the root of the gain of a chance step crosses zero, by
    Rice (1945), Bell Syst. Tech. J. 24, 46: the length of the path of whitened steps of size one, over pi.
    """
    from scipy.fft import dct, dst

    n, count = block.bins.n, weight.size
    places = max(_PLACES, 2 * count)
    half = np.pi / (2 * n) * np.arange(1, count + 1)
    size = np.sqrt(2 / n) / (2 * np.sin(half)) * weight

    def along(values: FloatArray) -> FloatArray:
        """Return sum of values_k sin(pi k j / places) at j = 1 … places-1; shape (…, places-1)."""
        padded = np.zeros((*values.shape[:-1], places - 1))
        padded[..., :count] = values
        return np.asarray(dst(padded, type=1, axis=-1) / 2)

    def of_twice(values: FloatArray) -> FloatArray:
        """Return sum of values_k cos(2 pi k j / places) at j = 1 … places-1."""
        square = np.zeros(places + 1)
        square[2 : 2 * count + 1 : 2] = values
        return np.asarray((dct(square, type=1) + square[-1]) / 2)[1:-1]

    # sin² = (1 - cos of twice the angle) / 2, and its slope's square is k² cos² = k² (1 + cos) / 2.
    power = 0.5 * (np.sum(size**2) - of_twice(size**2))
    slope = (size * np.pi / places * np.arange(1, count + 1)) ** 2
    slope = 0.5 * (np.sum(slope) + of_twice(slope))
    left = power - np.sum(along((base * size[:, None]).T) ** 2, axis=0)
    product = along(rest * size)
    gain = np.where(left > _ALIKE * power + 1e-300, product**2 / np.maximum(left, 1e-300), 0.0)
    clear = int(_CLEAR * places) + 1
    gain[:clear] = gain[gain.size - clear :] = 0.0
    where = block.offset + np.arange(1, places) * n / places
    for low, high in without:
        gain[(where > low) & (where < high)] = 0.0
    at = int(np.argmax(gain))
    # The path of the steps divided by their sizes: what changes the size alone is no way.
    way = slope / power - (np.gradient(power) / (2 * power)) ** 2
    choice = float(np.sqrt(np.maximum(way, 0.0))[clear : gain.size - clear].sum()) / np.pi
    return float(where[at]), float(gain[at]), choice
