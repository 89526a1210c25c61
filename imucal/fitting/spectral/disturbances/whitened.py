"""The gain of regressors in the log-likelihood, without a fit of each.

At a given spectrum it is half the squared correlation of a regressor with the whitened ordinates, after both
are made orthogonal to the fit's regressors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.fitting.regressors import Bump, LevelChange, Regressor, Stretch, cycle_ordinates
from imucal.fitting.spectral.blocks import Block

#: Number of places in a block to search for a step.
_PLACES = 8192
#: Ordinates that contain nearly all power of a smooth shape.
_OF_SMOOTH = 512
#: Share of a block at each end where a step resembles the block's mean.
_CLEAR = 0.005
#: Remaining share of a shape below which it is collinear with the fit's regressors.
_COLLINEAR = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Whitened:
    """The lowest ordinates of blocks, divided by the root of their spectrum, minus the fitted regressors.

    `weight` is 1/sqrt(S) of each block's ordinates, 0 if they are left out. `rest` are the whitened ordinates
    of all blocks, shape (K,), and `base`, (K, r), an orthonormal basis of the whitened regressors.
    """

    blocks: tuple[Block, ...]
    weight: tuple[FloatArray, ...]
    rest: FloatArray
    base: FloatArray

    @classmethod
    def by(cls, blocks: Sequence[Block], spectrum: FloatArray, fitted: Sequence[Regressor]) -> "Whitened":
        """Return the ordinates whitened by the bins' `spectrum`, shape (b,), minus `fitted` regressors."""
        parts = np.split(spectrum, np.cumsum([block.bins.size for block in blocks])[:-1])
        weights = []
        for block, part in zip(blocks, parts, strict=True):
            # Missing samples reduce the power.
            share = 1.0 if block.loss is None else 1 - block.loss
            own = np.repeat(np.sqrt(share / part), block.bins.count)
            weights.append(own if block.kept is None else np.where(block.kept, own, 0.0))
        own = np.concatenate([block.ordinates * w for block, w in zip(blocks, weights, strict=True)])
        plain = cls(blocks=tuple(blocks), weight=tuple(weights), rest=own, base=np.zeros((own.size, 0)))
        base = np.linalg.qr(plain.columns(fitted))[0]
        return replace(plain, rest=own - base @ (base.T @ own), base=base)

    def columns(self, regressors: Sequence[Regressor]) -> FloatArray:
        pairs = list(zip(self.blocks, self.weight, strict=True))
        columns = [np.concatenate([block.ordinates_of(one) * w for block, w in pairs]) for one in regressors]
        return np.stack(columns, axis=1) if columns else np.zeros((self.rest.size, 0))

    def gain(self, regressors: Sequence[Regressor]) -> float:
        """Return twice the log-likelihood that regressors gain together."""
        columns = self.columns(regressors)
        columns -= self.base @ (self.base.T @ columns)
        solution = np.linalg.lstsq(columns, self.rest, rcond=_COLLINEAR)[0]
        return float(self.rest @ (columns @ solution))

    def lowest(self, count: int = _OF_SMOOTH) -> "Whitened":
        """Return the lowest ordinates, with truncated basis."""
        blocks = tuple(block.lowest(max(count // len(self.blocks), 1)) for block in self.blocks)
        sizes = [block.ordinates.size for block in self.blocks]
        starts = np.cumsum([0, *sizes[:-1]])
        rows = np.concatenate([s + np.arange(b.ordinates.size) for s, b in zip(starts, blocks, strict=True)])
        weight = tuple(w[: b.ordinates.size] for w, b in zip(self.weight, blocks, strict=True))
        return Whitened(blocks=blocks, weight=weight, rest=self.rest[rows], base=self.base[rows])

    def gains_alone(self, regressors: Sequence[Regressor]) -> FloatArray:
        """Return the gain of each regressor alone."""
        columns = self.columns(regressors)
        whole = np.sum(columns**2, axis=0)
        columns -= self.base @ (self.base.T @ columns)
        size = np.sum(columns**2, axis=0)
        return np.where(
            size > _COLLINEAR**2 * whole, (self.rest @ columns) ** 2 / np.maximum(size, 1e-300), 0.0
        )

    def cycles(self, omega: FloatArray) -> FloatArray:
        """Return the gain of a cycle of each angular frequency, rad/sample."""
        shapes, quarter = [], np.array([0.0, -np.pi / 2])[:, np.newaxis, np.newaxis]
        for block, own in zip(self.blocks, self.weight, strict=True):
            theta = np.pi / block.bins.n * np.arange(1, block.ordinates.size + 1, dtype=np.float64)
            shift = omega[:, np.newaxis] * block.offset + quarter
            shapes.append(cycle_ordinates(block.bins.n, theta, omega[:, np.newaxis], shift) * own)
        pairs = np.concatenate(shapes, axis=-1)
        pairs -= (pairs @ self.base) @ self.base.T
        products = np.moveaxis(pairs @ self.rest, 0, -1)
        size, vectors = np.linalg.eigh(np.einsum("iwk,jwk->wij", pairs, pairs))
        along = np.einsum("wij,wi->wj", vectors, products)
        independent = size > _COLLINEAR**2 * size[:, -1:]
        return np.asarray(
            np.sum(np.where(independent, along**2 / np.where(independent, size, 1.0), 0.0), axis=-1)
        )

    def levels(self, shape: type[LevelChange] | type[Bump], places: FloatArray, width: float) -> FloatArray:
        """Return the gain of a change of level, or of a bump, of this `width` at each of the `places`."""
        parts = []
        for block, own in zip(self.blocks, self.weight, strict=True):
            stretch = Stretch(n=block.bins.n, offset=block.offset)
            parts.append(shape.ordinates_at(places, width, stretch, block.ordinates.size) * own)
        shapes = np.concatenate(parts, axis=-1)
        whole = np.sum(shapes**2, axis=-1)
        shapes -= (shapes @ self.base) @ self.base.T
        size = np.sum(shapes**2, axis=-1)
        independent = size > _COLLINEAR**2 * whole
        return np.where(independent, (shapes @ self.rest) ** 2 / np.where(independent, size, 1.0), 0.0)

    def step(self, taken: Sequence[float] = (), apart: float = 0.0) -> tuple[float, float, float]:
        """Return the place of the step that gains most, in samples of the record, its gain, and the choice.

        Places nearer than `apart` to one of `taken` are left out. The choice is the effective number of
        independent places: in pure noise the best gain exceeds u with a probability of about this number
        times exp(-u/2).
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


def _best_step(
    block: Block,
    weight: FloatArray,
    rest: FloatArray,
    base: FloatArray,
    without: Sequence[tuple[float, float]],
) -> tuple[float, float, float]:
    """Return place and gain of the best step inside one block, and the number of places to choose among.

    Sine transforms give the products of all places at once. The number is the expected count of zero
    crossings in pure noise, by Rice (1945), Bell Syst. Tech. J. 24, 46: the length of the path of whitened
    steps of size one, over pi.
    """
    n, count = block.bins.n, weight.size
    places = max(_PLACES, 2 * count)
    half = np.pi / (2 * n) * np.arange(1, count + 1)
    size = np.sqrt(2 / n) / (2 * np.sin(half)) * weight

    def along(values: FloatArray) -> FloatArray:
        """Return sum of values_k sin(pi k j / places) at j = 1 … places-1; shape (…, places-1)."""
        padded = np.zeros((*values.shape[:-1], places - 1))
        padded[..., :count] = values
        return np.asarray(scipy.fft.dst(padded, type=1, axis=-1) / 2)

    def of_twice(values: FloatArray) -> FloatArray:
        """Return sum of values_k cos(2 pi k j / places) at j = 1 … places-1."""
        square = np.zeros(places + 1)
        square[2 : 2 * count + 1 : 2] = values
        return np.asarray((scipy.fft.dct(square, type=1) + square[-1]) / 2)[1:-1]

    # sin² = (1 - cos of twice the angle) / 2, and its slope's square is k² cos² = k² (1 + cos) / 2.
    power = 0.5 * (np.sum(size**2) - of_twice(size**2))
    slope = (size * np.pi / places * np.arange(1, count + 1)) ** 2
    slope = 0.5 * (np.sum(slope) + of_twice(slope))
    left = power - np.sum(along((base * size[:, None]).T) ** 2, axis=0)
    product = along(rest * size)
    gain = np.where(left > _COLLINEAR * power + 1e-300, product**2 / np.maximum(left, 1e-300), 0.0)
    clear = int(_CLEAR * places) + 1
    gain[:clear] = gain[gain.size - clear :] = 0.0
    where = block.offset + np.arange(1, places) * n / places
    for low, high in without:
        gain[(where > low) & (where < high)] = 0.0
    at = int(np.argmax(gain))
    # Changes of size alone do not count.
    way = slope / power - (np.gradient(power) / (2 * power)) ** 2
    choice = float(np.sqrt(np.maximum(way, 0.0))[clear : gain.size - clear].sum()) / np.pi
    return float(where[at]), float(gain[at]), choice
