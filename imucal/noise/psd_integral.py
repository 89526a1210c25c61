"""The integral of a psd times the kernel of the Allan variance, octave by octave.

It is taken panel by panel, four an octave, narrower where the psd asks for it. Octaves follow each other
towards 0 (and infinity) until what is left is a geometric tail.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.noise.filon_panels import Density, Panels

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
