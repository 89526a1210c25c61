"""Do the figures look like SI units: gravity, the gyroscope's noise, well-known steps."""

import math
from collections.abc import Sequence

import numpy as np

from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.screening.profile import Profile
from imucal.units import G0

#: Gravity as an uncalibrated accelerometer may show it, in m/s²: 20 % off at most.
_GRAVITY = (0.8 * G0, 1.2 * G0)
#: Below this, in m/s², there is no gravity in the figures, whatever their unit.
_NO_GRAVITY = 0.3
#: N above this, in rad/s/sqrt(Hz), is no gyroscope: poor ones have 1e-3.
_NOISY = 4e-3
#: Mean rate above this, in rad/s, is no bias: 20 deg/s is the worst that data sheets allow.
_BIASED = 0.4
#: LSB that gyroscopes have, in deg/s: 131, 65.5, 32.8, 16.4 counts and 4.375 … 70 mdeg/s.
_GYRO_LSB = (1 / 131, 1 / 65.5, 1 / 32.8, 1 / 16.4, 250 / 32768, 1000 / 32768, 2000 / 32768,
             0.004375, 0.00875, 0.0175, 0.035, 0.07)  # fmt: skip
#: How closely an LSB must agree with one of these.
_AGREE = 2e-3


def gravity(profiles: Sequence[Profile]) -> float | None:
    """Return the usual length of a sensor's mean vector, in U; None without all three axes."""
    if len(profiles) != 3 or len({p.windows.size for p in profiles}) != 1 or not profiles[0].windows.size:
        return None
    return float(np.median(np.sqrt(sum(p.windows.mean**2 for p in profiles))))


def check_swapped(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error when gravity is in the gyroscope and not in the accelerometer."""
    if not swapped(profiles):
        return ()
    gyro = gravity([p for p in profiles if p.series.sensor is Sensor.GYROSCOPE])
    accel = gravity([p for p in profiles if p.series.sensor is Sensor.ACCELEROMETER])
    return (
        Finding(
            level="error",
            code="swapped-sensors",
            text=(
                f"At rest the gyroscope shows {gyro:.3g}, as gravity would, and the accelerometer "
                f"{accel:.2g}: the two are swapped."
            ),
            advice="Name the columns or topics of each sensor when reading.",
        ),
    )


def check_accelerometer_unit(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return a finding when the length of gravity is not that of m/s²."""
    accel = [p for p in profiles if p.series.sensor is Sensor.ACCELEROMETER]
    length = gravity(accel)
    if length is None or swapped(profiles):
        return ()
    return _accelerometer(accel, length)


def check_gyroscope_unit(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return a finding when a gyroscope at rest does not look like rad/s: its steps, noise or mean."""
    gyro = [p for p in profiles if p.series.sensor is Sensor.GYROSCOPE]
    return () if swapped(profiles) else _gyroscope(gyro, gravity(gyro))


def swapped(profiles: Sequence[Profile]) -> bool:
    """Whether gravity is in the gyroscope and not in the accelerometer."""
    gyro = gravity([p for p in profiles if p.series.sensor is Sensor.GYROSCOPE])
    accel = gravity([p for p in profiles if p.series.sensor is Sensor.ACCELEROMETER])
    if gyro is None or accel is None:
        return False
    in_si = _GRAVITY[0] < gyro < _GRAVITY[1] and accel < 1
    in_g = abs(gyro - 1) < 0.1 and accel < 0.1
    return in_si or in_g


def _accelerometer(accel: Sequence[Profile], length: float) -> tuple[Finding, ...]:
    if _GRAVITY[0] <= length <= _GRAVITY[1]:
        return ()
    if length < _NO_GRAVITY:
        text = f"The accelerometer shows no gravity: |a| is {length:.2g} m/s^2."
        advice = "If a driver takes gravity off, log the raw acceleration: the filter's noise is in this one."
        return (Finding(level="warning", code="no-gravity", text=text, advice=advice, axis="accel"),)
    guess = _accelerometer_guess(accel, length)
    return (
        Finding(
            level="warning",
            code="unit-suspect",
            text=f"|a| is {length:.4g} at rest, where m/s^2 would give {G0:.1f}: {guess}.",
            advice="Name the accelerometer's unit when reading; every figure of it scales with the unit.",
            axis="accel",
        ),
    )


def _accelerometer_guess(accel: Sequence[Profile], length: float) -> str:
    for unit, expected in (("g", 1.0), ("mg", 1e3), ("ug", 1e6)):
        if abs(length / expected - 1) < 0.15 and not (unit == "mg" and _counts(accel)):
            return f"the unit looks like {unit}"
    # g taken for m/s² twice, or m/s² taken for g
    if abs(length / G0**2 - 1) < 0.15:
        return "m/s^2 seem to have been taken for g"
    return "these look like raw counts" if _counts(accel) or length > 1e3 else "no known unit fits"


def _gyroscope(gyro: Sequence[Profile], rate: float | None) -> tuple[Finding, ...]:
    reason = _counts_reason(gyro) or _lsb_reason(gyro) or _noise_reason(gyro) or _rate_reason(rate)
    if reason is None:
        return ()
    return (
        Finding(
            level="warning",
            code="unit-suspect",
            text=f"The gyroscope may not be in rad/s: {reason}.",
            advice="Name the gyroscope's unit when reading; every figure of it scales with the unit.",
            axis="gyro",
        ),
    )


def _counts(profiles: Sequence[Profile]) -> bool:
    """Whether all axes step by exactly 1."""
    return bool(profiles) and all(p.lsb == 1 and float(p.series.samples[0]).is_integer() for p in profiles)


def _counts_reason(gyro: Sequence[Profile]) -> str | None:
    return "all its values are whole numbers, as raw counts are" if _counts(gyro) else None


def _lsb_reason(gyro: Sequence[Profile]) -> str | None:
    known = [(lsb, p.lsb) for p in gyro if p.lsb for lsb in _GYRO_LSB if abs(p.lsb / lsb - 1) < _AGREE]
    if not known or len(known) < len(gyro):
        return None
    return f"its steps of {known[0][1]:.5g} are a usual LSB in deg/s"


def _noise_reason(gyro: Sequence[Profile]) -> str | None:
    density = [p.noise * math.sqrt(p.series.tau0) for p in gyro]
    if not density or min(density) < _NOISY:
        return None
    return (
        f"its noise, {max(density):.2g} rad/s/sqrt(Hz), is more than gyroscopes have; "
        f"in deg/s it would be {math.radians(max(density)):.2g} rad/s/sqrt(Hz)"
    )


def _rate_reason(rate: float | None) -> str | None:
    if rate is None or rate < _BIASED:
        return None
    return f"it shows {rate:.3g} at rest, {math.degrees(rate):.0f} deg/s if in rad/s"
