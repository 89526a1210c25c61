"""The results of a run as values; renderers are functions of a `Report`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucal.allan.dct import Spectrum
from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.clock import Gap
from imucal.display import Displayed
from imucal.errors import DataError, MissingError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.grading import NoiseVerdict, judge_findings
from imucal.prediction.filter_numbers import (
    CAMERA_HORIZON_S,
    HORIZON_S,
    STEP_S,
    FilterNumbers,
    Joined,
    filter_numbers,
)
from imucal.recording import Axis, AxisSeries, Sensor, Source

#: Shorter records do not show the errors of filters that coast for a minute, a fifth of this.
_MIN_LENGTH_S = 300.0
_WITHOUT_RESULT = ("no-data", "no-result", "stuck")


@dataclass(frozen=True, kw_only=True, eq=False)
class Overview(ReadOnlyArrays):
    """The raw signal to draw: lowest and highest sample of each of k stretches, in U, shape (k,).

    `time_s` is the middle of each stretch from the first sample. Stretches in gaps are NaN.
    """

    time_s: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def none(cls) -> "Overview":
        empty = np.zeros(0)
        return cls(time_s=empty, low=empty, high=empty)

    @classmethod
    def of(cls, series: AxisSeries, *, stretches: int = 1000) -> "Overview":
        """Return the extremes of up to `stretches` equal stretches of time."""
        clock = series.clock
        size = clock.grid_size
        if not size:
            return cls.none()
        count = min(stretches, size)
        edges = np.linspace(0, size, count + 1).round().astype(np.int64)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        origin = clock.segments[0].offset
        for segment in clock.segments:
            place = segment.offset - origin
            first = int(np.searchsorted(edges, place, side="right")) - 1
            last = int(np.searchsorted(edges, place + segment.size, side="left"))
            starts = np.maximum(edges[first:last] - place, 0) + segment.start
            samples = series.samples[: segment.stop]
            for extreme, outer in ((low, np.minimum), (high, np.maximum)):
                extreme[first:last] = outer(extreme[first:last], outer.reduceat(samples, starts))
        filled = np.isfinite(low)
        time = (edges[:-1] + edges[1:]) / 2 * clock.tau0
        return cls(time_s=time, low=np.where(filled, low, np.nan), high=np.where(filled, high, np.nan))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AxisReport(Displayed):
    """The results of one axis; units as in `Sensor.unit`.

    `fit.curve` is the Allan curve and `spectrum` the psd. `mean` and `std` describe the finite samples.
    """

    sensor: Sensor
    axis: Axis
    samples: int
    rate_hz: float
    duration_s: float
    mean: float
    std: float
    gaps: tuple[Gap, ...]
    spectrum: Spectrum
    overview: Overview
    fit: NoiseFit
    findings: tuple[Finding, ...] = ()

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return f"{self.sensor.short}_{self.axis}"

    @property
    def unit(self) -> str:
        return self.sensor.unit

    def __getitem__(self, key: str) -> Estimate:
        return self.fit[key]

    @property
    def white_error(self) -> float:
        """Half of the interval of N, relative to N; infinite if N was not estimated from samples."""
        white = self.fit["N"]
        return (white.high - white.low) / (2 * white.value) if white.value and self.samples else np.inf


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Report(Displayed):
    """A characterised recording. It computes its verdict and each pair for filters once.

    Attributes
    ----------
    axes
        Gyroscope x, y, z first. An axis that can't be analysed is missing; `findings` names it.
    settings
        Everything needed to repeat the run; JSON values only.
    findings
        Findings about the whole log.
    """

    source: Source
    axes: tuple[AxisReport, ...]
    settings: Mapping[str, object]
    version: str
    findings: tuple[Finding, ...] = ()

    def __getitem__(self, name: str) -> AxisReport:
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise MissingError(f"no axis {name!r}; the report has {', '.join(axis.name for axis in self.axes)}")

    @property
    def by_sensor(self) -> dict[Sensor, list[AxisReport]]:
        """The axes of each sensor that has any, the gyroscope first."""
        found = {sensor: [axis for axis in self.axes if axis.sensor is sensor] for sensor in Sensor}
        return {sensor: axes for sensor, axes in found.items() if axes}

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """The findings of the log and of every axis."""
        return self.findings + tuple(finding for axis in self.axes for finding in axis.findings)

    def with_findings(self, added: tuple[Finding, ...]) -> "Report":
        """Return the report with findings about the whole log added."""
        return replace(self, findings=self.findings + added) if added else self

    @cached_property
    def verdict(self) -> NoiseVerdict:
        """Whether the data are stationary noise, and how precise N is."""
        errors = {axis.name: axis.white_error for axis in self.axes if np.isfinite(axis.white_error)}
        failed = (f.axis for f in self.findings if f.code in _WITHOUT_RESULT and f.level == "error")
        names = [*(axis.name for axis in self.axes), *(name for name in failed if name)]
        return judge_findings(
            self.all_findings, list(dict.fromkeys(names)), errors=errors, too_short=self._too_short
        )

    def covering(
        self,
        fits: Sequence[NoiseFit],
        *,
        horizon_s: float,
        step_s: float = STEP_S,
        joined: Joined = "worst",
        time_s: float | None = None,
    ) -> FilterNumbers:
        """Return the white noise and walk that cover some axes; arguments and errors of `filter_numbers`."""
        request = (*fits, horizon_s, step_s, joined, time_s)
        if request not in self._pairs:
            self._pairs[request] = filter_numbers(
                fits, horizon_s=horizon_s, step_s=step_s, joined=joined, time_s=time_s
            )
        return self._pairs[request]

    def usual_pairs(self, axes: Sequence[AxisReport]) -> tuple[FilterNumbers, ...]:
        """Return the pairs for filters with cameras or lidars, and for others; () if nothing is known."""
        fits = [axis.fit for axis in axes]
        try:
            return tuple(self.covering(fits, horizon_s=horizon) for horizon in (CAMERA_HORIZON_S, HORIZON_S))
        except DataError:
            return ()

    @cached_property
    def _pairs(self) -> dict[tuple[object, ...], FilterNumbers]:
        """The results of `covering`."""
        return {}

    @property
    def _too_short(self) -> bool:
        """Whether a too short record shows neither B nor K on any axis."""
        slow = [term for axis in self.axes for term in axis.fit.estimates if term.key in {"B", "K"}]
        unseen = bool(slow) and all(term.value is None for term in slow)
        return unseen and any(axis.samples and axis.duration_s < _MIN_LENGTH_S for axis in self.axes)
