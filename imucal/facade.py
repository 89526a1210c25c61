"""The functions for notebooks: one call per job, with arrays, paths or texts as arguments.

An invalid argument raises an `ImucalError` with a correct call.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack, overload

import numpy as np

from imucal.allan import AllanCurve
from imucal.arrays import FloatArray
from imucal.calibration import Calibration
from imucal.calibration.applying import apply as apply_calibration
from imucal.calibration.document import CalibrationDocument, Intrinsics, load_document, to_document
from imucal.calibration.document import from_document as calibration_of
from imucal.calibration.exports import export_calibration
from imucal.calibration.writer import is_calibration
from imucal.checking import CheckResult, Limits, check_config, parse_limits, read_limits
from imucal.checking import check as check_limits
from imucal.checking.calibrated import check_calibration
from imucal.correction.bias_over_time import compensated
from imucal.errors import ArgumentError, ImucalError
from imucal.fitting import NoiseFit
from imucal.fitting import fit as fit_axis
from imucal.fleet.as_report import check_fleet, fleet_as_report
from imucal.fleet.summary import Fleet
from imucal.health import Diagnosis, diagnose
from imucal.noise import NoiseModel
from imucal.pipeline import Settings, characterize
from imucal.prediction.filter_numbers import STEP_S
from imucal.readers import LogContents, describe, read
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.report.exports import export as export_report
from imucal.report.exports import refuse_unsound
from imucal.report.exports.config_numbers import AxisPolicy, Basis, ExportOptions, Unidentified
from imucal.report.json_file import load
from imucal.report.result import Report
from imucal.sensors import Part, find_sensor
from imucal.temperature import Thermal
from imucal.temperature import thermal as thermal_of
from imucal.temperature.exports import export_thermal
from imucal.units import G0
from imucal.user_input import seconds_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["apply", "check", "doctor", "export", "fit", "info", "sensor", "simulate", "thermal"]


_ONE_AXIS = 'for one axis type imucal.fit(recording["gyro_x"])'


class FitOptions(TypedDict, total=False):
    model: str
    method: str
    level: float
    criterion: str
    weights: str
    clean: bool
    max_gm: int
    segments: int


@contextmanager
def _refusals() -> Iterator[None]:
    try:
        yield
    except ImucalError:
        raise
    except ValueError as error:
        raise ArgumentError(str(error)) from error


@overload
def fit(  # type: ignore[overload-overlap] # NumPy also takes a text for an array
    source: Recording | str | Path, **options: Unpack[FitOptions]
) -> Report: ...
@overload
def fit(
    source: "AxisSeries | AllanCurve | ArrayLike",
    *,
    rate_hz: float | None = None,
    sensor: str = "gyroscope",
    curve: AllanCurve | None = None,
    temperature: FloatArray | None = None,
    **options: Unpack[FitOptions],
) -> NoiseFit: ...
def fit(
    source: "Recording | str | Path | AxisSeries | AllanCurve | ArrayLike",
    *,
    rate_hz: float | None = None,
    sensor: str = "gyroscope",
    curve: AllanCurve | None = None,
    temperature: FloatArray | None = None,
    **options: Unpack[FitOptions],
) -> NoiseFit | Report:
    """Fit a noise model to one axis, or to every axis of a recording.

    Parameters
    ----------
    source
        A recording, or the path of its log; or an axis of a recording, an Allan curve, or an array of evenly
        spaced samples in rad/s or m/s^2, shape (n,).
    rate_hz, sensor
        Sampling rate, and ``gyroscope`` or ``accelerometer``, of an array.
    curve
        The Allan curve of the samples, if it is known.
    temperature
        Temperature at the samples in degrees Celsius, shape (n,). The fit removes its linear effect.
    options
        ``model``, ``method``, ``level``, ``criterion``, ``weights``, ``clean``, ``max_gm`` and
        ``segments``, as in `imucal.fitting.fit`.

    Returns
    -------
    The fit of one axis, or the report of a recording.

    Raises
    ------
    ArgumentError
        If the source is none of these, or if an option is unknown.
    DataError
        If the samples can't be analysed: too few, constant, not finite.
    """
    if unknown := [name for name in options if name not in FitOptions.__annotations__]:
        known = ", ".join(FitOptions.__annotations__)
        msg = f"fit: there is no option {unknown[0]!r}; expected one of {known}; {_ONE_AXIS}"
        raise ArgumentError(msg)
    with _refusals():
        if isinstance(source, str | Path):
            source = read(source, rate_hz=rate_hz)
            rate_hz = None
        if isinstance(source, Recording):
            if rate_hz is not None:
                msg = "a recording has a rate already; omit rate_hz, or give it to imucal.read"
                raise ArgumentError(msg)
            return characterize(source, Settings(**options))
        if not isinstance(source, AxisSeries | AllanCurve):
            source = _own_samples(source, rate_hz, sensor)
        return fit_axis(source, curve=curve, temperature=temperature, **options)


def _own_samples(samples: "ArrayLike", rate_hz: float | None, sensor: str) -> AxisSeries:
    try:
        array = np.asarray(samples, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = (
            f"found {type(samples).__name__}, expected a recording, one of its axes, an Allan curve or an "
            "array of samples; type imucal.fit(samples, rate_hz=200.0)"
        )
        raise ArgumentError(msg) from error
    if array.ndim != 1:
        msg = f"samples must have shape (n,), got {array.shape}; give one axis, such as samples[:, 0]"
        raise ArgumentError(msg)
    if rate_hz is None:
        msg = "an array has no sampling rate; give one, such as imucal.fit(samples, rate_hz=200.0)"
        raise ArgumentError(msg)
    return AxisSeries.from_samples(array, rate_hz=rate_hz, sensor=sensor)


def _report(report: object) -> Report:
    if isinstance(report, str | Path):
        return load(Path(report))
    if not isinstance(report, Report):
        msg = f"found {type(report).__name__}, expected a report; type imucal.fit(recording) to make one"
        raise ArgumentError(msg)
    return report


def export(
    report: Report | Calibration | Thermal | Fleet | str | Path,
    target: str,
    path: str | Path,
    *,
    noise: Report | None = None,
    force: bool = False,
    axis_policy: AxisPolicy = "worst",
    inflate: Mapping[str, float] | None = None,
    unidentified: Unidentified = "bound",
    topic: str | None = None,
    numbers: Basis = "covered",
    horizon_s: float | None = None,
    step_s: float = STEP_S,
) -> tuple[Path, ...]:
    """Write the config file of a filter or simulator, such as ``export(report, "kalibr", "imu.yaml")``.

    Parameters
    ----------
    report
        A report, or the path of a report.json or its folder; a fleet, whose file suits every unit; a
        calibration, for formats with bias, scale and misalignment; or a temperature ramp, for formats with
        the bias over temperature.
    target
        The format, such as ``kalibr`` or ``px4``; ``all`` writes all formats of a report into the folder
        `path`.
    path
        The file to write, or a folder.
    noise
        For a calibration, the report with the noise numbers of the same file.
    force
        Export even if the report is not noise at rest, or N is uncertain by more than a factor of 10.
    axis_policy, inflate, unidentified, topic, numbers, horizon_s, step_s
        The attributes of `imucal.report.exports.ExportOptions`.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    ArgumentError
        If the format or an option is unknown.
    DataError
        If the report lacks a number that the format needs, is not noise at rest, or has an N that is
        uncertain by more than a factor of 10.
    WriteError
        If a file can't be written, or if imucal did not write the existing file of that name.
    """
    with _refusals():
        options = ExportOptions(
            axis_policy=axis_policy,
            inflate=inflate or {},
            unidentified=unidentified,
            topic=topic,
            numbers=numbers,
            horizon_s=horizon_s,
            step_s=step_s,
        )
        if isinstance(report, Calibration):
            return (export_calibration(report, target, Path(path), noise, options),)
        if isinstance(report, Thermal):
            return (export_thermal(report, target, Path(path)),)
        found = fleet_as_report(report) if isinstance(report, Fleet) else _report(report)
        if not force:
            refuse_unsound(found, place=found.source.path)
        return export_report(found, target, Path(path), options)


def check(
    report: Report | Calibration | str | Path,
    limits: Limits | str | Path | None = None,
    *,
    config: str | Path | None = None,
    baseline: Report | None = None,
    fleet: Fleet | None = None,
) -> CheckResult:
    """Compare a report with limits, with a filter's config file, or with the units of a fleet.

    Parameters
    ----------
    report
        A report or a calibration, or the path of its file or folder.
    limits
        A TOML file with limits, or its text.
    config
        A filter's config file, whose noise parameters are compared with the report.
    baseline
        An older report, for limits relative to a baseline.
    fleet
        Units of the same model.

    Raises
    ------
    ArgumentError
        If there is nothing to compare with.
    LimitsError
        If the limits or the config can't be read.
    """
    with _refusals():
        if limits is not None and config is None and fleet is None and (calibrated := _calibration(report)):
            return check_calibration(calibrated, _limits(limits))
        found = _report(report)
        if limits is None and config is None and fleet is None:
            msg = "nothing to check against; type check(report, 'limits.toml'), or give config='imu.yaml'"
            raise ArgumentError(msg)
        result = check_limits(found, _limits(limits), baseline=baseline)
        rows = result.rows
        if config is not None:
            rows += check_config(Path(config), found)
        if fleet is not None:
            rows += check_fleet(found, fleet)
        return replace(result, rows=rows)


def _calibration(report: object) -> CalibrationDocument | None:
    """Return the document of a calibration; None for a report."""
    if isinstance(report, Calibration):
        return calibration_of(to_document(report))
    if isinstance(report, str | Path) and is_calibration(Path(report)):
        return load_document(Path(report))
    return None


def _limits(limits: Limits | str | Path | None) -> Limits:
    if limits is None or isinstance(limits, Limits):
        return limits or Limits()
    text = str(limits)
    return parse_limits(text) if "\n" in text or "=" in text else read_limits(Path(text))


def simulate(
    model: NoiseModel | str,
    accelerometer: NoiseModel | str | None = None,
    *,
    rate_hz: float = 200.0,
    duration: str | float = "10min",
    seed: int = 0,
    path: str | Path | None = None,
) -> Recording:
    """Return a simulated recording of an IMU at rest, such as ``simulate("N=1e-4 + B=2e-5")``.

    Parameters
    ----------
    model, accelerometer
        Noise model of the three axes of a sensor, or its text with coefficients in SI or with a unit, such as
        ``N=0.3deg/sqrt(h)``. By default the accelerometer has the same numbers as the gyroscope.
    rate_hz
        Sampling rate, in Hz.
    duration
        In s, or a text such as ``2h``.
    seed
        The same seed gives the same samples.
    path
        A log to write: .csv, .mcap, .bag, .db3, or a folder.

    Raises
    ------
    ArgumentError
        If a model, the rate or the duration is invalid.
    WriteError
        If the log exists already or can't be written.
    """
    from imucal.simulation import SensorTruth, simulate_recording, write_log

    with _refusals():
        length = seconds_of(duration)
        if not (rate_hz > 0 and length * rate_hz >= 1):
            msg = f"{length:g} s at {rate_hz:g} Hz give no sample; type simulate(model, rate_hz=200.0)"
            raise ArgumentError(msg)
        gyro, accel = (
            NoiseModel.parse(text, sensor) if isinstance(text, str) else text
            for text, sensor in zip((model, accelerometer or model), Sensor, strict=True)
        )
        recording = simulate_recording(
            gyroscope=SensorTruth(model=gyro, mean=(0.0, 0.0, 0.0)),
            accelerometer=SensorTruth(model=accel, mean=(0.0, 0.0, G0)),
            rate_hz=rate_hz,
            duration_s=length,
            seed=seed,
        )
    if path is not None:
        write_log(recording, Path(path))
    return recording


def info(log: str | Path) -> LogContents:
    """Return what is in a log: its topics with their types, counts, rates and lengths.

    Raises
    ------
    ReadError
        If the file is missing, damaged beyond reading or of an unknown format.
    """
    return describe(log)


def doctor(recording: Recording | str | Path, *, expect: str | None = None) -> Diagnosis:
    """Return whether a stream is fit for a filter: a row for units, axes, delay, range, clocks and more.

    The IMU may move. Rows are ``unknown`` if the log can't tell: axes, signs and the delay between the
    sensors need turns.

    Parameters
    ----------
    recording
        From `imucal.read`, or the path of a log.
    expect
        The axis that points up or down at the first rest, such as ``z-up``.

    Raises
    ------
    ChoiceError
        If `expect` is not an axis and a direction.
    ReadError
        If the log can't be read.
    """
    with _refusals():
        return diagnose(read(recording) if isinstance(recording, str | Path) else recording, expect=expect)


def apply(calibration: Calibration | Intrinsics | Thermal, recording: Recording) -> Recording:
    """Return a recording without the errors of the IMU that a calibration or a temperature ramp describes.

    Parameters
    ----------
    calibration
        From `imucal.calibrate` or `imucal.load_calibration`: bias, scale error, misalignment and
        g-sensitivity, in m/s² and rad/s. From `imucal.thermal`: the bias at the temperature of each sample.
    recording
        From `imucal.read`. If it has no gyroscope, or no accelerometer, the other one is corrected.

    Raises
    ------
    DataError
        If the two do not fit: raw counts and SI units, no temperature, a sensor without all axes, or a
        recording that is already corrected.
    """
    with _refusals():
        if isinstance(calibration, Thermal):
            return compensated(calibration, recording)
        return apply_calibration(calibration, recording)


def thermal(recording: Recording | str | Path) -> Thermal:
    """Return the bias of each axis over the temperature, from a log at rest in which the IMU heats and cools.

    Parameters
    ----------
    recording
        From `imucal.read`, or the path of a log, with the temperature of the IMU.

    Raises
    ------
    DataError
        If the log has no temperature, a span below 5 K, or too few samples.
    ReadError
        If the log can't be read.
    """
    with _refusals():
        return thermal_of(read(recording) if isinstance(recording, str | Path) else recording)


def sensor(name: str) -> Part:
    """Return a part with the noise figures of its data sheet, such as ``sensor("BMI088")``.

    Parameters
    ----------
    name
        Of a part or of a device that contains one, such as ``BMI088``, ``mpu 6050`` or ``RealSense D435i``;
        case, spaces and punctuation do not matter.

    Raises
    ------
    ChoiceError
        If there is no such part, or a device contains several; the message lists similar names.
    """
    return find_sensor(name)
