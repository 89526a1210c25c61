"""What `imucal thermal` returns: the bias of each axis over the temperature, and how well it is known."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.findings import Finding
from imucal.recording import AXES, Axis, Sensor, Source
from imucal.temperature.curve import Curve
from imucal.temperature.ramp import AxisBlocks, Ramp

__all__ = ["VERDICTS", "AxisThermal", "Branch", "Thermal", "ThermalVerdict"]

ThermalVerdict: TypeAlias = Literal["good", "check", "not-usable"]
#: Verdict -> how a sentence begins.
VERDICTS: dict[ThermalVerdict, str] = {
    "good": "good",
    "check": "check first",
    "not-usable": "not usable",
}


@dataclass(frozen=True, kw_only=True)
class Branch:
    """A part of the log in which the temperature rises or falls; times in s from the first temperature."""

    start_s: float
    end_s: float
    from_c: float
    to_c: float

    @property
    def heats(self) -> bool:
        return self.to_c > self.from_c


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown(ReadOnlyArrays):
    """What the pictures show of an axis in m blocks, shape (m,) each: temperature, bias, and what is left."""

    temperature: FloatArray
    bias: FloatArray
    left: FloatArray
    heats: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisThermal:
    """The temperature effect of one axis, in SI.

    Attributes
    ----------
    curve
        The bias over the temperature.
    cubic
        The cubic of the present temperature by least squares, for programs that know no lag.
    noise
        White noise of a sample, standard deviation.
    before
        Rms of the bias about its mean, without white noise.
    left
        Rms of the bias after compensation, without white noise.
    held_out
        The same in parts of the log that the curve was not fitted to; None if the log has one branch.
    cubic_held_out
        The same for the cubic.
    hysteresis
        Largest difference between heating and cooling at one temperature; None if the log has one branch.
    hysteresis_left
        The same after compensation.
    """

    sensor: Sensor
    axis: Axis
    curve: Curve
    cubic: Curve
    noise: float
    before: float
    left: float
    held_out: float | None
    cubic_held_out: float | None
    hysteresis: float | None
    hysteresis_left: float | None
    shown: Shown | None = field(default=None, compare=False)

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return f"{self.sensor.short}_{self.axis}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Thermal:
    """The bias of an IMU over the temperature, from a log at rest in which it heats and cools.

    `low_c` and `high_c` are the range of validity, and `fastest_k_per_s` is the fastest change.
    """

    source: Source
    low_c: float
    high_c: float
    fastest_k_per_s: float
    branches: tuple[Branch, ...]
    axes: tuple[AxisThermal, ...]
    findings: tuple[Finding, ...]

    def __getitem__(self, name: str) -> AxisThermal:
        return {one.name: one for one in self.axes}[name]

    @property
    def verdict(self) -> ThermalVerdict:
        """``not-usable`` after an error, ``check`` after a warning."""
        levels = {finding.level for finding in self.findings}
        if "error" in levels:
            return "not-usable"
        return "check" if "warning" in levels else "good"

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        return tuple(dict.fromkeys(one.sensor for one in self.axes))

    def triad(self, sensor: Sensor) -> tuple[AxisThermal, ...] | None:
        """Return x, y and z of a sensor; None if one is missing."""
        found = {one.axis: one for one in self.axes if one.sensor is sensor}
        return tuple(found[axis] for axis in AXES) if len(found) == len(AXES) else None

    def __repr__(self) -> str:
        lines = [
            f"{one.name}: {one.before:.3g} -> {one.left:.3g} {one.sensor.unit} rms"
            + ("" if one.held_out is None else f", {one.held_out:.3g} in parts that the fit has not seen")
            for one in self.axes
        ]
        head = f"{self.source.name}: {VERDICTS[self.verdict]}, {self.low_c:.1f} to {self.high_c:.1f} °C"
        return "\n".join([head, *lines])


def blocks_shown(ramp: Ramp, axis: AxisBlocks, left: FloatArray) -> Shown:
    """Return what the pictures show of an axis."""
    return Shown(
        temperature=ramp.temperature[axis.places],
        bias=axis.means,
        left=left,
        heats=ramp.heating[axis.places].astype(float),
    )
