"""A sensor with its rests: their means, its noise, and how much it moved in them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.noise_source import NoiseBase, base_covariance, noise_base
from imucal.calibration.poses import RestMeans, Triad
from imucal.calibration.slow_noise import walk_covariance
from imucal.noise import NoiseModel
from imucal.report.result import Report

__all__ = ["RestedSensor"]


@dataclass(frozen=True, kw_only=True, eq=False)
class RestedSensor:
    """A sensor with its rests and its noise."""

    data: Triad
    rests: RestMeans
    base: NoiseBase
    movement: FloatArray

    @classmethod
    def of(
        cls,
        data: Triad,
        spans_s: FloatArray,
        noise: Report | Mapping[str, NoiseModel] | None,
        scale: Callable[[RestMeans], FloatArray],
    ) -> "RestedSensor":
        rests = RestMeans.of(data, spans_s)
        base = noise_base(noise, data, rests, scale)
        return cls(data=data, rests=rests, base=base, movement=np.zeros_like(rests.means))

    def keeping(self, keep: BoolArray) -> "RestedSensor":
        rests = replace(self.rests, spans=self.rests.spans[keep], means=self.rests.means[keep])
        return replace(self, rests=rests, movement=self.movement[keep])

    def moving(self, moved: BoolArray) -> "RestedSensor":
        """Return the sensor with the movement in the rests `moved`: the mean may be off by as much."""
        movement = self.movement.copy()
        for k in np.flatnonzero(moved):
            first, end = self.rests.spans[k]
            middle = (first + end) // 2
            halves = self.data.samples[first:middle].mean(axis=0), self.data.samples[middle:end].mean(axis=0)
            movement[k] = np.abs(halves[1] - halves[0])
        return replace(self, movement=movement)

    @property
    def covariance(self) -> FloatArray:
        noise = base_covariance(self.base.models, self.data, self.rests)
        return np.asarray(noise + np.array([np.diag(size**2) for size in self.movement.T]))

    @property
    def walk(self) -> FloatArray:
        return walk_covariance(self.rests.spans, rate_hz=self.data.rate_hz, samples=len(self.data.samples))
