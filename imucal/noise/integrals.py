"""The Allan variance of any noise: an integral of its psd, or a sum of its autocovariance.

For a process y sampled at tau0 and averaging factor m,

    avar(m) = 2 * integral from 0 to 1/(2 tau0) of S(f) 2 sin^4(pi f m tau0) / (m sin(pi f tau0))^2 df
            = sum over k = 1 … 2m-1 of w_k (r_0 - r_k) / m^2,   w_k = (2m - k) - 4 max(m - k, 0)

with the two-sided psd S of the *samples* and their autocovariance r. For a rate in continuous time,
averaged over tau = m tau0, the first becomes

    avar(tau) = 2 * integral from 0 to infinity of S(f) 2 sin^4(pi f tau) / (pi f tau)^2 df.

Source: Guerrier, Molinari, Stebler: Allan variance, lemmas 4.1 and 4.2; IEEE Std 952-1997, eq. (C.4).

A psd as a function of frequency that checks what it returns.

Panels of the integral of a psd times sin^4: what one costs does not grow with the averaging factor.

On a panel that sin^4 crosses many times the psd over the squared sine is a sum of Legendre polynomials,
whose integrals against cosines are spherical Bessel functions (Filon's idea).

Source: Filon's idea with Legendre polynomials: Bakhvalov & Vasil'eva (1968), USSR Comput. Math. 8, 241.

The integral of a psd times the kernel of the Allan variance, octave by octave.

It is taken panel by panel, four an octave, narrower where the psd asks for it. Octaves follow each other
towards 0 (and infinity) until what is left is a geometric tail.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray, IntArray

#: A psd of frequencies in Hz, shape (k,); or frequencies that rise, and the psd there.
Psd: TypeAlias = Callable[[FloatArray], ArrayLike] | tuple[ArrayLike, ArrayLike]


def psd_function(psd: Psd) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """Return the psd as a checked function, and where it has corners."""
    if callable(psd):
        function, corners = psd, np.zeros(0)
    else:
        function, corners = _function_of_points(*psd)

    def checked(f: FloatArray) -> FloatArray:
        with np.errstate(over="ignore", divide="ignore"):
            values = np.asarray(function(f.ravel()), dtype=np.float64)
        if values.shape != (f.size,):
            msg = f"psd must return shape ({f.size},) for frequencies of that shape, got {values.shape}"
            raise ValueError(msg)
        wrong = np.flatnonzero(~(values >= 0))
        if wrong.size:
            at = wrong[0]
            msg = f"psd must be 0 or more everywhere, got {values[at]:g} at {f.ravel()[at]:.6g} Hz"
            raise ValueError(msg)
        return values.reshape(f.shape)

    return checked, corners


def _function_of_points(
    frequency: ArrayLike, density: ArrayLike
) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """Return the function that runs straight on logarithmic axes between points, and the points."""
    f, s = np.asarray(frequency, dtype=np.float64), np.asarray(density, dtype=np.float64)
    if f.ndim != 1 or f.shape != s.shape or not f.size:
        msg = f"a psd of arrays must be two of one shape (k,), got {f.shape} and {s.shape}"
        raise ValueError(msg)
    if not (f[0] > 0 and np.all(np.diff(f) > 0) and np.all(np.isfinite(f))):
        msg = "frequencies of a psd must rise, and be positive and finite"
        raise ValueError(msg)
    if not (np.all(s > 0) and np.all(np.isfinite(s))):
        at = int(np.argmin((s > 0) & np.isfinite(s)))
        msg = f"psd given by points must be positive and finite, got {s[at]:g} at {f[at]:.6g} Hz"
        raise ValueError(msg)
    x, y = np.log(f), np.log(s)
    return (lambda at: np.exp(np.interp(np.log(at), x, y))), f


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


#: Panels of an octave, and most of them after halving.
_PER_OCTAVE, _MOST_PANELS = 4, 20_000
#: Relative error that panels are halved for, and how many times one is halved.
_TOLERANCE, _HALVINGS = 1e-11, 60
#: Octaves beyond the band of the shortest and longest averages: a batch, and all of them.
_BATCH, _FURTHEST = 32, 448
#: A tail whose octaves shrink by less than this goes on for ever.
_DIVERGENT = 1 - 1e-6
#: Part of the whole below which a tail is of no interest.
_NEGLIGIBLE = 1e-14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PsdIntegral:
    """2 * integral of density * kernel, in cycles a sample, for every m at once.

    `density` takes frequencies of shape (p, nodes); `tau0` is for messages.
    """

    density: Density
    m: FloatArray
    sampled: bool
    breaks: FloatArray
    tau0: float

    def total(self) -> FloatArray:
        """Return the integral at each m, shape (k,)."""
        if not self.m.size:
            return np.zeros(0)
        # Between them lie the frequencies that averages of all lengths look at.
        octaves = math.ceil(math.log2(float(self.m.max()))) + 4
        high = 0.5 if self.sampled else 8.0
        edges = high * 0.5 ** np.arange(octaves + math.log2(high) + 1)
        # What errors are held against; a peak that it misses only makes it stricter.
        rough = self._octaves(edges, None).sum(axis=0)
        total: FloatArray = self._octaves(edges, rough).sum(axis=0)
        total = total + self._tail(float(edges[-1]), 0.5, total)
        return total if self.sampled else total + self._tail(high, 2.0, total)

    def _tail(self, edge: float, ratio: float, total: FloatArray) -> FloatArray:
        """Return the sum over the octaves that follow each other from `edge` without end."""
        parts = np.zeros((0, self.m.size))
        for batch in range(_FURTHEST // _BATCH):
            edges = edge * ratio ** np.arange(batch * _BATCH, (batch + 1) * _BATCH + 1.0)
            parts = np.concatenate([parts, self._octaves(edges, total, ending=True)])
            finite = np.isfinite(parts).all(axis=1)
            if not finite.all():
                parts = parts[: int(np.argmin(finite))]
                break
            if np.all(parts[-1] <= _NEGLIGIBLE * (total + parts.sum(axis=0))):
                return np.asarray(parts.sum(axis=0))
        # What is left falls by a steady factor an octave, or does not.
        fall = np.ones(self.m.size)
        if len(parts) >= 8:
            last, before = parts[-4:].sum(axis=0), parts[-8:-4].sum(axis=0)
            with np.errstate(invalid="ignore", divide="ignore"):
                fall = np.where(last > 0, last / before, 0.0) ** 0.25
        if not np.all(fall < _DIVERGENT):
            where, steep = ("0", "1/f^3") if ratio < 1 else ("infinity", "f")
            msg = (
                f"the Allan variance is infinite: towards a frequency of {where} the psd grows like {steep}"
                " or more steeply"
            )
            raise ValueError(msg)
        return np.asarray(parts.sum(axis=0) + parts[-1] * fall / (1 - fall))

    def _octaves(self, edges: FloatArray, scale: FloatArray | None, *, ending: bool = False) -> FloatArray:
        """Return the integral between neighbouring `edges`, shape (o + 1,), at each m: shape (o, k).

        Panels are halved until their errors are nothing beside `scale`; not at all without one. At an
        end the integral may be infinite.
        """
        octave, left, right = self._layout(edges)
        total = np.zeros((edges.size - 1, self.m.size))
        for halving in range(_HALVINGS + 1):
            panels = Panels.of(left, right, self.density, sampled=self.sampled)
            finite = np.isfinite(panels.values)
            if not finite.all() and not ending:
                at = float(panels.nodes.ravel()[int(np.argmin(finite))])
                msg = f"psd must be finite, got inf at {at / self.tau0:.6g} Hz"
                raise ValueError(msg)
            broken = ~finite.all(axis=1)
            total[octave[broken]] = np.inf
            panels = replace(panels, values=np.where(finite, panels.values, 0.0))
            part = panels.integrate(self.m)
            done = np.ones(left.size, dtype=bool)
            if scale is not None:
                error = panels.roughness()
                small = np.all(error * part <= _TOLERANCE * scale[:, np.newaxis], axis=0)
                done = small | (error <= _TOLERANCE) | broken | (halving == _HALVINGS)
            np.add.at(total, octave[done & ~broken], part[:, done & ~broken].T)
            if done.all():
                break
            octave, left, right = np.tile(octave[~done], 2), left[~done], right[~done]
            middle = (left + right) / 2
            left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
            if left.size > _MOST_PANELS:
                msg = f"psd is too rough near {left[0] / self.tau0:.6g} Hz to be integrated; smooth it first"
                raise ValueError(msg)
        return total

    def _layout(self, edges: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the first panels: the octave that each lies in, its left and its right end."""
        rising = np.sort(edges)
        places = np.exp2(np.arange((rising.size - 1) * _PER_OCTAVE + 1) / _PER_OCTAVE) * rising[0]
        inside = self.breaks[(self.breaks > rising[0]) & (self.breaks < rising[-1])]
        ends = np.union1d(places, inside)
        octave = np.searchsorted(rising, (ends[:-1] + ends[1:]) / 2) - 1
        if edges[0] > edges[-1]:
            octave = edges.size - 2 - octave
        return octave, ends[:-1], ends[1:]


#: An autocovariance of lags 0, 1, 2 …, shape (k,); or its values there, 0 beyond.
Acvf: TypeAlias = Callable[[FloatArray], ArrayLike] | ArrayLike
#: Values that may stand for 0 by rounding, relative to the variance.
_ROUNDING = 1e-9


def avar_from_psd(
    psd: Psd, m: ArrayLike, tau0: float, *, sampled: bool = True, breaks: Sequence[float] = ()
) -> FloatArray:
    """Return the Allan variance of a noise of any psd.

    Parameters
    ----------
    psd
        Two-sided density in U²/Hz (half of a one-sided one): a function of frequencies in Hz, shape
        (k,), called for positive ones only; or two arrays, frequencies that rise and the density
        there, between which it runs straight on logarithmic axes and beyond which it stays as it is.
        It may grow towards 0 less steeply than 1/f³.
    m
        Averaging factors, whole numbers from 1, any shape.
    tau0
        Sampling period in s.
    sampled
        The psd is that of the samples, used up to 1/(2 tau0). False: that of a rate in continuous
        time, averaged over m tau0, used at all frequencies; it may grow less steeply than f.
    breaks
        Frequencies in Hz where the psd jumps or peaks within less than a hundredth of itself, which
        could otherwise be missed.

    Returns
    -------
    The Allan variance, shape of `m`, in U²; right to some 1e-9 of itself.

    Raises
    ------
    ValueError
        If an argument is out of range, the psd is negative or not finite somewhere, or the integral
        is infinite; the message says where.

    Examples
    --------
    White noise of variance 1 per sample at 100 Hz has the psd 0.01 U²/Hz:

    >>> float(avar_from_psd(lambda f: 0.01 + 0 * f, [4], 0.01)[0])
    0.25
    """
    factors = _factors(m)
    if not (math.isfinite(tau0) and tau0 > 0):
        msg = f"tau0 must be positive and finite, got {tau0}"
        raise ValueError(msg)
    density, kinks = psd_function(psd)
    kinks = np.concatenate([kinks, np.asarray(breaks, dtype=np.float64)]) * tau0
    distinct, place = np.unique(factors, return_inverse=True)
    integral = PsdIntegral(
        density=lambda f: density(f / tau0) / tau0,
        m=distinct,
        sampled=sampled,
        breaks=np.unique(kinks[np.isfinite(kinks) & (kinks > 0)]),
        tau0=tau0,
    )
    return integral.total()[place].reshape(np.shape(m))


def avar_from_acvf(acvf: Acvf, m: ArrayLike) -> FloatArray:
    """Return the Allan variance of stationary samples of any autocovariance.

    Parameters
    ----------
    acvf
        Autocovariance in U²: a function of lags 0, 1, 2 … as an array, shape (k,); or its values at
        those lags, 0 beyond the last.
    m
        Averaging factors, whole numbers from 1, any shape.

    Returns
    -------
    The Allan variance, shape of `m`, in U². Cost: 2m values of `acvf` for the greatest m.

    Raises
    ------
    ValueError
        If a factor is no whole number from 1, or `acvf` is not finite or no autocovariance: beyond
        that of lag 0, or such that an Allan variance would be negative.

    Examples
    --------
    A moving average y = e[t] + 0.5 e[t-1] of unit white noise: (1.5² m - 1.5) / m².

    >>> avar_from_acvf([1.25, 0.5], [1, 2]).tolist()
    [0.75, 0.75]
    """
    factors = _factors(m)
    variance, fall = _falls(acvf, int(factors.max(initial=1.0)))
    total = np.empty(factors.size)
    for i, factor in enumerate(factors.astype(np.int64).tolist()):
        k = np.arange(1.0, 2 * factor)
        weight = (2 * factor - k) - 4 * np.maximum(factor - k, 0.0)
        total[i] = float(weight @ fall[1 : 2 * factor]) / factor**2
        if total[i] < -_ROUNDING * variance:
            msg = f"acvf is no autocovariance: the Allan variance at m = {factor} would be {total[i]:.3g}"
            raise ValueError(msg)
    return np.maximum(total, 0.0).reshape(np.shape(m))


def _factors(m: ArrayLike) -> FloatArray:
    """Return averaging factors as shape (k,), which must be whole numbers from 1."""
    factors = np.asarray(m, dtype=np.float64).ravel()
    wrong = factors[~(np.isfinite(factors) & (factors >= 1) & (factors == np.round(factors)))]
    if wrong.size:
        msg = f"averaging factors must be whole numbers from 1, got {wrong[0]:g}"
        raise ValueError(msg)
    return factors


def _falls(acvf: Acvf, greatest: int) -> tuple[float, FloatArray]:
    """Return r_0 and r_0 - r_k at k = 0 … 2 m - 1, the autocovariance checked."""
    lags = np.arange(2.0 * greatest)
    if callable(acvf):
        values = np.asarray(acvf(lags), dtype=np.float64)
        if values.shape != lags.shape:
            msg = f"acvf must return shape {lags.shape} for lags of that shape, got {values.shape}"
            raise ValueError(msg)
    else:
        given = np.asarray(acvf, dtype=np.float64)
        if given.ndim != 1 or not given.size:
            msg = f"acvf must have shape (k,) with at least lag 0, got {given.shape}"
            raise ValueError(msg)
        values = np.zeros(max(lags.size, given.size))
        values[: given.size] = given
    finite = np.isfinite(values)
    if not finite.all():
        at = int(np.argmin(finite))
        msg = f"acvf must be finite, got {values[at]:g} at lag {at}; a random walk has none: use its psd"
        raise ValueError(msg)
    beyond = np.abs(values) > values[0] * (1 + _ROUNDING)
    if values[0] < 0 or beyond.any():
        at = 0 if values[0] < 0 else int(np.argmax(beyond))
        msg = f"acvf is no autocovariance: {values[at]:g} at lag {at} beside a variance of {values[0]:g}"
        raise ValueError(msg)
    return float(values[0]), values[0] - values[: lags.size]
