"""Report: everything a run found, as values; renderers are functions of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.allan.spectrum import Spectrum
from imucal.arrays import FloatArray, read_only
from imucal.clock import Gap
from imucal.findings import Finding
from imucal.fitting.noise_fit import NoiseFit
from imucal.recording import Axis, Sensor, Source


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Overview:
    """The raw signal, small enough to draw: lowest and highest sample of each of k stretches.

    Attributes
    ----------
    time_s
        Middle of each stretch, shape (k,), in s from the first sample; stretches in gaps hold NaN.
    low, high
        Extremes, shape (k,), in U, the mean not removed.
    """

    time_s: FloatArray
    low: FloatArray
    high: FloatArray

    def __post_init__(self) -> None:
        for name in ("time_s", "low", "high"):
            array = read_only(np.asarray(getattr(self, name), dtype=np.float64))
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisReport:
    """What was found about one axis; units as in `Sensor.unit`.

    `fit.curve` is its Allan curve; `spectrum` its psd. `mean` and `std` are of the finite samples.
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
        """SI unit of the samples."""
        return self.sensor.unit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Report:
    """A characterised recording.

    Attributes
    ----------
    source
        The log.
    axes
        One entry an axis, gyroscope x, y, z first; an axis that can't be analysed is missing and
        named in `findings`.
    settings
        Everything needed to repeat the run; JSON values only.
    findings
        What concerns the whole log.
    version
        imucal's version.
    """

    source: Source
    axes: tuple[AxisReport, ...]
    settings: Mapping[str, object]
    version: str
    findings: tuple[Finding, ...] = ()
