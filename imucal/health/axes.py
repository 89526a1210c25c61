"""The orders, signs and scale of the gyroscope's axes that explain the accelerometer in turns."""

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.health.diagnosis import Question, Row, Values
from imucal.health.motion_evidence import orders_compared
from imucal.health.turning import PROPER, Turning
from imucal.screening.faults import signed_axes, wrong_axes

__all__ = ["HOW_TO_TURN", "ORDERS", "Orders", "axes_row", "explaining_orders"]

#: Most orders that are named if turns allow several: two turns often leave one axis open.
_NAMED = 4
#: Advice for logs with too few turns.
HOW_TO_TURN = "Turn the IMU by 60° or more about each of its three axes, with rests of 2 s between"

#: Largest unexplained share of the variance of f in a part that tells: turns explain 0.97 of it, translations
#: with the best of 48 orders less than 0.6.
_EXPLAINED = 0.3
#: The same in parts that show a scale or a delay: a hover with some sway reaches 0.2 with wrong ones.
_WELL_EXPLAINED = 0.15
#: Fewest such parts for a statement about the scale.
_LEAST_WELL = 4
#: Least share of the parts that must be explained well: below it, translation dominates.
_LEAST_SHARE = 1 / 3
#: Added to unexplained shares before their logarithms: the size of model errors.
_FLOOR = 0.02
#: Sum of the logarithms by which an order must be worse to be excluded. A part contributes up to 4.
_WORSE = 2.0
#: Largest share of evidence for an order that is excluded.
_CONTRARY = 0.25
#: rad/s per unit of a gyroscope -> the unit, for `imucal.read`.
_SCALES = {
    1.0: "rad/s",
    math.pi / 180: "deg/s",
    1e-3: "mrad/s",
    1e-3 * math.pi / 180: "mdeg/s",
    180 / math.pi: "",
}
#: Scales that are tried if no unit explains the turns: ten per decade, so that one is within 12 %.
_ANY_SCALE: FloatArray = np.geomspace(1e-5, 30.0, 66)
#: Number of parts with which they are tried; they turn most.
_FEW_PARTS = 12
#: Factors about a scale for its estimate.
_NEAR: FloatArray = 1.12 ** np.arange(-3.0, 4.0)
#: Factors about a unit that are tried first: a range that is wrong by a factor of 2 is common.
_COARSE: FloatArray = 2.0 ** (np.arange(-3.0, 4.0) / 3)

#: The axes of the accelerometer that x, y and z of the gyroscope measure, shape (48, 3, 3); the first is
#: the identity.
ORDERS: FloatArray = np.concatenate([PROPER, -PROPER]).transpose(0, 2, 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Orders(ReadOnlyArrays):
    """The signed orders of the gyroscope's axes that explain the turns.

    `possible`, shape (48,), are those of `ORDERS` that no turn excludes; `best` is the most likely. `scale`
    is in rad/s per unit of the samples, and `unit` its name for `imucal.read`, empty if there is none.
    `explained`, shape (b,), are the parts that tell; those of `well_explained` are little disturbed by
    translation. `shares`, shape (48,), are the mean unexplained shares of the variance in them.
    """

    possible: BoolArray
    best: int
    scale: float
    scale_range: tuple[float, float]
    unit: str
    explained: BoolArray
    well_explained: BoolArray
    shares: FloatArray

    @property
    def count(self) -> int:
        """Number of possible orders."""
        return int(self.possible.sum())


def explaining_orders(turning: Turning) -> Orders | None:
    """Return the orders and the scale of the gyroscope that explain the turns; None if none does."""
    turns_most = np.sort(np.argsort(-turning.variance)[:_FEW_PARTS])
    few = turning.keeping(np.isin(np.arange(turning.size), turns_most))
    for unit_scale, unit in _SCALES.items():
        scale = _best_scale(few, unit_scale * _COARSE)
        orders = _judged(_unexplained(turning, scale))
        if orders is not None:
            return _orders(turning, scale, unit, orders)
    scale = _best_scale(few, _ANY_SCALE)
    orders = _judged(_unexplained(turning, scale))
    return None if orders is None else _orders(turning, scale, "", orders)


def _best_scale(turning: Turning, scales: FloatArray) -> float:
    """Return the scale that explains most; the middle one unless another is clearly better."""
    misfits = np.array([_misfits(_unexplained(turning, scale)).min() for scale in scales])
    middle, best = scales.size // 2, int(misfits.argmin())
    return float(scales[best if misfits[middle] - misfits[best] > _WORSE else middle])


def _orders(turning: Turning, scale: float, unit: str, orders: "_Judged") -> Orders:
    """Return the orders with a scale near `scale`, and its range over the two halves of the turns."""
    unexplained = _unexplained(turning, scale)
    shares = unexplained[:, orders.best]
    well = np.flatnonzero(shares < _WELL_EXPLAINED)
    halves = [_refined(turning, scale, orders.best, half) for half in (well[::2], well[1::2])]
    return Orders(
        possible=orders.possible,
        best=orders.best,
        scale=_refined(turning, scale, orders.best, well),
        scale_range=(min(halves), max(halves)) if well.size >= _LEAST_WELL else (0.0, math.inf),
        unit=unit,
        explained=orders.explained,
        well_explained=shares < _WELL_EXPLAINED,
        shares=np.minimum(unexplained[orders.explained], 1.0).mean(axis=0),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judged(ReadOnlyArrays):
    possible: BoolArray
    best: int
    explained: BoolArray


def _unexplained(turning: Turning, scale: float) -> FloatArray:
    return np.hstack([turning.unexplained(scale), turning.unexplained(-scale)])


def _misfits(shares: FloatArray) -> FloatArray:
    # A part that an order misses badly says no more than that it misses it.
    return np.asarray(np.log(np.minimum(shares, 1.0) + _FLOOR).sum(axis=0))


def _judged(shares: FloatArray) -> _Judged | None:
    """Return the possible orders for unexplained shares of shape (b, 48); None if none explains enough."""
    misfits = _misfits(shares)
    best = int(misfits.argmin())
    # Equal ones are not excluded, and the log's own order comes first.
    explained = shares[:, best] < _EXPLAINED
    well = shares[:, best] < _WELL_EXPLAINED
    if well.sum() < max(1.0, _LEAST_SHARE * len(shares)):
        return None
    logs = np.log(np.minimum(shares[explained], 1.0) + _FLOOR)
    worse = logs - logs[:, [best]]
    against, in_favour = np.maximum(worse, 0).sum(axis=0), np.maximum(-worse, 0).sum(axis=0)
    excluded = (against - in_favour >= _WORSE) & (in_favour <= _CONTRARY * against)
    possible = ~excluded
    return _Judged(possible=possible, best=0 if possible[0] else best, explained=explained)


def _refined(turning: Turning, scale: float, order: int, which: IntArray) -> float:
    """Return the scale near another that explains most in some turns."""
    if not which.size:
        return scale
    few = turning.keeping(np.isin(np.arange(turning.size), which[:_FEW_PARTS]))
    sign = 1.0 if order < len(PROPER) else -1.0
    column = order % len(PROPER)
    misfits = np.array(
        [np.log(few.unexplained(sign * scale * factor)[:, column] + _FLOOR).sum() for factor in _NEAR]
    )
    lowest = int(misfits.argmin())
    if lowest in {0, len(_NEAR) - 1}:
        return scale * float(_NEAR[lowest])
    before, middle, after = misfits[lowest - 1 : lowest + 2]
    shift = 0.5 * (before - after) / max(before - 2 * middle + after, 1e-12)
    return scale * float(_NEAR[lowest] * (_NEAR[1] / _NEAR[0]) ** shift)


def axes_row(turning: Turning | None, orders: Orders | None) -> Row:
    """Return the row of axes and signs."""
    question = Question("axes and signs", "axes")
    if turning is None:
        found = "this log shows no turn of 35° or more within 3 s, with both sensors complete"
        return question.answer("unknown", found, f"{HOW_TO_TURN}.")
    if orders is None:
        found = (
            "no order of the gyroscope's axes explains the accelerometer: the IMU moves more than it turns"
        )
        return question.answer("unknown", found, f"{HOW_TO_TURN}.")
    parts, count = int(orders.explained.sum()), orders.count
    values: Values = {"possible": float(count), "turns": float(parts), "mapping": None}
    if orders.possible[0] and count == 1:
        found = f"of the 48 orders and signs of the axes, {_turns(parts)} only the one of this log"
        values["mapping"] = _mapping(ORDERS[0])
        return question.answer("pass", found, values=values)
    if orders.possible[0]:
        found = (
            f"{_turns(parts)} {count} of the 48 orders and signs of the axes, including the one of this log"
        )
        found += _named(orders, values)
        return question.answer("unknown", found, f"{HOW_TO_TURN}.", values=values)
    evidence = orders_compared(orders.shares, tuple(map(_mapping, ORDERS)))
    if count > 1:
        found = f"{_turns(parts)} {count} of the 48 orders and signs of the axes, and not the one of this log"
        found += _named(orders, values)
        advice = f"Check the order and the signs of the axes. {HOW_TO_TURN}, to find the right ones."
        return question.answer("fail", found, advice, values=values, evidence=evidence)
    right = ORDERS[orders.best]
    values["mapping"] = _mapping(right)
    return question.answer_by(wrong_axes(right), "fail", values, evidence)


def _named(orders: Orders, values: Values) -> str:
    """Return the possible orders as the end of a sentence, and add them to the values; empty if many."""
    if orders.count > _NAMED:
        return ""
    allowed = [ORDERS[place] for place in np.flatnonzero(orders.possible).tolist()]
    values["allowed"] = ", ".join(map(_mapping, allowed))
    texts = " or ".join(", ".join(signed_axes(order)) for order in allowed)
    return f": the gyroscope's x, y, z are {texts} of the accelerometer"


def _turns(parts: int) -> str:
    return "one turn allows" if parts == 1 else f"{parts} turns allow"


def _mapping(order: FloatArray) -> str:
    """Return ``x=-y y=x z=z``: the accelerometer's axes that the gyroscope's measure."""
    return " ".join(f"{axis}={right}" for axis, right in zip("xyz", signed_axes(order), strict=True))
