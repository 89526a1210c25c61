"""The unit of samples: as given, as the log states it, or inferred; and why.

Gravity settles an accelerometer. Nothing settles a gyroscope as surely: its converter's step does where
it can be seen; otherwise rad/s beside an accelerometer in m/s^2 is taken, with a warning, where noise
and rate are those of a real gyroscope.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.clock import Clock
from imucal.errors import ChoiceError, as_one
from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.recording import AXES, Axis, Sensor
from imucal.units import G0, SAMPLE_UNITS, parse_sample_unit

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

#: The mean of samples in g is at least so many g long, in whatever way a phone was carried. Accelerations
#: without gravity may be of any size, and cancel.
_CARRIED = 0.6

#: A gyroscope at rest does not turn faster, in rad/s.
_FASTEST_REST = 0.5
#: The noise of any gyroscope on sale is below this, in rad/s/sqrt(Hz) (0.3 deg/s/sqrt(Hz)).
_NOISIEST = 5e-3

#: Samples that are looked at.
_SAMPLE = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitGuess:
    """What is known of the unit of samples, and the reason in words.

    `unit` is a key of `imucal.units.SAMPLE_UNITS`, or ``count`` with `scale` as SI per count; None where it
    is open. It is `assumed` where it is taken for want of anything better.
    """

    unit: str | None = None
    reason: str
    scale: float | None = None
    assumed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unscaled:
    """A sensor's samples with their clock, in the unit of the log.

    Attributes
    ----------
    axes
        What each of the `rows` is, of shape (n,) and no two the same memory.
    order
        Samples to keep, in order, shape (clock.n,); None for all.
    stated
        The unit that the log states; None where nothing in it does.
    """

    sensor: Sensor
    rows: Sequence[FloatArray] | FloatArray
    clock: Clock
    order: IntArray | None = None
    axes: Sequence[Axis] = AXES
    stated: UnitGuess | None = None


def find_units(
    where: str, options: ReadOptions, samples: Sequence[Unscaled], findings: list[Finding]
) -> dict[Sensor, UnitGuess]:
    """Return the unit of each sensor's samples, and add what is to be said of it to the findings.

    Raises ChoiceError, with `where` in front, if a unit is open, or what is given is none of the sensor's.
    """
    units: dict[Sensor, UnitGuess] = {}
    lacking: list[ChoiceError] = []
    # The accelerometer first, as it tells of the other.
    for entry in sorted(samples, key=lambda entry: entry.sensor is Sensor.GYROSCOPE):
        accel = units.get(Sensor.ACCELEROMETER)
        try:
            units[entry.sensor] = (
                _given(where, options, entry.sensor)
                or entry.stated
                or _inferred(where, entry, accel.unit if accel else None, findings)
            )
        except ChoiceError as error:
            lacking.append(error)
    if lacking:
        raise as_one(where, lacking)
    return units


def _given(where: str, options: ReadOptions, sensor: Sensor) -> UnitGuess | None:
    """Return the unit that the caller gives; a ChoiceError if it is none of the sensor's, or has a scale."""
    unit, scale = options.unit_of(sensor), options.scale_of(sensor)
    if unit is not None and scale is not None:
        msg = (
            f"{where}: both a unit ({unit}) and a scale ({scale:g}) are given for the {sensor}; "
            "expected one of them"
        )
        raise ChoiceError(msg)
    if scale is not None:
        return UnitGuess(unit="count", scale=scale, reason=f"{scale:g} {sensor.unit} per count as given")
    if unit is None:
        return None
    parsed = parse_sample_unit(unit)
    if parsed is None or parsed[0] is not sensor:
        known = ", ".join(SAMPLE_UNITS[sensor])
        msg = f"{where}: {unit!r} is no unit of the {sensor}; expected one of {known}"
        raise ChoiceError(msg)
    return UnitGuess(unit=parsed[1], reason="as given")


def _inferred(where: str, entry: Unscaled, accel_unit: str | None, findings: list[Finding]) -> UnitGuess:
    """Return the unit as the samples themselves show it."""
    sensor, rows = entry.sensor, sample_rows(entry.rows)
    if sensor is Sensor.ACCELEROMETER:
        found = infer_accel_unit(rows)
    else:
        found = infer_gyro_unit(rows, rate_hz=entry.clock.rate_hz, accel_unit=accel_unit)
    if found.unit is None:
        msg = (
            f"{where}: the unit of the {sensor} is open: no header says it, and {found.reason}; "
            f"expected one of {', '.join(SAMPLE_UNITS[sensor])}; "
            f"give its unit, or the scale of its counts in {sensor.unit} per count"
        )
        raise ChoiceError(msg)
    if found.assumed:
        text = f"The unit of the gyroscope is taken to be {found.unit}: {found.reason}."
        advice = (
            "Give its unit if that is wrong: deg/s instead of rad/s changes every result by a factor of 57."
        )
        findings.append(Finding(level="warning", code="unit-assumed", axis="gyro", text=text, advice=advice))
    return replace(found, reason=f"inferred: {found.reason}")


def sample_rows(axes: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return up to 20 000 rows of a sensor, spread over the log, finite ones only; shape (k, axes)."""
    n = min(axis.size for axis in axes)
    size = _SAMPLE // 4
    starts = sorted({max(0, min(n - size, k * n // 4)) for k in range(4)})
    rows = np.concatenate(
        [np.stack([axis[first : first + size] for axis in axes], axis=1) for first in starts]
    )
    return np.asarray(rows[np.isfinite(rows).all(axis=1)], dtype=np.float64)


def median_size(rows: FloatArray) -> float:
    """Return the median magnitude of vectors of shape (k, 3); infinite where a damaged one is."""
    with np.errstate(over="ignore"):
        return float(np.median(np.sqrt((rows**2).sum(axis=1))))


def infer_accel_unit(rows: FloatArray) -> UnitGuess:
    """Return the unit in which samples of shape (k, 3) have the magnitude of gravity."""
    if not rows.size:
        return UnitGuess(reason="there are no finite samples")
    if rows.shape[1] < 3:
        return UnitGuess(reason="without all three axes gravity does not show it")
    size = median_size(rows)
    seen = f"median magnitude {size:.4g}"
    with np.errstate(over="ignore", invalid="ignore"):
        mean = float(np.linalg.norm(rows.mean(axis=0)))
    for unit, gravity in (("m/s^2", G0), ("g", 1.0), ("mg", 1000.0)):
        if abs(size / gravity - 1) <= _GRAVITY_TOLERANCE and (unit != "g" or mean >= _CARRIED):
            return UnitGuess(unit=unit, reason=f"{seen} is gravity in {unit}")
    integers = bool((rows == np.round(rows)).all())
    for counts in _COUNTS_PER_G if integers else ():
        if abs(size / counts - 1) <= _COUNT_TOLERANCE:
            return UnitGuess(
                unit="count", scale=G0 / counts, reason=f"{seen} is gravity at {counts:.0f} counts per g"
            )
    if integers:
        reason = f"integer counts of {seen}, which is 1 g at no usual range"
        if size > 1000:
            near = min(_COUNTS_PER_G, key=lambda counts: abs(np.log(size / counts)))
            reason += f"; a 16 bit sensor of {32768 / near:.0f} g range has {near:.0f} counts per g"
        return UnitGuess(reason=reason)
    moved = f", and the vectors' mean is {mean:.2g} long" if mean < _CARRIED <= size else ""
    return UnitGuess(reason=f"{seen} is gravity in none of m/s^2, g and mg{moved}")


def infer_gyro_unit(rows: FloatArray, *, rate_hz: float | None, accel_unit: str | None) -> UnitGuess:
    """Return the unit of rates of shape (k, axes), beside an accelerometer whose unit is known."""
    if not rows.size:
        return UnitGuess(reason="there are no finite samples")
    if bool((rows == np.round(rows)).all()) and bool(rows.any()):
        return UnitGuess(reason="the rates are integer counts of an unknown scale")
    step = converter_step(rows)
    for unit, factor in (("deg/s", 1.0), ("rad/s", _DEGREE)):
        for known in _STEPS:
            if step is not None and abs(step / (known * factor) - 1) < _STEP_TOLERANCE:
                reason = f"the rates come in steps of {step:.6g}, a converter's {known:.6g} deg/s"
                return UnitGuess(unit=unit, reason=reason)
    return _by_size(rows, rate_hz, accel_unit)


def _by_size(rows: FloatArray, rate_hz: float | None, accel_unit: str | None) -> UnitGuess:
    """Return rad/s where rate and noise are those of a gyroscope in SI, beside an accelerometer in SI."""
    size = median_size(rows)
    likely = "so deg/s is likely" if _rests(rows) else "but the sensor moves, so it may be either"
    if size > _FASTEST_REST:
        return UnitGuess(reason=f"the median rate {size:.3g} is too fast for rad/s at rest, {likely}")
    noise = _white_noise(rows, rate_hz)
    if noise is not None and noise > _NOISIEST:
        return UnitGuess(
            reason=f"a noise of {noise:.2g} rad/s/sqrt(Hz) is more than any gyroscope has, {likely}"
        )
    unsaid = "nothing in the log says it"
    if accel_unit == "m/s^2":
        return UnitGuess(unit="rad/s", assumed=True, reason=f"{unsaid}; SI as the accelerometer beside it")
    beside = f"beside an accelerometer in {accel_unit}, "
    return UnitGuess(reason=beside + likely.removeprefix("so ") if accel_unit else unsaid)


def converter_step(rows: FloatArray) -> float | None:
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


def _rests(rows: FloatArray) -> bool:
    """Return whether rates are those of a sensor at rest: noise around a mean, not motion.

    Of white noise, steps between samples are sqrt(2) times as large as the samples' own spread; what moves
    goes far in small steps. A quarter of that ratio leaves room for coloured noise, and for the parts of a
    long log that are looked at together.
    """
    if rows.shape[0] < 100:
        return False
    # Medians, so that single shocks count for nothing.
    steps = np.median(np.abs(np.diff(rows, axis=0)), axis=0)
    spread = np.median(np.abs(rows - np.median(rows, axis=0)), axis=0)
    return bool((steps >= 0.25 * np.sqrt(2) * spread).all())


def _white_noise(rows: FloatArray, rate_hz: float | None) -> float | None:
    """Return the white noise density that steps between samples show, in units/sqrt(Hz)."""
    if rate_hz is None or rows.shape[0] < 100:
        return None
    differences = np.abs(np.diff(rows, axis=0))
    # 0.6745: the median of a normal deviate's magnitude; sqrt(2): a difference of two.
    sigma = np.median(differences, axis=0) / (0.6745 * np.sqrt(2))
    return float(sigma.min() / np.sqrt(rate_hz))
