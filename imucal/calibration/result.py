"""Results of a calibration, and how to apply them to a recording."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, TypeAlias

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.accelerometer import Model, Suggestion
from imucal.calibration.gravity import Gravity
from imucal.calibration.gyro_rest import GyroRest
from imucal.calibration.noise_source import NoiseBase
from imucal.calibration.parameters import Parameter, inverse
from imucal.calibration.slow_noise import Excess
from imucal.calibration.turn_data import Turn
from imucal.display import Displayed
from imucal.findings import Finding
from imucal.grading import GRADE_TEXTS
from imucal.recording import Source

__all__ = ["AccelerometerResult", "Calibration", "GyroscopeResult", "Rest", "rms"]

#: check: read the findings first; not-usable: the result is wrong.
CalibrationGrade: TypeAlias = Literal["good", "check", "not-usable"]


@dataclass(frozen=True, kw_only=True)
class Rest:
    """One rest.

    `mean_accel` and `mean_gyro` are raw; `residual` is |f| - g after calibration, `before` the same of the
    raw mean, and `sigma` the deviation of the residual, in m/s². `z` is the largest difference of the halves,
    in deviations. `why` is the reason if the rest is not used.
    """

    start_s: float
    end_s: float
    mean_accel: tuple[float, ...]
    mean_gyro: tuple[float, ...] | None
    up: tuple[float, ...]
    residual: float
    before: float
    sigma: float | None
    z: float
    used: bool
    why: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class AccelerometerResult(ReadOnlyArrays):
    """f = C (raw - b), raw = M f + b.

    `covariance`, shape (9, 9), is of the lower triangle of C by rows, then b; of the upper triangle by
    columns in the frame ``imu-tk``. `diagonal_C` and `diagonal_b` are the best fit without misalignment. `si`
    is whether the samples are in m/s².
    """

    C: FloatArray
    b: FloatArray
    covariance: FloatArray
    parameters: Mapping[str, Parameter]
    diagonal_C: FloatArray
    diagonal_b: FloatArray
    model: Model
    si: bool
    excess: Excess
    chi2: float
    dof: int
    p: float
    suggestion: Suggestion

    @property
    def M(self) -> FloatArray:  # noqa: N802 - the symbol of the model
        """The inverse of C, shape (3, 3)."""
        return inverse(self.C)


@dataclass(frozen=True, kw_only=True, eq=False)
class GyroscopeResult(ReadOnlyArrays):
    """w = C (raw - b - G f), raw = M w + b + G f.

    `covariance_C` is the covariance of C by rows, shape (9, 9). `G` is 0 unless it is significant. If no turn
    could be used, `scaled` is false, C and M are the identity and the covariance is 0. `si` is whether the
    samples are in rad/s.
    """

    C: FloatArray
    b: FloatArray
    G: FloatArray
    covariance_C: FloatArray
    parameters: Mapping[str, Parameter]
    chi2: float
    dof: int
    p: float
    widening: float
    scaled: bool
    si: bool
    rest: GyroRest

    @property
    def M(self) -> FloatArray:  # noqa: N802 - the symbol of the model
        """The inverse of C, shape (3, 3)."""
        return inverse(self.C)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibration(Displayed):
    """A calibrated IMU; attributes are those of the JSON document.

    Attributes
    ----------
    frame
        ``kalibr``, ``imu-tk`` or ``nearest``.
    rests, turns
        All that were found, with the reason if they are not used.
    gyroscope
        None without a gyroscope.
    temperature
        Mean, lowest and highest in degrees Celsius, or None.
    noise
        The noise of each sensor, and its origin.
    """

    #: Module of the text and the table that notebooks show.
    drawn_by: ClassVar[str] = "imucal.calibration.table"

    source: Source
    gravity: Gravity
    rests: tuple[Rest, ...]
    turns: tuple[Turn, ...]
    accelerometer: AccelerometerResult
    gyroscope: GyroscopeResult | None
    temperature: tuple[float, float, float] | None
    noise: Mapping[str, NoiseBase]
    findings: tuple[Finding, ...]
    frame: str = field(default="kalibr")

    @property
    def accel(self) -> AccelerometerResult:
        """Short for `accelerometer`."""
        return self.accelerometer

    @property
    def gyro(self) -> GyroscopeResult | None:
        """Short for `gyroscope`."""
        return self.gyroscope

    @property
    def verdict(self) -> CalibrationGrade:
        """`good`, `check` (a warning: read the findings first) or `not-usable` (an error)."""
        levels = {finding.level for finding in self.findings}
        if "error" in levels:
            return "not-usable"
        return "check" if "warning" in levels else "good"

    @property
    def verdict_text(self) -> str:
        """The verdict as printed: good, check first or not usable."""
        return GRADE_TEXTS[self.verdict]


def rms(values: Iterable[float]) -> float:
    """Return the root of the mean square of errors; 0 if there are none."""
    squares = [value**2 for value in values]
    return math.sqrt(sum(squares) / len(squares)) if squares else 0.0
