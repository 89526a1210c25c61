"""Turns between rests as arrays, and a start for a fit of the gyroscope."""

import math
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.poses import RestMeans, Triad
from imucal.errors import DataError, Fix

__all__ = [
    "Headings",
    "Turn",
    "TurnData",
    "carried_directions",
    "is_in_place",
    "prepare_turns",
    "rotations",
    "start_of",
]

#: Median residual in rad above which a start is useless.
_LOST = 0.3
#: Largest change of the direction of gravity by a turn in place, in rad: 10°.
_IN_PLACE = math.radians(10.0)
#: Number of common scales to try, from a half to four times the likely one.
_SCALES = 60
#: Number of samples of the coarse turns.
_COARSE = 40


@dataclass(frozen=True, kw_only=True)
class Turn:
    """One turn between two used rests.

    `angle_deg` is the change of the direction of gravity, `known_deg` the angle about the vertical that the
    user knows. `residual_deg` and `before_deg` are components of the error with the calibration and before:
    two of gravity's direction, and the error of a known angle. `p` is None if the turn was not judged. `why`
    is the reason if it is not used.
    """

    start_s: float
    end_s: float
    angle_deg: float
    known_deg: float | None = None
    residual_deg: tuple[float, ...] | None = None
    before_deg: tuple[float, ...] | None = None
    p: float | None = None
    used: bool = False
    why: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class TurnData(ReadOnlyArrays):
    """Turns as arrays, padded to the longest.

    `rates`, shape (t, n, 3), are raw minus bias and g-sensitivity, 0 beyond a turn's end. `spans`, shape (t,
    2), are first sample and end. `share`, shape (t, n), is the weight of the later rest in the interpolated
    bias. `rests`, shape (t,), are indices of the rest before each turn. `up` has shape (m, 3). `known`, shape
    (t,), are angles about the vertical that the user knows, in rad, NaN if unknown, and `known_deviation` is
    their standard deviation.
    """

    rates: FloatArray
    spans: IntArray
    share: FloatArray
    rests: IntArray
    up: FloatArray
    tau0: float
    known: FloatArray
    known_deviation: float = 0.0

    @property
    def before(self) -> FloatArray:
        """Unit vectors of gravity at the rest before each turn, shape (t, 3)."""
        return self.up[self.rests]

    @property
    def after(self) -> FloatArray:
        """Unit vectors of gravity at the rest after each turn, shape (t, 3)."""
        return self.up[self.rests + 1]

    def keeping(self, keep: BoolArray) -> "TurnData":
        return replace(
            self,
            rates=self.rates[keep],
            spans=self.spans[keep],
            share=self.share[keep],
            rests=self.rests[keep],
            known=self.known[keep],
        )


def prepare_turns(
    data: Triad,
    rests: RestMeans,
    up: FloatArray,
    which: IntArray,
    g_parts: tuple[FloatArray, FloatArray] | None = None,
) -> TurnData:
    """Return the turns after the rests `which` as arrays.

    `g_parts` are G f at each sample and rest, shapes (n, 3) and (m, 3), by default 0.
    """
    first, end = rests.spans[which, 1], rests.spans[which + 1, 0]
    index = first[:, None] + np.arange(int((end - first).max()))
    live = index < end[:, None]
    index = np.minimum(index, len(data.samples) - 1)
    middle = rests.spans.mean(axis=1)
    share = (index - middle[which, None]) / (middle[which + 1] - middle[which])[:, None]
    part, part_at_rest = g_parts or (np.zeros_like(data.samples), 0.0)
    local = rests.means - part_at_rest
    bias = (1 - share)[..., None] * local[which, None] + share[..., None] * local[which + 1, None]
    return TurnData(
        rates=np.where(live[..., None], data.samples[index] - bias - part[index], 0.0),
        spans=np.column_stack([first, end]),
        share=share,
        rests=which,
        up=up,
        tau0=1 / data.rate_hz,
        known=np.full(which.size, np.nan),
    )


def start_of(data: TurnData) -> FloatArray:
    """Return the identity, or the common scale and, if necessary, the order of axes that explain the turns.

    If there is none, a DataError is raised.
    """
    coarse = _tilting(_coarse(data))
    identity = np.eye(3)
    if _misfit(coarse, identity) < _LOST:
        return identity
    whole = np.linalg.norm(coarse.rates.sum(axis=1), axis=1) * coarse.tau0
    angle = _tilts(coarse)
    # A turn about the vertical has no angle here: the ratio is a lower limit of the scale.
    lowest = np.median(angle / np.maximum(whole, 1e-12))
    best, least = identity, math.inf
    for turned in _orders():
        for scale in lowest * np.geomspace(0.5, 4.0, _SCALES):
            if (misfit := _misfit(coarse, scale * turned)) < least:
                best, least = scale * turned, misfit
        if least < _LOST / 3:
            return best
    if least < _LOST:
        return best
    raise DataError(
        "no scale of the gyroscope and no order of its axes explains the turns: the median error is "
        f"{math.degrees(least):.0f}°",
        fix=Fix("check that both sensors belong to one IMU and share one clock"),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Headings(ReadOnlyArrays):
    """A horizontal vector that is fixed to the earth, at m rests; its heading at the first one is unknown.

    `ahead` and `aside`, shape (m, 3), are two such vectors at right angles. After a missing turn another
    `chain` begins.
    """

    ahead: FloatArray
    aside: FloatArray
    chain: IntArray

    @classmethod
    def of(cls, data: TurnData, C: FloatArray) -> "Headings":
        turned = dict(zip(data.rests.tolist(), _whole(_coarse(data), C), strict=True))
        ahead, chain = np.empty_like(data.up), np.zeros(len(data.up), dtype=np.int64)
        for k, up in enumerate(data.up):
            if k - 1 in turned:
                guess, chain[k] = turned[k - 1] @ ahead[k - 1], chain[k - 1]
            else:
                guess, chain[k] = np.roll(up, 1) * [1.0, 1.0, -1.0], k
            across = guess - up * (up @ guess)
            ahead[k] = across / np.linalg.norm(across)
        return cls(ahead=ahead, aside=np.cross(data.up, ahead), chain=chain)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of each axis's part at the rests for components of variance 1, shape (3, m, m)."""
        both = sum(np.einsum("ia,ja->aij", one, one) for one in (self.ahead, self.aside))
        return np.asarray(both * (self.chain[:, None] == self.chain))


def rotations(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices of rotation vectors, shape (..., 3) to (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*vectors.shape, 3)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (cross @ cross)
    )


def _orders() -> list[FloatArray]:
    return [
        np.diag(np.array(signs)) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


def _misfit(data: TurnData, C: FloatArray) -> float:
    """Return the median angle between carried and measured directions, in rad."""
    v = np.einsum("tij,tj->ti", _whole(data, C), data.up[data.rests])
    return float(np.median(np.linalg.norm(v - data.up[data.rests + 1], axis=1)))


def _tilts(data: TurnData) -> FloatArray:
    """Return the angle between gravity before and after each turn, in rad, shape (t,)."""
    return np.asarray(np.arccos(np.clip(np.einsum("ti,ti->t", data.before, data.after), -1, 1)))


def is_in_place(data: TurnData) -> BoolArray:
    """Return which turns end in the attitude in which they began, shape (t,)."""
    return np.asarray(_tilts(data) < _IN_PLACE)


def _tilting(data: TurnData) -> TurnData:
    """Return the turns that change the attitude, if there are any: gravity shows no scale of the others."""
    tilted = ~is_in_place(data)
    return data.keeping(tilted) if tilted.any() else data


def carried_directions(data: TurnData, C: FloatArray) -> FloatArray:
    """Return gravity in the middle of each sample of each turn, carried from its start, shape (t, n, 3)."""
    half_steps = rotations(-data.tau0 / 2 * data.rates @ C.T)
    directions = np.empty_like(data.rates)
    now = data.before
    for k in range(data.rates.shape[1]):
        directions[:, k] = np.einsum("tij,tj->ti", half_steps[:, k], now)
        now = np.einsum("tij,tj->ti", half_steps[:, k], directions[:, k])
    return directions


def _whole(data: TurnData, C: FloatArray) -> FloatArray:
    """Return the rotation of the earth's vectors by each turn, shape (t, 3, 3)."""
    steps = rotations(-data.tau0 * data.rates @ C.T)
    whole = np.broadcast_to(np.eye(3), (len(steps), 3, 3))
    for k in range(steps.shape[1]):
        whole = steps[:, k] @ whole
    return whole


def _coarse(data: TurnData) -> TurnData:
    """Return the turns with means over blocks of samples."""
    t, n, _ = data.rates.shape
    length = max(1, -(-n // _COARSE))
    padded = np.zeros((t, -(-n // length) * length, 3))
    padded[:, :n] = data.rates
    return replace(data, rates=padded.reshape(t, -1, length, 3).mean(axis=2), tau0=data.tau0 * length)
