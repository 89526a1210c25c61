"""The unit of samples whose log does not say it: from gravity, and from the steps of the converter.

Gravity settles an accelerometer. Nothing settles a gyroscope as surely: its converter's step does where
it can be seen; otherwise rad/s beside an accelerometer in m/s^2 is taken, with a warning, where noise
and rate are those of a real gyroscope.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.units import G0

#: Counts per g of 16 bit converters at 2, 4, 8 and 16 g.
_COUNTS_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)

#: Scale errors of cheap sensors; the units themselves lie a factor of ten apart.
_GRAVITY_TOLERANCE = 0.15
#: The ranges of counts lie a factor of two apart, and a wrong one is a wrong result.
_COUNT_TOLERANCE = 0.05

_DEGREE = np.pi / 180

#: Steps of gyroscope converters, in deg/s per count, at the narrowest range; ranges double.
#: InvenSense (1/131 at 250 deg/s), Bosch and others (full range / 32768), ST (8.75 and 4.375 mdps).
_STEPS = tuple(
    base * 2.0**k
    for base, powers in ((1 / 131, range(-1, 4)), (125 / 32768, range(6)), (8.75e-3, range(-1, 5)))
    for k in powers
)
#: Agreement of a seen step with a known one; the next known steps are 28 % away.
_STEP_TOLERANCE = 1e-3

#: A gyroscope at rest does not turn faster, in rad/s.
_FASTEST_REST = 0.5
#: The noise of any gyroscope on sale is below this, in rad/s/sqrt(Hz) (0.3 deg/s/sqrt(Hz)).
_NOISIEST = 5e-3

#: Samples that are looked at.
_SAMPLE = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class AccelUnit:
    """What the magnitude of gravity says.

    Attributes
    ----------
    unit
        ``m/s^2``, ``g``, ``mg`` or ``count``; None where nothing fits.
    scale
        m/s^2 per count, where the unit is ``count``.
    reason
        In words.
    """

    unit: str | None
    scale: float | None = None
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroUnit:
    """What the samples of a gyroscope say.

    Attributes
    ----------
    unit
        ``rad/s`` or ``deg/s``; None where it is open.
    sure
        False where it is taken for want of anything better.
    reason
        In words.
    """

    unit: str | None
    sure: bool
    reason: str


def sample_of(axes: Sequence[FloatArray]) -> FloatArray:
    """Return up to 20 000 rows of a triad, spread over the log, finite ones only; shape (k, 3)."""
    n = min(axis.size for axis in axes)
    size = _SAMPLE // 4
    starts = sorted({max(0, min(n - size, k * n // 4)) for k in range(4)})
    rows = np.concatenate(
        [np.stack([axis[first : first + size] for axis in axes], axis=1) for first in starts]
    )
    return np.asarray(rows[np.isfinite(rows).all(axis=1)], dtype=np.float64)


def infer_accel_unit(rows: FloatArray) -> AccelUnit:
    """Return the unit in which samples of shape (k, 3) have the magnitude of gravity."""
    if not rows.size:
        return AccelUnit(unit=None, reason="there are no finite samples")
    size = float(np.median(np.sqrt((rows**2).sum(axis=1))))
    seen = f"median magnitude {size:.4g}"
    for unit, gravity in (("m/s^2", G0), ("g", 1.0), ("mg", 1000.0)):
        if abs(size / gravity - 1) <= _GRAVITY_TOLERANCE:
            return AccelUnit(unit=unit, reason=f"{seen} is gravity in {unit}")
    integers = bool((rows == np.round(rows)).all())
    for counts in _COUNTS_PER_G if integers else ():
        if abs(size / counts - 1) <= _COUNT_TOLERANCE:
            return AccelUnit(
                unit="count", scale=G0 / counts, reason=f"{seen} is gravity at {counts:.0f} counts per g"
            )
    if integers:
        near = min(_COUNTS_PER_G, key=lambda counts: abs(np.log(size / counts)) if size else 0.0)
        hint = (
            f"; a 16 bit sensor of {32768 / near:.0f} g range has {near:.0f} counts per g"
            if size > 1000
            else ""
        )
        return AccelUnit(unit=None, reason=f"integer counts of {seen}, which is 1 g at no usual range{hint}")
    return AccelUnit(unit=None, reason=f"{seen} is gravity in none of m/s^2, g and mg")


def infer_gyro_unit(rows: FloatArray, *, rate_hz: float | None, accel_unit: str | None) -> GyroUnit:
    """Return the unit of samples of shape (k, 3).

    Parameters
    ----------
    rows
        Rates, in an unknown unit.
    rate_hz
        Sampling rate, where known.
    accel_unit
        Unit of the accelerometer beside it.
    """
    if not rows.size:
        return GyroUnit(unit=None, sure=False, reason="there are no finite samples")
    if bool((rows == np.round(rows)).all()) and bool(rows.any()):
        return GyroUnit(unit=None, sure=False, reason="the rates are integer counts of an unknown scale")
    return _by_step(rows) or _by_size(rows, rate_hz, accel_unit)


def _by_step(rows: FloatArray) -> GyroUnit | None:
    """Return the unit in which the converter's step is a known one."""
    step = _step(rows)
    for unit, factor in (("deg/s", 1.0), ("rad/s", _DEGREE)):
        for known in _STEPS:
            if step is not None and abs(step / (known * factor) - 1) < _STEP_TOLERANCE:
                reason = f"the rates come in steps of {step:.6g}, a converter's {known:.6g} deg/s"
                return GyroUnit(unit=unit, sure=True, reason=reason)
    return None


def _by_size(rows: FloatArray, rate_hz: float | None, accel_unit: str | None) -> GyroUnit:
    """Return rad/s where rate and noise are those of a gyroscope in SI, beside an accelerometer in SI."""
    size = float(np.median(np.sqrt((rows**2).sum(axis=1))))
    if size > _FASTEST_REST:
        reason = f"the median rate {size:.3g} is too fast for rad/s at rest, so deg/s is likely"
        return GyroUnit(unit=None, sure=False, reason=reason)
    noise = _white_noise(rows, rate_hz)
    if noise is not None and noise > _NOISIEST:
        reason = f"a noise of {noise:.2g} rad/s/sqrt(Hz) is more than any gyroscope has, so deg/s is likely"
        return GyroUnit(unit=None, sure=False, reason=reason)
    if accel_unit == "m/s^2":
        reason = "nothing in the log says it; SI as the accelerometer beside it"
        return GyroUnit(unit="rad/s", sure=False, reason=reason)
    beside = (
        f"beside an accelerometer in {accel_unit}, deg/s is likely"
        if accel_unit
        else "nothing in the log says it"
    )
    return GyroUnit(unit=None, sure=False, reason=beside)


def _step(rows: FloatArray) -> float | None:
    """Return the step of which all values are multiples; None where there is none."""
    steps = []
    for axis in rows.T:
        values = np.unique(axis)
        if values.size < 3:
            continue
        differences = np.diff(values)
        # Values that differ by rounding alone are the same value.
        differences = differences[differences > 1e-6 * np.abs(values).max()]
        if not differences.size:
            continue
        step = float(differences.min())
        near = differences[differences < 1.5 * step]
        step = float(near.mean())
        multiples = differences / step
        if np.mean(np.abs(multiples - np.round(multiples)) < 0.05) < 0.98:
            return None
        steps.append(step)
    if not steps or max(steps) > 1.02 * min(steps):
        return None
    return float(np.mean(steps))


def _white_noise(rows: FloatArray, rate_hz: float | None) -> float | None:
    """Return the white noise density that steps between samples show, in units/sqrt(Hz)."""
    if rate_hz is None or rows.shape[0] < 100:
        return None
    differences = np.abs(np.diff(rows, axis=0))
    # 0.6745: the median of a normal deviate's magnitude; sqrt(2): a difference of two.
    sigma = np.median(differences, axis=0) / (0.6745 * np.sqrt(2))
    return float(sigma.min() / np.sqrt(rate_hz))
