"""calibrate: a recording of rests and turns -> bias, scale, misalignment and g-sensitivity with intervals."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
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
from imucal.calibration.gravity import Gravity, earth_rate, gravity_at
from imucal.calibration.gyro_rest import GyroRest, estimate_gyro_rest
from imucal.calibration.known_turns import KnownAngle, known_angle, known_of
from imucal.calibration.noise_source import NoiseBase, base_covariance, noise_base, white_models
from imucal.calibration.parameters import accelerometer_parameters, gyroscope_parameters, inverse, is_si
from imucal.calibration.poses import (
    RestMeans,
    Triad,
    at_other_times,
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
    trouble_of,
    unusable_turns,
)
from imucal.calibration.result import AccelerometerResult, Calibration, GyroscopeResult, Rest
from imucal.calibration.slow_noise import AccelerometerEstimate, estimate_accelerometer, walk_covariance
from imucal.calibration.turn_data import Headings, Turn, TurnData, prepare_turns, start_of
from imucal.calibration.turns import GyroNoise, TurnsFit, direction_covariance, fit_turns
from imucal.errors import ArgumentError, DataError, Fix
from imucal.noise import TERMS, NoiseModel
from imucal.recording import RAW_COUNTS, ReadRange, Recording, Sensor
from imucal.report.result import Report
from imucal.user_input import seconds_of

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
        found = _Sensor.of(
            accelerometer,
            spans,
            noise,
            lambda rests: _scale(_first_fit(accelerometer, rests, place, si=si).C),
        )
        require_attitudes(found.rests.means)
        require_range(accelerometer, found.rests)
        turning = None
        if gyroscope is not None:
            up = _first_fit(accelerometer, found.rests, place, si=si).up
            turning = _Sensor.of(
                gyroscope,
                spans,
                noise,
                lambda rests: _gyro_scale(gyroscope, rests, up),
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
    trouble: DataError | None = None
    rotating = None
    if turning is not None:
        both = found.keeping(used), turning.keeping(used)
        with _in_log(recording):
            rotating, every_turn, trouble = _gyroscope(
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sensor:
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
    ) -> "_Sensor":
        rests = RestMeans.of(data, spans_s)
        base = noise_base(noise, data, rests, scale)
        return cls(data=data, rests=rests, base=base, movement=np.zeros_like(rests.means))

    def keeping(self, keep: BoolArray) -> "_Sensor":
        rests = replace(self.rests, spans=self.rests.spans[keep], means=self.rests.means[keep])
        return replace(self, rests=rests, movement=self.movement[keep])

    def moving(self, moved: BoolArray) -> "_Sensor":
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


def _final_rates(sensor: _Sensor | None) -> tuple[FloatArray, FloatArray]:
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


def _scale(C: FloatArray | None) -> FloatArray:
    return np.ones(3) if C is None else np.linalg.norm(inverse(C), axis=1)


def _gyro_scale(data: Triad, rests: RestMeans, up: FloatArray) -> FloatArray:
    plain = _plain_turns(data, rests, up, unusable_turns(data, rests))
    return _scale(None if plain is None else start_of(plain))


def _plain_turns(data: Triad, rests: RestMeans, up: FloatArray, reasons: list[str]) -> TurnData | None:
    """Return the turns without a reason against them, g-sensitivity ignored."""
    which = _without(reasons)
    return prepare_turns(data, rests, up, which) if which.size else None


def _without(reasons: list[str]) -> IntArray:
    return np.flatnonzero([not why for why in reasons])


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


def _estimate(sensor: _Sensor, place: Gravity, *, si: bool) -> AccelerometerEstimate:
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
    estimate: AccelerometerEstimate, frame: Frame, sensor: _Sensor, place: Gravity, *, si: bool
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


def _gyroscope(
    sensors: tuple[_Sensor, _Sensor],
    estimate: AccelerometerEstimate,
    place: Gravity,
    latitude: float | None,
    spans_s: FloatArray,
    *,
    known: KnownAngle | None,
    frame: Frame,
    si: tuple[bool | None, bool],
) -> tuple[GyroscopeResult, tuple[Turn, ...], DataError | None]:
    """Return the gyroscope, its turns, and why they could not be explained, or None.

    `si` is whether the gyroscope was said to be in rad/s, and whether the accelerometer is in m/s².
    """
    found, turning = sensors
    data, rests, fit = turning.data, turning.rests, estimate.fit
    at_rest = fit.f @ frame.R.T
    reasons = unusable_turns(data, rests)
    which = _without(reasons)
    plain = _plain_turns(data, rests, fit.up, reasons)
    start, angles, trouble = _start(plain, known, said_si=si[0])
    earth = earth_rate(latitude)
    headings = None if plain is None or start is None else Headings.of(plain, start)
    covariance, walk = turning.covariance, turning.walk
    rest = estimate_gyro_rest(
        rests.means,
        at_rest,
        covariance,
        walk,
        scale=(np.eye(3) if start is None else inverse(start)) @ frame.R.T,
        earth=earth,
        gravity=place.value,
        checked=turning.base.checked,
        headings=headings,
        scale_known=start is not None or si[0] is not False,
    )
    turns = None
    if start is not None:
        f = at_other_times(found.data, (found.data.samples - fit.b) @ (frame.R @ fit.C).T, data)
        parts = f @ rest.G_apparent.T, at_rest @ rest.G_apparent.T
        arrays = prepare_turns(data, rests, fit.up, which, parts)
        deviation = 0.0 if known is None else known.deviation
        arrays = replace(arrays, known=angles, known_deviation=deviation)
        models = tuple(
            NoiseModel(terms=(*model.terms, TERMS["K"].of(excess.kappa)))
            for model, excess in zip(turning.base.models, rest.excess, strict=True)
        )
        noise = GyroNoise(
            models=models,
            tau=np.array([excess.tau for excess in rest.excess]),
            rest_spans=rests.spans,
            samples=len(data.samples),
            headings=headings,
            horizontal=earth.horizontal_sigma,
        )
        accelerometer = fit, found.rests.means, estimate.covariances
        directions = direction_covariance(*accelerometer)
        turns = fit_turns(arrays, noise, directions, start)
        turns = turns.turned(frame, direction_covariance(*accelerometer, frame.slopes) - directions)
    said, as_accelerometer = si
    if said is None:
        said = as_accelerometer if turns is None else is_si(inverse(turns.C))
    every_turn = _turns(spans_s, fit.up, reasons, which, turns, known=angles)
    return _gyroscope_result(rest, turns, si=said), every_turn, trouble


def _start(
    plain: TurnData | None, known: KnownAngle | None, *, said_si: bool | None
) -> tuple[FloatArray | None, FloatArray, DataError | None]:
    """Return where the fit of the turns begins, their known angles, and why there is no such place, or None.

    The start has shape (3, 3); the angles, shape (t,), are NaN if unknown. `said_si` is whether the log is in
    rad/s, None if nothing says so. A DataError is raised if no turn has the known angle.
    """
    if plain is None:
        if known is not None:
            raise DataError(
                "no turn has the known angle, because none can be used: the gyroscope has gaps, is clipped "
                "or turns for more than 60 s in each of them"
            )
        return None, np.zeros(0), None
    unknown = np.full(len(plain.rests), np.nan)
    try:
        start = start_of(plain)
    except DataError as error:
        return None, unknown, error
    if trouble := trouble_of(start):
        return None, unknown, trouble
    if known is None:
        return start, unknown, None
    angles, start = known_of(plain, start, known, said_si=said_si)
    return start, angles, None


def _gyroscope_result(rest: GyroRest, turns: TurnsFit | None, *, si: bool) -> GyroscopeResult:
    C = np.eye(3) if turns is None else turns.C
    return GyroscopeResult(
        C=C,
        b=rest.b,
        G=rest.G,
        covariance_C=turns.covariance if turns else np.zeros((9, 9)),
        parameters=gyroscope_parameters(rest, turns, si=si),
        chi2=turns.chi2 if turns else np.nan,
        dof=turns.dof if turns else 0,
        p=turns.p_fit if turns else np.nan,
        widening=turns.widening if turns else 1.0,
        scaled=turns is not None,
        si=si,
        rest=rest,
    )


def _turns(
    spans_s: FloatArray,
    up: FloatArray,
    reasons: list[str],
    which: IntArray,
    fit: TurnsFit | None,
    *,
    known: FloatArray,
) -> tuple[Turn, ...]:
    """Return the turns; `known`, shape (t,), are known angles in rad of the turns after the rests `which`."""
    cosines = np.clip(np.einsum("mi,mi->m", up[:-1], up[1:]), -1.0, 1.0)
    angles = np.degrees(np.arccos(cosines)).tolist()
    turns = [
        Turn(start_s=start, end_s=end, angle_deg=angle, why=why or "unexplained")
        for start, end, angle, why in zip(
            spans_s[:-1, 1].tolist(), spans_s[1:, 0].tolist(), angles, reasons, strict=True
        )
    ]
    if fit is None:
        return tuple(turns)
    for k, rest in enumerate(which):
        turns[rest] = replace(
            turns[rest],
            known_deg=float(np.degrees(known[k])) if np.isfinite(known[k]) else None,
            residual_deg=_components_deg(fit.residual[k]),
            before_deg=_components_deg(fit.before[k]),
            p=float(fit.p[k]),
            used=bool(fit.used[k]),
            why="" if fit.used[k] else "wrong",
        )
    return tuple(turns)


def _components_deg(angles: FloatArray) -> tuple[float, ...]:
    """Return angles in rad as degrees, without NaN."""
    return tuple(np.degrees(angles[np.isfinite(angles)]).tolist())


def _rests(
    sensors: tuple[_Sensor, _Sensor | None],
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
