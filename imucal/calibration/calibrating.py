"""calibrate: a recording of rests and turns -> bias, scale, misalignment and g-sensitivity with intervals."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.accelerometer import (
    LOWER,
    PARAMETERS,
    AccelerometerFit,
    Suggestion,
    describe_direction,
    fit_accelerometer,
    suggest_rest,
)
from imucal.calibration.checks import Facts, findings_of
from imucal.calibration.frames import FRAMES, Frame
from imucal.calibration.gravity import Gravity, gravity_at
from imucal.calibration.gyroscope import calibrate_gyroscope, gyro_scale, scale_of
from imucal.calibration.known_turns import KnownAngle, known_angle
from imucal.calibration.noise_source import base_covariance, white_models
from imucal.calibration.parameters import accelerometer_parameters
from imucal.calibration.poses import (
    RestMeans,
    Triad,
    attitudes,
    find_rests,
    half_differences,
    moved_rests,
    triad,
)
from imucal.calibration.requirements import (
    ADVICE,
    MIN_RESTS,
    require_attitudes,
    require_range,
    require_rests,
)
from imucal.calibration.rested_sensor import RestedSensor
from imucal.calibration.result import AccelerometerResult, Calibration, Rest
from imucal.calibration.slow_noise import AccelerometerEstimate, estimate_accelerometer
from imucal.errors import ArgumentError, DataError, Fix
from imucal.noise import NoiseModel
from imucal.recording import RAW_COUNTS, ReadRange, Recording, Sensor
from imucal.report.result import Report
from imucal.user_input import seconds_of

if TYPE_CHECKING:
    from imucal.calibration.turn_data import Turn
    from imucal.findings import Finding

__all__ = ["calibrate"]

#: Median length of samples in m/s² of a log of rests and turns.
_LIKE_GRAVITY = (6.5, 14.7)
#: Largest share of rests excluded as moved.
_MAX_MOVED = 1 / 3


def calibrate(
    recording: Recording,
    noise: Report | Mapping[str, NoiseModel] | None = None,
    latitude: float | None = None,
    height: float | None = None,
    gravity: float | None = None,
    *,
    rest_at_least: str | float = 1.0,
    in_hand: bool = False,
    gyro: bool = True,
    frame: str = "kalibr",
    turns: str | None = None,
) -> Calibration:
    """Calibrate an IMU from a log in which it is put down, left alone and turned, in 12 attitudes or more.

    Parameters
    ----------
    recording
        The log, in SI units or raw counts.
    noise
        A report of a static log of 30 min or more, or models by axis name; by default slow noise is
        estimated from the rests.
    latitude, height, gravity
        Place of the log in degrees and m, or gravity in m/s²; see `gravity_at`.
    rest_at_least
        Shortest rest, in s, or such as ``2s``.
    in_hand
        Count a hand's tremor as rest.
    gyro
        Whether to calibrate the gyroscope too.
    frame
        Axes of the result: ``kalibr`` (x along the accelerometer's x axis, y in its x-y plane), ``imu-tk``
        (z along its z axis, y in its y-z plane), or ``nearest`` to all three axes.
    turns
        Angle about the vertical of the turns that end in the attitude in which they began, such as
        ``360deg``, and its deviation, such as ``360deg+-0.1deg``; 0.2° by default. It shows the scale of a
        gyroscope that is turned on a table, which gravity does not.

    Raises
    ------
    DataError
        If the log cannot be calibrated: never moved, one attitude, fewer than 6 rests, a dead axis, no turn
        of the known angle.
    ArgumentError
        If gravity, latitude, `rest_at_least`, `frame` or `turns` is impossible.
    """
    if frame not in FRAMES:
        raise ArgumentError(f"no frame {frame!r}; choose one of {', '.join(FRAMES)}")
    place = gravity_at(gravity=gravity, latitude=latitude, height=height)
    accelerometer = triad(recording, Sensor.ACCELEROMETER)
    gyroscope = triad(recording, Sensor.GYROSCOPE) if gyro else None
    if accelerometer is None:
        raise DataError(
            "no accelerometer; calibration needs gravity as its reference", place=recording.source.path
        )
    known = None if turns is None else _known_angle(turns, recording, gyroscope, gyro=gyro)
    with _in_log(recording):
        spans = find_rests(accelerometer, gyroscope, at_least_s=seconds_of(rest_at_least), in_hand=in_hand)
        require_rests(spans, accelerometer, gyroscope)
        si = _accelerometer_is_si(recording, accelerometer)
        found = RestedSensor.of(
            accelerometer,
            spans,
            noise,
            lambda rests: scale_of(_first_fit(accelerometer, rests, place, si=si).C),
        )
        require_attitudes(found.rests.means)
        require_range(accelerometer, found.rests)
        turning = None
        if gyroscope is not None:
            up = _first_fit(accelerometer, found.rests, place, si=si).up
            turning = RestedSensor.of(
                gyroscope,
                spans,
                noise,
                lambda rests: gyro_scale(gyroscope, rests, up),
            )
        z = np.column_stack([half_differences(s.data, s.rests, s.base.models) for s in (found, turning) if s])
        moved = _excluded(z)
        kept = moved & _irreplaceable(_first_fit(accelerometer, found.rests, place, si=si).up, moved)
        used = ~moved | kept
        found, turning = found.moving(kept), turning and turning.moving(kept)
        estimate = _estimate(found.keeping(used), place, si=si)
    axes = Frame.of(frame, _lower(estimate.theta))
    sigma = np.full(len(spans), np.nan)
    sigma[used] = np.sqrt(np.diag(estimate.fit.residual_covariance))
    result = _accelerometer(estimate, axes, found.keeping(used), place, si=si)
    every_turn: tuple[Turn, ...] = ()
    trouble: Finding | None = None
    rotating = None
    if turning is not None:
        both = found.keeping(used), turning.keeping(used)
        with _in_log(recording):
            rotating, every_turn, trouble = calibrate_gyroscope(
                both,
                estimate,
                place,
                latitude,
                spans[used],
                known=known,
                frame=axes,
                si=(_said_si(recording, Sensor.GYROSCOPE), si),
            )
    found_all = Calibration(
        source=replace(recording.source, read=recording.source.read or ReadRange.of(recording.series)),
        gravity=place,
        rests=_rests((found, turning), result, place, spans_s=spans, z=z, sigma=sigma),
        turns=every_turn,
        accelerometer=result,
        gyroscope=rotating,
        temperature=_temperature(recording),
        noise={s.data.sensor.short: s.base for s in (found, turning) if s},
        findings=recording.findings,
        frame=frame,
    )
    final_rate, gyro_noise = _final_rates(turning)
    facts = Facts(
        found=found_all,
        in_hand=in_hand,
        z=z,
        estimate=estimate,
        trouble=trouble,
        rate_hz=recording.series[0].rate_hz,
        stamped=recording.series[0].clock.start_ns is not None,
        final_rate=final_rate,
        gyro_noise=gyro_noise,
    )
    return replace(found_all, findings=(*recording.findings, *findings_of(facts)))


def _known_angle(turns: str, recording: Recording, gyroscope: Triad | None, *, gyro: bool) -> KnownAngle:
    """Return the known angle of turns, for which there must be a gyroscope."""
    known = known_angle(turns)
    if not gyro:
        raise ArgumentError("turns of a known angle calibrate the gyroscope; omit turns, or gyro=False")
    if gyroscope is None:
        text = "no gyroscope, which turns of a known angle calibrate; omit the angle"
        raise DataError(text, place=recording.source.path)
    return known


@contextmanager
def _in_log(recording: Recording) -> Iterator[None]:
    """Name the log in an error about its data."""
    try:
        yield
    except DataError as error:
        raise error.within(recording.source.path) from error


def _final_rates(sensor: RestedSensor | None) -> tuple[FloatArray, FloatArray]:
    """Return the median size of the mean rate in the last quarter of a rest, and its deviation, shape (3,).

    The deviation is that of white noise; it is 0 if the samples of most rests do not change at all.
    """
    if sensor is None:
        return np.ones(3), np.ones(3)
    quarters = [
        sensor.data.samples[first + 3 * (end - first) // 4 : end] for first, end in sensor.rests.spans
    ]
    constant = np.median([np.ptp(part, axis=0) for part in quarters], axis=0) == 0
    length = float(np.median([len(part) for part in quarters]))
    noise = np.where(constant, 0.0, sensor.rests.deviations / np.sqrt(length))
    return np.median(np.abs([part.mean(axis=0) for part in quarters]), axis=0), noise


def _accelerometer_is_si(recording: Recording, data: Triad) -> bool:
    """Return whether samples are in m/s²; without a reader, whether their length is about that of gravity."""
    said = _said_si(recording, Sensor.ACCELEROMETER)
    if said is not None:
        return said
    length = float(np.nanmedian(np.linalg.norm(data.samples, axis=1)))
    return _LIKE_GRAVITY[0] < length < _LIKE_GRAVITY[1]


def _said_si(recording: Recording, sensor: Sensor) -> bool | None:
    """Return whether samples are in SI units, as decided when they were read; None without a reader."""
    unit = recording.source.values.get(f"{sensor} unit")
    return None if unit is None else unit != RAW_COUNTS


def _first_fit(data: Triad, rests: RestMeans, place: Gravity, *, si: bool) -> AccelerometerFit:
    """Return the accelerometer with white noise, for scale and directions."""
    noise = base_covariance(white_models(data, rests), data, rests)
    return fit_accelerometer(rests.means, noise, gravity=place.value, si=si)


def _excluded(z: FloatArray) -> BoolArray:
    moved = moved_rests(z)
    size = np.abs(z).max(axis=1)
    order = np.argsort(-np.where(moved, size, 0.0))
    moved[order[int(_MAX_MOVED * len(z)) :]] = False
    return moved


def _irreplaceable(up: FloatArray, moved: BoolArray) -> BoolArray:
    """Return which rests have an attitude, of unit vectors (m, 3), that the others need.

    None has if the rests that did not move have nine attitudes, which determine all parameters.
    """
    still = up[~moved]
    if len(still) and attitudes(still) >= len(PARAMETERS):
        return np.zeros_like(moved)
    repeated = [attitudes(np.vstack([still, one])) == attitudes(still) for one in up]
    return np.asarray(~np.array(repeated, dtype=np.bool_))


def _estimate(sensor: RestedSensor, place: Gravity, *, si: bool) -> AccelerometerEstimate:
    if len(sensor.rests.means) < MIN_RESTS:
        raise DataError(f"only {len(sensor.rests.means)} rests did not move", fix=Fix(ADVICE))
    return estimate_accelerometer(
        sensor.rests.means,
        sensor.covariance,
        sensor.walk,
        gravity=place.value,
        gravity_sigma=place.sigma,
        checked=sensor.base.checked,
        si=si,
    )


def _lower(theta: FloatArray) -> FloatArray:
    C = np.zeros((3, 3))
    C[LOWER] = theta[:6]
    return C


def _accelerometer(
    estimate: AccelerometerEstimate, frame: Frame, sensor: RestedSensor, place: Gravity, *, si: bool
) -> AccelerometerResult:
    to_frame = np.eye(9)
    to_frame[:6, :6] = [frame.derivatives[entry] for entry in frame.entries]
    diagonal = fit_accelerometer(
        sensor.rests.means,
        estimate.covariances,
        gravity=place.value,
        gravity_sigma=place.sigma,
        model="diagonal",
        si=si,
    )
    return AccelerometerResult(
        C=frame.R @ _lower(estimate.theta),
        b=estimate.theta[6:],
        covariance=to_frame @ estimate.covariance @ to_frame.T,
        parameters=accelerometer_parameters(estimate, frame, si=si),
        si=si,
        diagonal_C=diagonal.C,
        diagonal_b=diagonal.b,
        model=estimate.fit.model,
        excess=estimate.excess,
        chi2=estimate.chi2,
        dof=estimate.dof,
        p=estimate.p,
        suggestion=_turned(suggest_rest(estimate.fit, gravity=place.value), frame),
    )


def _turned(suggestion: Suggestion, frame: Frame) -> Suggestion:
    down = frame.R @ suggestion.down
    x, y, z = down.tolist()
    name = frame.parameters[PARAMETERS.index(suggestion.parameter)]
    return replace(suggestion, down=(x, y, z), text=describe_direction(down), parameter=name)


def _rests(
    sensors: tuple[RestedSensor, RestedSensor | None],
    result: AccelerometerResult,
    place: Gravity,
    *,
    spans_s: FloatArray,
    z: FloatArray,
    sigma: FloatArray,
) -> tuple[Rest, ...]:
    """Return the rests; `sigma`, shape (m,), is NaN if a rest moved."""
    found, turning = sensors
    means = found.rests.means
    f = (means - result.b) @ result.C.T
    norm = np.linalg.norm(f, axis=1)
    return tuple(
        Rest(
            start_s=start,
            end_s=end,
            mean_accel=tuple(means[k].tolist()),
            mean_gyro=tuple(turning.rests.means[k].tolist()) if turning else None,
            up=tuple((f[k] / norm[k]).tolist()),
            residual=float(norm[k] - place.value),
            before=float(np.linalg.norm(means[k]) - place.value),
            sigma=float(sigma[k]) if np.isfinite(sigma[k]) else None,
            z=float(z[k, np.argmax(np.abs(z[k]))]),
            used=bool(np.isfinite(sigma[k])),
            why="" if np.isfinite(sigma[k]) else "moved",
        )
        for k, (start, end) in enumerate(spans_s.tolist())
    )


def _temperature(recording: Recording) -> tuple[float, float, float] | None:
    if recording.temperature is None:
        return None
    known = recording.temperature.samples[np.isfinite(recording.temperature.samples)]
    return (float(known.mean()), float(known.min()), float(known.max())) if known.size else None
