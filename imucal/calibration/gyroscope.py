"""The gyroscope of a calibration: its bias and g-sensitivity at rest, then its matrix from the turns."""

from dataclasses import replace

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.calibration.frames import Frame
from imucal.calibration.gravity import Gravity, earth_rate
from imucal.calibration.gyro_rest import GyroRest, estimate_gyro_rest
from imucal.calibration.known_turns import KnownAngle, known_of
from imucal.calibration.parameters import gyroscope_parameters, inverse, is_si
from imucal.calibration.poses import RestMeans, Triad, at_other_times
from imucal.calibration.requirements import trouble_of, unusable_turns
from imucal.calibration.rested_sensor import RestedSensor
from imucal.calibration.result import GyroscopeResult
from imucal.calibration.slow_noise import AccelerometerEstimate
from imucal.calibration.turn_data import Headings, Turn, TurnData, prepare_turns, start_of
from imucal.calibration.turns import GyroNoise, TurnsFit, direction_covariance, fit_turns
from imucal.errors import DataError
from imucal.findings import Finding, as_sentence
from imucal.noise import TERMS, NoiseModel

__all__ = ["calibrate_gyroscope", "gyro_scale", "scale_of"]


def scale_of(C: FloatArray | None) -> FloatArray:
    """Return raw units per SI unit of each axis, shape (3,); 1 if the matrix is unknown."""
    return np.ones(3) if C is None else np.linalg.norm(inverse(C), axis=1)


def gyro_scale(data: Triad, rests: RestMeans, up: FloatArray) -> FloatArray:
    """Return the scale of a gyroscope from its turns between the directions `up`, shape (m, 3)."""
    plain = _plain_turns(data, rests, up, unusable_turns(data, rests))
    return scale_of(None if plain is None else start_of(plain))


def _plain_turns(data: Triad, rests: RestMeans, up: FloatArray, reasons: list[str]) -> TurnData | None:
    """Return the turns without a reason against them, g-sensitivity ignored."""
    which = _without(reasons)
    return prepare_turns(data, rests, up, which) if which.size else None


def _without(reasons: list[str]) -> IntArray:
    return np.flatnonzero([not why for why in reasons])


def calibrate_gyroscope(
    sensors: tuple[RestedSensor, RestedSensor],
    estimate: AccelerometerEstimate,
    place: Gravity,
    latitude: float | None,
    spans_s: FloatArray,
    *,
    known: KnownAngle | None,
    frame: Frame,
    si: tuple[bool | None, bool],
) -> tuple[GyroscopeResult, tuple[Turn, ...], Finding | None]:
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
) -> tuple[FloatArray | None, FloatArray, Finding | None]:
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
        (fix,) = error.fixes
        text, advice = as_sentence(error.problem), as_sentence(fix.text)
        return None, unknown, Finding("error", "turns-unexplained", text, advice, axis="gyro", fix=fix)
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
