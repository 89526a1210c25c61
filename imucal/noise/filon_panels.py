"""Panels of the integral of a psd times sin^4: what one costs does not grow with the averaging factor.

On a panel that sin^4 crosses many times the psd over the squared sine is a sum of Legendre polynomials,
whose integrals against cosines are spherical Bessel functions (Filon's idea).

Source: Filon's idea with Legendre polynomials: Bakhvalov & Vasil'eva (1968), USSR Comput. Math. 8, 241.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from imucal.arrays import FloatArray

#: A density of frequencies in cycles a sample, of any shape.
Density: TypeAlias = Callable[[FloatArray], FloatArray]
#: A panel over which the phase of sin^4 grows by less is summed as it is.
_CALM = 4.0
#: Gauss's nodes of a panel, and Legendre polynomials through them.
_NODES = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panels:
    """Intervals of frequency, shape (p,), and the density at Gauss's nodes in each, shape (p, nodes)."""

    left: FloatArray
    right: FloatArray
    nodes: FloatArray
    values: FloatArray
    sampled: bool

    @classmethod
    def of(cls, left: FloatArray, right: FloatArray, density: Density, *, sampled: bool) -> "Panels":
        """Return panels between `left` and `right`, shape (p,), of a density of nodes, shape (p, nodes)."""
        x, _ = np.polynomial.legendre.leggauss(_NODES)
        nodes = (left + right)[:, np.newaxis] / 2 + (right - left)[:, np.newaxis] / 2 * x
        return cls(left=left, right=right, nodes=nodes, values=density(nodes), sampled=sampled)

    def _lower(self) -> FloatArray:
        """Return what the squared sine of m is divided by, over m, shape (p, nodes)."""
        half = np.pi * self.nodes
        return np.sin(half) if self.sampled else half

    def roughness(self) -> FloatArray:
        """Return how large each panel's highest polynomials are beside its largest, shape (p,)."""
        greatest = self.values.max(axis=1, keepdims=True)
        size = np.abs(self._coefficients(self.values / np.where(greatest > 0, greatest, 1.0)))
        return np.asarray(size[:, -3:].max(axis=1) / np.maximum(size.max(axis=1), 0.1))

    @staticmethod
    def _coefficients(values: FloatArray) -> FloatArray:
        """Return the coefficients of Legendre polynomials through the nodes, shape (p, nodes)."""
        x, weight = np.polynomial.legendre.leggauss(_NODES)
        order = np.arange(_NODES)
        basis = np.polynomial.legendre.legvander(x, _NODES - 1) * weight[:, np.newaxis]
        return np.asarray(values @ basis * (order + 0.5))

    def integrate(self, m: FloatArray) -> FloatArray:
        """Return 2 * the integral over each panel at each m, shape (k, p)."""
        width = self.right - self.left
        calm = np.pi * np.outer(m, width) < _CALM
        total = np.zeros(calm.shape)
        _, weight = np.polynomial.legendre.leggauss(_NODES)
        lower = self._lower()
        for i, factor in enumerate(m.tolist()):
            here = calm[i]
            if here.any():
                sine = np.sin(np.pi * factor * self.nodes[here])
                # In this order, so that nothing underflows at the lowest frequencies.
                kernel = 2 * (sine / (factor * lower[here])) ** 2
                inside = (self.values[here] * sine) * sine * kernel
                total[i, here] = inside @ weight * width[here]
        wild = ~calm.all(axis=0)
        if wild.any():
            shape = self._coefficients(self.values[wild] / lower[wild] ** 2)
            mixed = _against_sines(shape, self.left[wild], self.right[wild], m)
            total[:, wild] = np.where(calm[:, wild], total[:, wild], mixed)
        return total


def _against_sines(shape: FloatArray, left: FloatArray, right: FloatArray, m: FloatArray) -> FloatArray:
    """Return 4/m² * the integral of a sum of Legendre polynomials times sin^4(pi m f), shape (k, p).

    sin^4 u = 3/8 - cos(2u)/2 + cos(4u)/8, and P_j against exp(i z x) over [-1, 1] is 2 i^j j_j(z).
    """
    from scipy.special import spherical_jn

    half, middle = (right - left) / 2, (left + right) / 2
    order = np.arange(shape.shape[1])
    total = np.empty((m.size, half.size))
    for i, factor in enumerate(m.tolist()):
        value = 0.375 * 2 * shape[:, 0]
        for share, turns in ((-0.5, 2 * np.pi * factor), (0.125, 4 * np.pi * factor)):
            bessel = spherical_jn(order, (turns * half)[:, np.newaxis])
            # Whole cycles are taken off first, or the cosine loses their digits.
            cycles = np.remainder(turns / (2 * np.pi) * middle, 1.0) * 2 * np.pi
            angle = cycles[:, np.newaxis] + np.pi / 2 * order
            value = value + share * 2 * np.sum(shape * bessel * np.cos(angle), axis=1)
        total[i] = 4 / factor**2 * half * value
    return total
