"""The time by which the accelerometer is later than the gyroscope, from turns."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.health.axes import HOW_TO_TURN, Orders
from imucal.health.diagnosis import Question, Row, Values
from imucal.health.evidence import Curve, Evidence, Limit
from imucal.health.turning import MODEL_ERROR, PROPER, Turning

__all__ = ["Delay", "delay_row", "estimate_delay"]

#: Longest delay that is searched, in s.
_LONGEST_S = 0.2
#: Step of the search, in s.
_SEARCH_S = 0.02
#: Number of Newton steps; the last one changes less than 0.01 ms.
_STEPS = 3
#: Fewest turns for an interval: with three degrees of freedom it is 1.6 times the asymptotic one.
_LEAST_TURNS = 4
#: Least share of the turns that the gyroscope must explain well: otherwise translation shifts all of them.
_LEAST_SHARE = 0.5
#: Smallest error of f in a turn, as a share of gravity: no turn counts more than one with this.
_SMALLEST_ERROR = 2e-3
#: Distance from the point of rotation of an IMU that turns in place, in m.
_NO_LEVER_M = 1e-4
#: Standard deviations of the errors that all turns share: the delay in s, scales and misalignments of the
#: gyroscope, its bias in rad/s, scales and misalignments of the accelerometer, its bias / g.
_COMMON = np.concatenate([[1.0], np.full(9, 0.02), np.full(3, 0.01), np.full(9, 0.01), np.full(3, 0.01)])
#: Their places in `_COMMON`.
_GYRO_MATRIX = slice(1, 10)
_GYRO_BIAS = slice(10, 13)
_ACCEL_MATRIX = slice(13, 22)
_ACCEL_BIAS = slice(22, 25)
#: Delay that matters, in s: at 3 rad/s gravity is wrong by 0.3°, like the bias of a good accelerometer.
_NOTABLE_S = 0.002
#: The same in sampling periods: stamps at the start or in the middle of a sample differ by a half.
_NOTABLE_PERIODS = 0.55
#: Delay that is a fault, in s: at 3 rad/s gravity is wrong by 3.4°.
_LARGE_S = 0.02
#: The same in sampling periods: sensors that are polled one after the other differ by up to one.
_LARGE_PERIODS = 1.5
#: Probability of the interval.
_LEVEL = 0.95


#: Number of delays in the picture.
_SHOWN = 81
#: Half-width of the picture, in delays.
_WIDTH_SHOWN = 2.5
#: Least half-width of the picture, in s.
_LEAST_SHOWN_S = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Delay(ReadOnlyArrays):
    """A delay with its 95 % interval, in s: the accelerometer is later if it is positive.

    `common`, shape (25,), are the estimated errors that all turns share.
    """

    seconds: float
    half_width_s: float
    turns: int
    common: FloatArray


def estimate_delay(turning: Turning, orders: Orders) -> Delay | None:
    """Return the delay of the accelerometer; None if there are too few turns.

    Errors of scale, alignment and bias of both sensors are common to all turns, and estimated with the delay:
    an error of alignment by 1 % moves gravity as much as a delay of some ms. The interval is Student's t of
    the scatter when each turn is left out, because slow translation shifts each turn by more than the
    noise. It is widened by the difference between the estimates with and without a distance from the point
    of rotation: hands do not turn about a fixed point.

    Source: Tukey's jackknife; Efron and Stein (1981), Ann. Stat. 9(3), 586.
    """
    turns, rates, turned = _explained_turns(turning, orders)
    if turns.size < max(_LEAST_TURNS, _LEAST_SHARE * turning.size):
        return None
    about_a_point = _estimate(turns, rates, turned)
    in_place = _estimate(replace(turns, lever_m=_NO_LEVER_M), rates, turned)
    if about_a_point is None or in_place is None:
        return None
    difference = about_a_point.seconds - in_place.seconds
    return replace(about_a_point, half_width_s=math.hypot(about_a_point.half_width_s, difference))


def _explained_turns(turning: Turning, orders: Orders) -> tuple[Turning, FloatArray, FloatArray]:
    """Return the turns that the gyroscope explains well, its rates in rad/s, and the order of its axes."""
    turns = turning.keeping(orders.well_explained)
    sign = 1.0 if orders.best < len(PROPER) else -1.0
    return turns, sign * orders.scale * turns.rates, PROPER[orders.best % len(PROPER)]


def _estimate(turns: Turning, rates: FloatArray, turned: FloatArray) -> Delay | None:
    """Return the delay with the interval of the scatter alone."""
    shift = _searched(turns, rates, turned)
    if shift is None:
        return None
    errors = np.zeros(_COMMON.size)
    normal, score = np.zeros((turns.size, errors.size, errors.size)), np.zeros((turns.size, errors.size))
    for _ in range(_STEPS):
        force = turns.shifted(shift) @ turned
        normal, score = _equations(turns, _rates_without(errors, rates), _force_without(errors, force))
        total = normal.sum(axis=0) + np.diag(_COMMON**-2)
        change = np.linalg.solve(total, score.sum(axis=0) - errors * _COMMON**-2)
        errors = errors + change
        shift += float(change[0])
        errors[0] = 0.0
        if abs(shift) > _LONGEST_S:
            return None
    without = [
        float(np.linalg.solve(total - one, score.sum(axis=0) - part - errors * _COMMON**-2)[0])
        for one, part in zip(normal, score, strict=True)
    ]
    error = math.sqrt((turns.size - 1) * float(np.var(without)))
    t = float(stdtrit(turns.size - 1, (1 + _LEVEL) / 2))
    return Delay(seconds=shift, half_width_s=t * error, turns=turns.size, common=errors)


def _rates_without(errors: FloatArray, rates: FloatArray) -> FloatArray:
    """Return rates without the errors that all turns share."""
    return np.asarray(rates @ (np.eye(3) + errors[_GYRO_MATRIX].reshape(3, 3)).T + errors[_GYRO_BIAS])


def _force_without(errors: FloatArray, force: FloatArray) -> FloatArray:
    """Return forces without the errors that all turns share."""
    matrix = np.eye(3) + errors[_ACCEL_MATRIX].reshape(3, 3)
    return np.asarray((force - errors[_ACCEL_BIAS]) @ np.linalg.inv(matrix).T)


def _searched(turns: Turning, rates: FloatArray, turned: FloatArray) -> float | None:
    """Return the delay of the grid that explains most, in s; None if it is at an end of the grid."""
    design = turns.design(rates)
    floor = _SMALLEST_ERROR**2 * turns.weights.sum(axis=1)
    shifts = np.arange(-_LONGEST_S, _LONGEST_S + _SEARCH_S / 2, _SEARCH_S)
    squares = (turns.residuals(design, turns.shifted(shift), turned[None])[:, 0] for shift in shifts)
    best = int(np.argmin([float(np.log(square + floor).sum()) for square in squares]))
    return float(shifts[best]) if 0 < best < len(shifts) - 1 else None


def _equations(turns: Turning, rates: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return normal matrices, shape (b, k, k), and scores, (b, k), of the common errors.

    The gravity at the start of each part and its distance from the point of rotation are projected out.
    """
    b, n, _ = rates.shape
    root = np.sqrt(turns.weights)[..., None]
    rotated, levers = turns.rotated(rates), turns.levers(rates)
    own = np.concatenate([rotated, levers], axis=3)
    basis = turns.design(rates)[:, : 3 * n]
    y = (root * force).reshape(b, 3 * n, 1)
    gram = np.einsum("bnij,bnik,bn->bjk", own, own, turns.weights)
    gram[:, range(3, 6), range(3, 6)] += MODEL_ERROR**2
    start = np.linalg.solve(gram, np.einsum("bnij,bni,bn->bj", own, force, turns.weights)[..., None])
    model = (own @ start[:, None])[..., 0]
    direction = (rotated @ start[:, None, :3])[..., 0]
    columns = np.zeros((b, n, 3, _COMMON.size))
    columns[..., 0] = -np.gradient(model, turns.step_s, axis=1)
    inverse = rotated.transpose(0, 1, 3, 2)
    # A small rotation φ since the start changes R g₀ by -R (φ × g₀).
    angle = np.cumsum(np.einsum("bnki,bnj->bnkij", inverse, rates), axis=1).reshape(b, n, 3, 9)
    drift = np.cumsum(inverse, axis=1)
    small = turns.step_s * np.concatenate([angle, drift], axis=3)
    gravity = start[:, None, :3]
    columns[..., 1:13] = rotated @ np.cross(gravity, small, axisa=2, axisb=2, axisc=2)
    columns[..., 13:22] = np.einsum("ki,bnj->bnkij", np.eye(3), direction).reshape(b, n, 3, 9)
    columns[..., 22:25] = np.eye(3)
    x = (root[..., None] * columns).reshape(b, 3 * n, -1)
    transposed = basis.transpose(0, 2, 1)
    x = x - basis @ (transposed @ x)
    y = y - basis @ (transposed @ y)
    total = turns.weights.sum(axis=1)
    variance = ((y**2).sum(axis=(1, 2)) / total + _SMALLEST_ERROR**2)[:, None, None]
    return np.asarray(x.transpose(0, 2, 1) @ x / variance), (x.transpose(0, 2, 1) @ y / variance)[..., 0]


def delay_row(turning: Turning | None, orders: Orders | None, *, period_s: float) -> Row:
    """Return the row of the delay; `period_s` is the longer sampling period of the two sensors."""
    question = Question("delay of the sensors", "sensor-delay")
    advice = f"{HOW_TO_TURN}, five times or more."
    delay = None
    told = orders is not None and (orders.possible[0] or orders.count == 1)
    if turning is not None and orders is not None and told:
        delay = estimate_delay(turning, orders)
    if turning is None or orders is None or delay is None:
        found = "too few turns are explained by the gyroscope for a delay between the sensors"
        return question.answer("unknown", found, advice)
    values: Values = {
        "delay_s": delay.seconds,
        "low_s": delay.seconds - delay.half_width_s,
        "high_s": delay.seconds + delay.half_width_s,
        "turns": float(delay.turns),
    }
    late = "accelerometer" if delay.seconds >= 0 else "gyroscope"
    milliseconds, half_ms = 1e3 * abs(delay.seconds), 1e3 * delay.half_width_s
    digits = _decimals(half_ms)
    found = (
        f"the {late} is {milliseconds:.{digits}f} ± {half_ms:.{digits}f} ms later (95 %, {delay.turns} turns)"
    )
    notable = max(_NOTABLE_S, _NOTABLE_PERIODS * period_s)
    least = abs(delay.seconds) - delay.half_width_s
    if least > max(_LARGE_S, _LARGE_PERIODS * period_s):
        fix = "Stamp both sensors from one interrupt, or give the delay to the filter."
        evidence = _evidence(turning, orders, delay)
        return question.answer("fail", found, fix, values=values, evidence=evidence)
    if least > notable:
        fix = "Give the delay to the filter, or use the same digital filter for both sensors."
        evidence = _evidence(turning, orders, delay)
        return question.answer("warn", found, fix, values=values, evidence=evidence)
    if abs(delay.seconds) + delay.half_width_s > 2 * notable:
        return question.answer("unknown", found, advice, values=values)
    return question.answer("pass", found, values=values)


def _decimals(half_width: float) -> int:
    """Return the decimals of two digits of a half-width."""
    return max(0, 1 - math.floor(math.log10(max(half_width, 1e-3))))


def _evidence(turning: Turning, orders: Orders, delay: Delay) -> Evidence:
    """Return the error of gravity in the turns against the delay."""
    turns, rates, turned = _explained_turns(turning, orders)
    half = max(_LEAST_SHOWN_S, _WIDTH_SHOWN * abs(delay.seconds))
    shifts = np.linspace(-half, half, _SHOWN)
    design = turns.design(_rates_without(delay.common, rates))
    weight = float(turns.weights.sum())
    errors = []
    for shift in shifts:
        force = _force_without(delay.common, turns.shifted(shift) @ turned)
        squares = turns.residuals(design, force, np.eye(3)[None])
        errors.append(math.sqrt(max(float(squares.sum()), 0.0) / weight))
    low, high = delay.seconds - delay.half_width_s, delay.seconds + delay.half_width_s
    return Evidence(
        title=f"error of gravity in {turns.size} turns, if the accelerometer is this much later",
        x_label="delay of the accelerometer (ms)",
        y_label="error of gravity (mrad)",
        curves=(
            Curve(label="root mean square error", x=1e3 * shifts, y=1e3 * np.array(errors), look="line"),
        ),
        limits=(
            Limit(label="no delay", value=0.0, upright=True),
            Limit(label=f"{1e3 * delay.seconds:.2g} ms", value=1e3 * delay.seconds, upright=True),
        ),
        shaded=((1e3 * low, 1e3 * high),),
        shade_label="95 % interval",
    )
