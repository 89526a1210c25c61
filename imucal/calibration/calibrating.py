"""calibrate: a recording of rests and turns -> bias, scale, misalignment and g-sensitivity with intervals."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.calibration.accelerometer import LOWER, fit_accelerometer, suggest_rest
from imucal.calibration.checks import Facts, findings_of
from imucal.calibration.gravity import Gravity, earth_rate, gravity_at
from imucal.calibration.gyro_rest import GyroRest, estimate_gyro_rest
from imucal.calibration.noise_source import NoiseBase, base_covariance, noise_base
from imucal.calibration.parameters import accelerometer_parameters, gyroscope_parameters
from imucal.calibration.poses import (
    RestMeans,
    Triad,
    attitudes,
    find_rests,
    half_differences,
    moved_rests,
    step_of,
    triad,
)
from imucal.calibration.result import AccelerometerResult, Calibration, GyroscopeResult, Rest, at_other_times
from imucal.calibration.slow_noise import AccelerometerEstimate, estimate_accelerometer, walk_covariance
from imucal.calibration.turn_data import Turn, prepare_turns, start_of
from imucal.calibration.turns import GyroNoise, TurnsFit, direction_covariance, fit_turns
from imucal.clock import seconds_of
from imucal.errors import DataError
from imucal.frozen import frozen_alone
from imucal.noise import TERMS, NoiseModel
from imucal.recording import AXES, Recording, Sensor
from imucal.report.result import Report

__all__ = ["calibrate"]

#: Fewest rests for any result.
_FEWEST = 6
#: At most this share of the rests is excluded as moved.
_MOST_MOVED = 1 / 3
#: Lengths of gravity that belong to a log in g.
_IN_G = 0.85, 1.15
#: Noise within a rest spans at least this many steps; with less, a rest may be constant without clipping.
_NOISY = 3
#: A longer turn is not used, in s.
_LONGEST_TURN_S = 60.0
#: A clipped axis repeats its extreme this often, and the extreme is this many steps from the level at rest.
_REPEATED, _FAR = 3, 20
_ADVICE = "put the IMU down on each face and on six edges, 5 s each: about 2 minutes"


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
) -> Calibration:
    """Calibrate an IMU from a log in which it is put down, left alone and turned, in 12 attitudes or more.

    Parameters
    ----------
    recording
        The log; raw counts are welcome.
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

    Raises
    ------
    DataError
        If the log cannot be calibrated: never moved, one attitude, fewer than 6 rests, a dead axis.
    ArgumentError
        If gravity, latitude or `rest_at_least` is impossible.
    """
    where = f"{recording.source.path}: "
    place = gravity_at(gravity=gravity, latitude=latitude, height=height)
    accelerometer = triad(recording, Sensor.ACCELEROMETER)
    gyroscope = triad(recording, Sensor.GYROSCOPE) if gyro else None
    if accelerometer is None:
        raise DataError(f"{where}no accelerometer; calibration needs gravity as its reference")
    try:
        spans = find_rests(accelerometer, gyroscope, at_least_s=seconds_of(rest_at_least), in_hand=in_hand)
        _require_rests(spans, accelerometer)
        found = _Sensor.of(accelerometer, spans, noise)
        _require_attitudes(found.rests.means)
        _require_range(accelerometer, found.rests)
        turning = _Sensor.of(gyroscope, spans, noise) if gyroscope is not None else None
        z = np.column_stack([half_differences(s.data, s.rests, s.base.models) for s in (found, turning) if s])
        used = ~_worst(z)
        estimate = _estimate(found.keeping(used), place)
    except DataError as error:
        raise DataError(where + str(error).removeprefix(where)) from error
    result = _accelerometer(estimate, found.keeping(used), place)
    turns: tuple[Turn, ...] = ()
    trouble, rotating = "", None
    if turning is not None:
        both = found, turning.keeping(used)
        rotating, turns, trouble = _gyroscope(both, estimate, place, latitude, spans[used])
    temperature = _temperature(recording)
    bases = {s.data.sensor.short: s.base for s in (found, turning) if s}
    facts = Facts(
        gravity=place,
        in_hand=in_hand,
        z=z,
        spans_s=spans,
        used=used,
        accelerometer=estimate,
        parameters=result.parameters,
        gyro_parameters=rotating.parameters if rotating else {},
        suggestion=result.suggestion,
        turns=turns,
        trouble=trouble,
        earth_share=rotating.rest.earth_share if rotating else 0.0,
        temperature=temperature,
        bases=bases,
    )
    return Calibration(
        source=recording.source,
        gravity=place,
        rests=_rests(facts, found, turning, result),
        turns=turns,
        accelerometer=result,
        gyroscope=rotating,
        temperature=temperature,
        noise=bases,
        findings=(*recording.findings, *findings_of(facts)),
    )


@frozen_alone
class _Sensor:
    """A sensor with its rests and its noise."""

    data: Triad
    rests: RestMeans
    base: NoiseBase

    @classmethod
    def of(
        cls, data: Triad, spans_s: FloatArray, noise: Report | Mapping[str, NoiseModel] | None
    ) -> "_Sensor":
        rests = RestMeans.of(data, spans_s)
        return cls(data=data, rests=rests, base=noise_base(noise, data, rests))

    def keeping(self, keep: BoolArray) -> "_Sensor":
        rests = replace(self.rests, spans=self.rests.spans[keep], means=self.rests.means[keep])
        return replace(self, rests=rests)

    @property
    def covariance(self) -> FloatArray:
        return base_covariance(self.base, self.data, self.rests)

    @property
    def walk(self) -> FloatArray:
        return walk_covariance(self.rests.spans, rate_hz=self.data.rate_hz, samples=len(self.data.samples))


def _require_rests(spans_s: FloatArray, data: Triad) -> None:
    if len(spans_s) < _FEWEST:
        raise DataError(f"found {len(spans_s)} of at least {_FEWEST} rests in {data.end_s:.0f} s; {_ADVICE}")


def _require_attitudes(means: FloatArray) -> None:
    """Raise a DataError if all means of an accelerometer in SI units have one direction."""
    norm = np.linalg.norm(means, axis=1)
    # Raw counts may have an offset that hides the direction; then the fit notices.
    if np.all((norm > 5) & (norm < 15)) and attitudes(means / norm[:, None]) == 1:
        raise DataError(f"all {len(means)} rests have the same attitude within 10°; {_ADVICE}")


def _require_range(data: Triad, rests: RestMeans) -> None:
    """Raise a DataError if the samples are in g, or an axis is clipped at rest."""
    norm = float(np.median(np.linalg.norm(rests.means, axis=1)))
    if _IN_G[0] < norm < _IN_G[1]:
        msg = f"the accelerometer reads {norm:.3g} at rest and not 9.81 m/s²: its unit is g"
        raise DataError(msg)
    for axis, column in enumerate(data.samples.T):
        parts = [column[first:end] for first, end in rests.spans]
        extremes = np.nanmin(column), np.nanmax(column)
        constant = np.array([np.ptp(part) == 0 and part[0] in extremes for part in parts])
        # With coarse steps other rests are constant too.
        if constant.any() and np.median([np.ptp(part) for part in parts]) > _NOISY * step_of(column):
            value = float(parts[int(np.argmax(constant))][0])
            share = f"{int(constant.sum())} of {len(parts)} rests"
            msg = (
                f"accel_{AXES[axis]} is clipped at {value:.4g} in {share}; "
                "choose a larger range of the accelerometer"
            )
            raise DataError(msg)


def _worst(z: FloatArray) -> BoolArray:
    """Return which rests to exclude as moved, at most a third."""
    moved = moved_rests(z)
    size = np.abs(z).max(axis=1)
    order = np.argsort(-np.where(moved, size, 0.0))
    moved[order[int(_MOST_MOVED * len(z)) :]] = False
    return moved


def _estimate(sensor: _Sensor, place: Gravity) -> AccelerometerEstimate:
    if len(sensor.rests.means) < _FEWEST:
        raise DataError(f"only {len(sensor.rests.means)} rests did not move; {_ADVICE}")
    return estimate_accelerometer(
        sensor.rests.means,
        sensor.covariance,
        sensor.walk,
        gravity=place.value,
        gravity_sigma=place.sigma,
        checked=sensor.base.checked,
    )


def _accelerometer(estimate: AccelerometerEstimate, sensor: _Sensor, place: Gravity) -> AccelerometerResult:
    C = np.zeros((3, 3))
    C[LOWER] = estimate.theta[:6]
    diagonal = fit_accelerometer(
        sensor.rests.means,
        estimate.covariances,
        gravity=place.value,
        gravity_sigma=place.sigma,
        model="diagonal",
    )
    return AccelerometerResult(
        C=C,
        M=np.asarray(np.linalg.inv(C), dtype=np.float64),
        b=estimate.theta[6:],
        covariance=estimate.covariance,
        parameters=accelerometer_parameters(estimate),
        diagonal_C=diagonal.C,
        diagonal_b=diagonal.b,
        model=estimate.fit.model,
        excess=estimate.excess,
        chi2=estimate.chi2,
        dof=estimate.dof,
        p=estimate.p,
        suggestion=suggest_rest(estimate.fit, gravity=place.value),
    )


def _gyroscope(
    sensors: tuple[_Sensor, _Sensor],
    estimate: AccelerometerEstimate,
    place: Gravity,
    latitude: float | None,
    spans_s: FloatArray,
) -> tuple[GyroscopeResult, tuple[Turn, ...], str]:
    """Return the gyroscope, its turns, and why they could not be explained."""
    found, turning = sensors
    data, rests, fit = turning.data, turning.rests, estimate.fit
    reasons = _unusable(data, rests)
    which = np.flatnonzero([not why for why in reasons])
    trouble, start = "", None
    if which.size:
        try:
            arrays = prepare_turns(
                data.samples, rests.spans, rests.means, fit.up, which, rate_hz=data.rate_hz
            )
            start = start_of(arrays)
            if turned := _order_of(start):
                trouble = (
                    f"x, y, z of the gyroscope are {turned} of the accelerometer; give both sensors the same "
                    "axes, in the log or when it is read"
                )
                start = None
        except DataError as error:
            trouble = str(error)
    earth = earth_rate(latitude)
    covariance, walk = turning.covariance, turning.walk
    rest = estimate_gyro_rest(
        rests.means,
        fit.f,
        covariance,
        walk,
        scale=np.asarray(np.eye(3) if start is None else np.linalg.inv(start), dtype=np.float64),
        earth=earth,
        gravity=place.value,
        checked=turning.base.checked,
    )
    turns = None
    if start is not None:
        f = at_other_times(found.data, (found.data.samples - fit.b) @ fit.C.T, data)
        arrays = prepare_turns(
            data.samples,
            rests.spans,
            rests.means,
            fit.up,
            which,
            rate_hz=data.rate_hz,
            g_part=f @ rest.G_apparent.T,
            g_part_at_rest=fit.f @ rest.G_apparent.T,
        )
        models = tuple(
            NoiseModel(terms=(*model.terms, TERMS["K"].of(excess.kappa)))
            for model, excess in zip(turning.base.models, rest.excess, strict=True)
        )
        noise = GyroNoise(
            models=models,
            tau=np.array([excess.tau for excess in rest.excess]),
            rest_spans=rests.spans,
            samples=len(data.samples),
        )
        raw_means = (fit.f @ np.linalg.inv(fit.C).T) + fit.b
        turns = fit_turns(arrays, noise, direction_covariance(fit, raw_means, estimate.covariances))
    return _gyroscope_result(rest, turns), _turns(spans_s, fit.up, reasons, which, turns), trouble


def _order_of(start: FloatArray) -> str:
    """Return such as ``y, -x, z`` for a start with permuted or mirrored axes; empty for the usual order."""
    signed = np.sign(np.where(np.abs(start) > 1e-6 * np.abs(start).max(), start, 0.0))
    if np.array_equal(signed, np.eye(3)):
        return ""
    # Column k of C maps the gyroscope's axis k to the frame.
    places = np.argmax(np.abs(signed), axis=0)
    return ", ".join(f"{'-' if signed[i, k] < 0 else ''}{AXES[i]}" for k, i in enumerate(places))


def _gyroscope_result(rest: GyroRest, turns: TurnsFit | None) -> GyroscopeResult:
    C = np.eye(3) if turns is None else turns.C
    return GyroscopeResult(
        C=C,
        M=np.asarray(np.linalg.inv(C), dtype=np.float64),
        b=rest.b,
        G=rest.G,
        covariance_C=turns.covariance if turns else np.zeros((9, 9)),
        parameters=gyroscope_parameters(rest, turns),
        chi2=turns.chi2 if turns else np.nan,
        dof=turns.dof if turns else 0,
        p=turns.p_fit if turns else np.nan,
        widening=turns.widening if turns else 1.0,
        scaled=turns is not None,
        rest=rest,
    )


def _unusable(data: Triad, rests: RestMeans) -> list[str]:
    """Return why each turn between rests cannot be used; an empty text if it can."""
    level = np.median(rests.means, axis=0)
    finite = [column[np.isfinite(column)] for column in data.samples.T]
    extremes = [(low, high) for low, high in ((c.min(), c.max()) for c in finite)]
    far = [_FAR * step_of(column) for column in finite]
    reasons = []
    for first, end in zip(rests.spans[:-1, 1], rests.spans[1:, 0], strict=True):
        part = data.samples[first:end]
        clipped = any(
            abs(value - level[axis]) > far[axis] and _repeats(part[:, axis] == value)
            for axis in range(3)
            for value in extremes[axis]
        )
        gap = not np.isfinite(part).all()
        long = len(part) > _LONGEST_TURN_S * data.rate_hz
        reasons.append("gap" if gap else "clipped" if clipped else "long" if long else "")
    return reasons


def _repeats(equal: BoolArray) -> bool:
    return bool(np.convolve(equal, np.ones(_REPEATED), "valid").max(initial=0) >= _REPEATED)


def _turns(
    spans_s: FloatArray, up: FloatArray, reasons: list[str], which: IntArray, fit: TurnsFit | None
) -> tuple[Turn, ...]:
    turns = []
    for rest, why in enumerate(reasons):
        cosine = float(np.clip(up[rest] @ up[rest + 1], -1.0, 1.0))
        turn = Turn(
            start_s=float(spans_s[rest, 1]),
            end_s=float(spans_s[rest + 1, 0]),
            angle_deg=float(np.degrees(np.arccos(cosine))),
            residual_deg=None,
            before_deg=None,
            p=None,
            used=False,
            why=why or "unexplained",
        )
        if fit is not None and not why:
            k = int(np.searchsorted(which, rest))
            turn = replace(
                turn,
                residual_deg=_two(fit.residual[k]),
                before_deg=_two(fit.before[k]),
                p=float(fit.p[k]),
                used=bool(fit.used[k]),
                why="" if fit.used[k] else "wrong",
            )
        turns.append(turn)
    return tuple(turns)


def _two(residual: FloatArray) -> tuple[float, float]:
    first, second = np.degrees(residual).tolist()
    return first, second


def _rests(
    facts: Facts, found: _Sensor, turning: _Sensor | None, result: AccelerometerResult
) -> tuple[Rest, ...]:
    means, used, gravity = found.rests.means, facts.used, facts.gravity.value
    f = (means - result.b) @ result.C.T
    norm = np.linalg.norm(f, axis=1)
    sigma = np.full(len(means), np.nan)
    sigma[used] = np.sqrt(np.diag(facts.accelerometer.fit.residual_covariance))
    return tuple(
        Rest(
            start_s=float(facts.spans_s[k, 0]),
            end_s=float(facts.spans_s[k, 1]),
            mean_accel=tuple(means[k].tolist()),
            mean_gyro=tuple(turning.rests.means[k].tolist()) if turning else None,
            up=tuple((f[k] / norm[k]).tolist()),
            residual=float(norm[k] - gravity),
            before=float(np.linalg.norm(means[k]) - gravity),
            sigma=float(sigma[k]) if used[k] else None,
            z=float(facts.z[k, np.argmax(np.abs(facts.z[k]))]),
            used=bool(used[k]),
            why="" if used[k] else "moved",
        )
        for k in range(len(means))
    )


def _temperature(recording: Recording) -> tuple[float, float, float] | None:
    if recording.temperature is None:
        return None
    known = recording.temperature.samples[np.isfinite(recording.temperature.samples)]
    return (float(known.mean()), float(known.min()), float(known.max())) if known.size else None
