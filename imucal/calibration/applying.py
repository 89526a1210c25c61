"""Correct samples: f = C_a (raw - b_a), w = C_g (raw - b_g - G f)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.document import Intrinsics
from imucal.calibration.poses import at_other_times, triad
from imucal.calibration.result import Calibration
from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.recording import AXES, RAW_COUNTS, AxisSeries, Recording, Sensor
from imucal.units import LOG_UNITS

#: Decision of a corrected recording.
CORRECTED = "corrected"


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction(ReadOnlyArrays):
    """The matrices of a calibration. Samples of the log are multiplied by `units` before, SI or counts.

    C_g is the identity if the calibration has no gyroscope, which then stays as it is.
    """

    C_a: FloatArray
    b_a: FloatArray
    C_g: FloatArray
    b_g: FloatArray
    G: FloatArray

    @classmethod
    def of(cls, found: Intrinsics) -> "Correction":
        return cls(
            C_a=found.C_a,
            b_a=found.b_a,
            C_g=np.eye(3) if found.C_g is None else found.C_g,
            b_g=np.zeros(3) if found.b_g is None else found.b_g,
            G=np.zeros((3, 3)) if found.G is None else found.G,
        )

    def force(self, raw: FloatArray) -> FloatArray:
        """Return the specific force in m/s², shape (n, 3), from raw samples."""
        corrected: FloatArray = (raw - self.b_a) @ self.C_a.T
        return corrected

    def rate(self, raw: FloatArray, force: FloatArray | None) -> FloatArray:
        """Return the rate in rad/s, shape (n, 3), from raw samples and the specific force."""
        rest = raw - self.b_g
        if force is not None:
            rest = rest - force @ self.G.T
        corrected: FloatArray = rest @ self.C_g.T
        return corrected

    def samples(
        self, raw: Mapping[Sensor, FloatArray], sensed: FloatArray | None = None
    ) -> dict[Sensor, FloatArray]:
        """Return the corrected samples of each sensor, shape (n, 3), in SI.

        The specific force for g-sensitivity is that of the accelerometer in `raw`; without one it is
        `sensed`, at the times of the gyroscope.
        """
        found: dict[Sensor, FloatArray] = {}
        if Sensor.ACCELEROMETER in raw:
            found[Sensor.ACCELEROMETER] = self.force(raw[Sensor.ACCELEROMETER])
        if Sensor.GYROSCOPE in raw:
            force = found.get(Sensor.ACCELEROMETER, sensed)
            found[Sensor.GYROSCOPE] = self.rate(raw[Sensor.GYROSCOPE], force)
        return found


def unit_factor(recording: Recording, sensor: Sensor) -> float:
    """Return the SI value of 1 in the unit of a log; raises DataError if its samples are increments."""
    unit = recording.source.values.get(f"{sensor} unit", "")
    if unit == RAW_COUNTS:
        return 1.0
    if unit.endswith(" per count"):
        return float(unit.removesuffix(" per count"))
    if unit in LOG_UNITS[sensor]:
        return LOG_UNITS[sensor][unit]
    problem = f"the {sensor} has increments per sample ({unit or 'of an unknown unit'}), expected rates"
    raise DataError(problem, place=recording.source.path)


def refuse_unlike(found: Intrinsics, recording: Recording) -> tuple[Finding, ...]:
    """Raise DataError for a calibration in another unit or a corrected log; return doubts about the pair."""
    place = recording.source.path
    values = recording.source.values
    counts = [sensor for sensor in Sensor if values.get(f"{sensor} unit") == RAW_COUNTS]
    if counts and found.si:
        problem = f"the {counts[0]} is in raw counts, and the calibration {found.source} is in SI units"
        fix = Fix("give its scale, such as --gyro-scale and --accel-scale, or calibrate counts")
        raise DataError(problem, place=place, fix=fix)
    if not counts and not found.si:
        problem = f"the log is in SI units, and the calibration {found.source} is in raw counts"
        raise DataError(problem, place=place, fix=Fix("read it with --gyro-unit count --accel-unit count"))
    if any(what == CORRECTED for what, _ in recording.source.decisions):
        raise DataError("it is already corrected", place=place, fix=Fix("give the original log"))
    findings = list(_doubts(found, values.get("frame", "")))
    if counts:
        text = "Corrected samples are in m/s^2 and rad/s, because there is no count for them."
        findings.append(Finding("info", "counts-became-si", text))
    return tuple(findings)


def _doubts(found: Intrinsics, frame: str) -> Iterator[Finding]:
    """Yield the findings about a calibration for a log with a `frame` in its messages."""
    if frame and found.log_frame and frame != found.log_frame:
        text = f"The log has the frame {frame}, the log of the calibration {found.log_frame}."
        yield Finding("warning", "other-frame", text, "Make sure that both are of the same IMU.")
    if found.warnings:
        text = f"The calibration {found.source} warns of: {', '.join(found.warnings)}."
        yield Finding("warning", "calibration-warns", text, "Read calibration.html first.")
    if not found.b_a.any() and (found.b_g is None or not found.b_g.any()):
        text = f"The calibration {found.source} has no biases: only scale and misalignment are corrected."
        yield Finding("info", "no-biases", text)


def apply(calibration: Calibration | Intrinsics, recording: Recording) -> Recording:
    """Return a recording in m/s² and rad/s without bias, scale error, misalignment and g-sensitivity.

    Parameters
    ----------
    calibration
        From `imucal.calibrate` or `imucal.load_calibration`.
    recording
        From `imucal.read`. If it has no gyroscope, or no accelerometer, the other one is corrected.

    Raises
    ------
    DataError
        If one of the two is in raw counts, the recording is already corrected, a sensor has not all axes, or
        g-sensitivity can't be corrected without an accelerometer.
    """
    found = Intrinsics.of(calibration) if isinstance(calibration, Calibration) else calibration
    findings = refuse_unlike(found, recording)
    correction = Correction.of(found)
    force = triad(recording, Sensor.ACCELEROMETER)
    rate = triad(recording, Sensor.GYROSCOPE)
    corrected: dict[Sensor, FloatArray] = {}
    if force is None and rate is None:
        raise DataError("no sensor with three axes", place=recording.source.path)
    if force is not None:
        corrected[Sensor.ACCELEROMETER] = correction.force(force.samples)
    if rate is not None:
        sensed = None
        if correction.G.any():
            if force is None:
                raise without_force(recording.source.path)
            sensed = at_other_times(force, corrected[Sensor.ACCELEROMETER], rate)
        corrected[Sensor.GYROSCOPE] = correction.rate(rate.samples, sensed)

    def corrected_series(series: AxisSeries) -> AxisSeries:
        column = corrected[series.sensor][:, AXES.index(series.axis)]
        return replace(series, samples=column[series.clock.grid()])

    decisions = (*recording.source.decisions, (CORRECTED, f"by {found.source}"))
    return replace(
        recording,
        source=replace(recording.source, decisions=decisions),
        series=tuple(corrected_series(series) for series in recording.series),
        findings=(*recording.findings, *findings),
    )


def without_force(place: str) -> DataError:
    """Return the error of a log whose gyroscope can't be corrected for g-sensitivity."""
    problem = "the calibration has g-sensitivity, which needs the accelerometer"
    return DataError(problem, place=place, fix=Fix("name the topics of both sensors"))
