"""Checks of values: missing, stuck, clipped, coarse, repeated, copied, or implausible in SI units."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray
from imucal.errors import Fix
from imucal.evidence import (
    FASTEST_AT_REST,
    GRAVITY_TOLERANCE,
    MAX_GYRO_NOISE,
    gravity_unit,
    gyroscope_step_unit,
    is_gravity_per_sample,
    share_together,
)
from imucal.findings import Finding, Level
from imucal.recording import Sensor, Temperature
from imucal.screening.windows import Profile, amount, excerpt
from imucal.units import G0, duration

#: Probability that noise repeats one value through a window by chance.
_FALSE_ALARM = 1e-6
#: Least number of samples at the extreme value of a clipped axis.
_MIN_AT_LIMIT = 8
#: The same in multiples of the number of samples at the next value.
_LIMIT_RATIO = 5.0
#: Distance of an extreme from the middle, in steps, up to which it is due to a coarse resolution.
_MIN_STEPS = 4.0
#: Fraction of samples that are not finite from which they are a warning.
_MANY = 1e-3
#: Noise, in LSB, below which LSB^2/12 cannot correct N.
_COARSE = 0.5
#: White noise of two axes never has this correlation; a duplicated column does.
_COPY = 0.999
#: Minimum number of samples for a comparison.
_MIN_SAMPLES = 64


def check_no_data(profile: Profile) -> tuple[Finding, ...]:
    """Return an error for an axis without samples, or with a single value."""
    series = profile.series
    first = float(series.samples[0]) if series.n else math.nan
    if series.n and not (profile.windows.size and profile.constant):
        return ()
    code = "no-data"
    if not series.n:
        text = "No sample is finite."
        advice = "Check the driver or the choice of columns."
    elif first == 0:
        text = f"All {series.n} samples are 0: the driver does not fill this axis."
        advice = "Read this sensor from another topic or column."
    else:
        code = "stuck"
        text = f"The axis never changes: all {series.n} samples are {first:.6g} {series.unit}."
        advice = "Check the sensor and its driver; this axis can't be used."
    return (Finding("error", code, text, advice, axis=series.name),)


def check_not_finite(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding for samples that are not finite or are impossible for a sensor."""
    series, count = profile.series, profile.left_out
    if not count or not series.n:
        return ()
    share = count / (count + series.n)
    samples, are = ("sample", "is") if count == 1 else ("samples", "are")
    level: Level = "warning" if share > _MANY else "info"
    text = f"{count} {samples} ({share:.2g} of all) {are} NaN, infinite or absurdly large and left out."
    return (Finding(level, "not-finite", text, "Check the driver.", axis=series.name),)


def check_stuck(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding for windows with one value only, if chance cannot explain them."""
    windows, series = profile.windows, profile.series
    frozen = windows.low == windows.high
    if not frozen.any() or frozen.all():
        return ()
    usual = float(np.quantile(windows.repeats[~frozen], 0.9) + 1) / windows.width
    by_chance = windows.size * min(usual, 1.0) ** (windows.width - 1)
    if by_chance > _FALSE_ALARM:
        return ()
    total, first = frozen.sum() * windows.length_s, windows.time_s[int(frozen.argmax())]
    text = f"The axis is stuck at one value for {duration(total)} in all, first at {first:.1f} s."
    advice = "Check the driver and the cable; leave these parts out."
    edges = np.flatnonzero(np.concatenate([[True], frozen, [True]]))
    longest = int(np.diff(edges).argmax())
    begin, end = int(edges[longest]), int(edges[longest + 1]) - 2
    keep = round(float(windows.time_s[begin]), 1), round(float(windows.end_s[max(end, begin)]), 1)
    return (Finding("warning", "stuck", text, advice, axis=series.name, keep_s=keep),)


def check_saturated(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding for an axis at its highest or lowest value too often to be noise."""
    windows, series = profile.windows, profile.series
    middle = float(np.median(windows.mean))
    step = profile.lsb or 0.0
    for limit, extremes, word in (
        (float(windows.high.max()), windows.high, "highest"),
        (float(windows.low.min()), windows.low, "lowest"),
    ):
        if abs(limit - middle) <= _MIN_STEPS * step:
            continue
        index = np.flatnonzero(extremes == limit)
        if index.size < 2 and windows.repeats[index].sum() < _MIN_AT_LIMIT:
            continue
        at_limit, next_to_it = _counts(profile, index, limit)
        if at_limit >= _MIN_AT_LIMIT and at_limit > _LIMIT_RATIO * next_to_it:
            text = (
                f"The axis is at its {word} value, {amount(limit, series.sensor)}, {at_limit} times: it is "
                f"saturated, first at {windows.time_s[index[0]]:.1f} s."
            )
            advice = "Choose a larger range of the sensor, or leave these parts out."
            return (Finding("warning", "saturated", text, advice, axis=series.name),)
    return ()


def _counts(profile: Profile, index: NDArray[np.intp], limit: float) -> tuple[int, int]:
    """Return how many samples of some windows are at the limit, and at the next value towards the middle."""
    windows = profile.windows
    at_limit = 0
    nearest: dict[float, int] = {}
    for start in windows.start[index[:1000]].tolist():
        values, counts = np.unique(profile.series.samples[start : start + windows.width], return_counts=True)
        at_limit += int(counts[values == limit].sum())
        others = values != limit
        if others.any():
            k = int(np.abs(values[others] - limit).argmin())
            value = float(values[others][k])
            nearest[value] = nearest.get(value, 0) + int(counts[others][k])
    return at_limit, max(nearest.values(), default=0)


def check_filled(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return findings for each sensor whose samples are held or interpolated on all axes at once."""
    findings = []
    for sensor in Sensor:
        group = [p for p in profiles if p.series.sensor is sensor and not p.constant]
        if len(group) < 2 or len({p.series.n for p in group}) > 1 or group[0].series.n < _MIN_SAMPLES:
            continue
        rate, held, between = group[0].series.rate_hz, _held(group), _interpolated(group)
        if held:
            text = (
                f"{held:.1%} of the {sensor} samples repeat the previous one on all axes: the log has "
                f"{rate:.4g} samples per second, about {rate * (1 - held):.3g} of them new."
            )
            advice = "Log at the sensor's own rate; repeated samples distort the curve at short times."
            findings.append(Finding("warning", "held-samples", text, advice, axis=sensor.short))
        if between:
            text = (
                f"{between:.1%} of the {sensor} samples are exactly midway between their neighbours on all "
                "axes: the driver or a converter has interpolated lost samples."
            )
            advice = (
                "Log the sensor's own samples and leave lost ones out: imucal allows for gaps. An N from "
                f"short times is up to {0.75 * between:.1%} too large."
            )
            findings.append(Finding("warning", "interpolated-samples", text, advice, axis=sensor.short))
    return tuple(findings)


def _held(group: list[Profile]) -> float:
    return _together(group, lambda _, samples: held_samples(samples))


def held_samples(samples: FloatArray) -> BoolArray:
    """Return which samples after the first repeat the previous one, shape (n - 1,)."""
    return np.asarray(np.diff(samples) == 0)


def _interpolated(group: list[Profile]) -> float:
    return _together(group, midway_samples)


def midway_samples(p: Profile, samples: FloatArray) -> BoolArray:
    """Return which samples are midway between their neighbours, without the ends, shape (n - 2,)."""
    # A text log rounds each sample by up to half a step.
    rounding = max(2.01 * (p.lsb or 0.0), 8 * float(np.spacing(np.abs(samples).max())))
    steps = np.diff(samples)
    return np.asarray((np.abs(np.diff(steps)) <= rounding) & (steps[1:] != 0))


def _together(group: list[Profile], marked: Callable[[Profile, FloatArray], BoolArray]) -> float:
    """Return the share of samples marked on all axes; 0 if chance explains it."""
    stretches = [[marked(p, p.series.samples[part]) for p in group] for part in excerpt(group[0].series.n)]
    return share_together([np.concatenate(marks) for marks in zip(*stretches, strict=True)])


def check_lsb(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding if the noise minus rounding's LSB²/12 (Sheppard's correction) is below half an LSB."""
    lsb, series = profile.lsb, profile.series
    if lsb is None or not profile.noise**2 < lsb**2 * (_COARSE**2 + 1 / 12):
        return ()
    noise = max(0.0, profile.noise**2 - lsb**2 / 12) ** 0.5
    figure = f"about {noise / lsb:.1f}" if noise > 0.2 * lsb else "less than 0.2"
    text = (
        f"The steps of the axis, {amount(lsb, series.sensor)}, are coarse: its noise is "
        f"{figure} LSB, and rounding distorts N and hides slow changes."
    )
    advice = "Choose a smaller range of the sensor, log more digits, or average less before logging."
    return (Finding("warning", "coarse-lsb", text, advice, axis=series.name),)


def check_duplicates(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each pair of axes with the same samples, up to sign, scale and offset."""
    findings = []
    advice = "Check the choice of columns, or the driver that fills them."
    for one, two, correlation in copied_pairs(profiles):
        sign = "the same samples" if correlation > 0 else "the same samples with opposite sign"
        text = f"{one.name} and {two.name} contain {sign} (correlation {correlation:.3f})."
        findings.append(Finding("error", "duplicate-axes", text, advice))
    return tuple(findings)


def copied_pairs(profiles: Sequence[Profile]) -> Iterator[tuple[Profile, Profile, float]]:
    """Yield pairs of axes with the same samples, and the correlation of their differences."""
    for one, two in combinations(profiles, 2):
        if one.constant or two.constant or one.series.n != two.series.n or one.series.n < _MIN_SAMPLES:
            continue
        correlation = _correlation(one, two)
        if abs(correlation) > _COPY:
            yield one, two, correlation


def _correlation(one: Profile, two: Profile) -> float:
    """Return the correlation of the differences between successive samples."""
    products = np.zeros(3)
    for part in excerpt(one.series.n):
        x, y = np.diff(one.series.samples[part]), np.diff(two.series.samples[part])
        products += (x @ y, x @ x, y @ y)
    xy, xx, yy = products.tolist()
    return xy / (xx**0.5 * yy**0.5) if xx > 0 and yy > 0 else 0.0


#: Length, in m/s², below which there is no gravity in any unit.
_NO_GRAVITY = 0.3
#: Largest mean vector without gravity, in m/s².
_WEIGHTLESS = 0.3 * G0
#: Smallest deviation of a moving accelerometer, in m/s².
_SHAKEN = 0.3


def gravity(profiles: Sequence[Profile]) -> float | None:
    """Return the typical length of a sensor's mean vector, in U; None without all three axes."""
    if len(profiles) != 3 or len({p.windows.size for p in profiles}) != 1 or not profiles[0].windows.size:
        return None
    return float(np.median(np.sqrt(sum(p.windows.mean**2 for p in profiles))))


def shaken(profiles: Sequence[Profile]) -> tuple[str, float] | None:
    """Return the axis with the largest deviation, in m/s², if an accelerometer moves and has no gravity."""
    accel = _of(Sensor.ACCELEROMETER, profiles)
    if len(accel) < 3 or float(np.linalg.norm([p.windows.mean.mean() for p in accel])) > _WEIGHTLESS:
        return None
    deviations = {p.name: float(np.sqrt(p.windows.variance.mean() + p.windows.mean.var())) for p in accel}
    worst = max(deviations, key=lambda name: deviations[name])
    return (worst, deviations[worst]) if sorted(deviations.values())[1] > _SHAKEN else None


def check_swapped(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error if gravity is in the gyroscope and not in the accelerometer."""
    gyro, accel = (gravity(_of(sensor, profiles)) for sensor in Sensor)
    if not swapped(profiles):
        return ()
    text = (
        f"The gyroscope shows {gyro:.3g} at rest, like gravity, and the accelerometer {accel:.2g}: the two "
        "are swapped, or the gyroscope's columns are the direction of gravity."
    )
    advice = "Give the columns or topics of each sensor when reading."
    return (Finding("error", "swapped-sensors", text, advice),)


def swapped(profiles: Sequence[Profile]) -> bool:
    """Whether gravity is in the gyroscope and not in the accelerometer."""
    gyro, accel = (gravity(_of(sensor, profiles)) for sensor in Sensor)
    if gyro is None or accel is None:
        return False
    in_si = gravity_unit(gyro) == "m/s^2" and accel < 1
    in_g = abs(gyro - 1) < 0.1 and accel < 0.1
    return in_si or in_g


def _of(sensor: Sensor, profiles: Sequence[Profile]) -> list[Profile]:
    return [p for p in profiles if p.series.sensor is sensor]


def check_accelerometer_unit(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return a finding if the length of gravity does not match m/s², unless the IMU is shaken."""
    return () if swapped(profiles) or shaken(profiles) else check_gravity_length(profiles)


def check_gravity_length(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return a finding if the length of gravity does not match m/s²."""
    accel = _of(Sensor.ACCELEROMETER, profiles)
    length = gravity(accel)
    if length is None or gravity_unit(length) == "m/s^2":
        return ()
    if is_gravity_per_sample(length, accel[0].series.rate_hz):
        rate = accel[0].series.rate_hz
        text = (
            f"|a| is {length:.4g} at rest, and {length * rate:.4g} times the rate, which is gravity: the "
            "samples are "
            "increments of velocity, in m/s per sample, and those of the gyroscope may be increments of "
            "angle."
        )
        advice = (
            "Run again with --accel-unit m/s, and with --gyro-unit rad or deg; all numbers scale with the "
            "unit."
        )
        fix = Fix("", "accel_unit", "m/s")
        return (Finding("warning", "unit-suspect", text, advice, axis="accel", fix=fix),)
    if length < _NO_GRAVITY:
        text = f"The accelerometer shows no gravity: |a| is {length:.2g} m/s^2."
        advice = "If a driver removes gravity, log the raw acceleration: this has the noise of a filter."
        return (Finding("warning", "no-gravity", text, advice, axis="accel"),)
    guess, unit = _accelerometer_guess(accel, length)
    return (unit_suspect(Sensor.ACCELEROMETER, f"{wrong_gravity(length, guess)}.", unit),)


def wrong_gravity(length: float, guess: str) -> str:
    """Return the sentence, without its full stop, about a length of gravity that does not match m/s²."""
    return f"|a| is {length:.4g} at rest, expected {G0:.1f} in m/s^2: {guess}"


def looks_like(unit: str) -> str:
    """Return the explanation of a length that is gravity in a unit."""
    return f"the unit looks like {unit}"


def unit_suspect(sensor: Sensor, text: str, unit: str) -> Finding:
    """Return the finding for data that seem to be in `unit`: a unit, ``count``, or empty."""
    scales = "all its numbers scale with the unit."
    advice, fix = f"Give the {sensor}'s unit when reading; {scales}", None
    if unit == "count":
        advice = f"Run again with --{sensor.short}-scale X, in {sensor.unit} per count; {scales}"
        fix = Fix("", f"{sensor.short}_scale", "X")
    elif unit:
        advice = f"Run again with --{sensor.short}-unit {unit}; {scales}"
        fix = Fix("", f"{sensor.short}_unit", unit)
    return Finding("warning", "unit-suspect", text, advice, axis=sensor.short, fix=fix)


def _accelerometer_guess(accel: Sequence[Profile], length: float) -> tuple[str, str]:
    """Return an explanation of the length of gravity, and the unit to read the log with, if known."""
    unit = gravity_unit(length)
    if unit is not None and not (unit == "mg" and _are_counts(accel)):
        return looks_like(unit), unit
    # g converted to m/s² twice, or m/s² read as g
    if abs(length / G0**2 - 1) <= GRAVITY_TOLERANCE:
        return "values in m/s^2 seem to have been read as g", "m/s^2"
    if _are_counts(accel) or length > 1e3:
        return "these look like raw counts", "count"
    return "no known unit fits", ""


def _are_counts(profiles: Sequence[Profile]) -> bool:
    return bool(profiles) and all(p.lsb == 1 and float(p.series.samples[0]).is_integer() for p in profiles)


def check_gyroscope_unit(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return a finding if a gyroscope at rest is not in rad/s, from its steps, noise or mean."""
    gyro = _of(Sensor.GYROSCOPE, profiles)
    reason = None if swapped(profiles) else _gyroscope_reason(gyro)
    if reason is None:
        return ()
    text = f"The gyroscope may not be in rad/s: {reason}."
    return (unit_suspect(Sensor.GYROSCOPE, text, "count" if _are_counts(gyro) else "deg/s"),)


def _gyroscope_reason(gyro: Sequence[Profile]) -> str | None:
    """Return the strongest evidence that a gyroscope is in another unit, or None."""
    if _are_counts(gyro):
        return "all its values are whole numbers, like raw counts"
    found = gyroscope_step_unit([p.lsb for p in gyro])
    if found is not None and found[0] == "deg/s":
        return f"its steps of {gyro[0].lsb:.5g} are a usual LSB in deg/s"
    density = [p.noise * math.sqrt(p.series.tau0) for p in gyro]
    if density and min(density) >= MAX_GYRO_NOISE:
        return (
            f"its noise, {max(density):.2g} rad/s/sqrt(Hz), is more than gyroscopes have; in deg/s it would "
            f"be {math.radians(max(density)):.2g} rad/s/sqrt(Hz)"
        )
    rate = gravity(gyro)
    if rate is not None and rate >= FASTEST_AT_REST:
        return f"it shows {rate:.3g} at rest, {math.degrees(rate):.0f} deg/s if in rad/s"
    return None


#: Lowest rate, in Hz, of averaged logs.
_SLOWEST = 0.5
#: Highest rate, in Hz, of bench instruments.
_FASTEST = 150e3
#: Highest rate of MEMS sensors, in Hz, with a margin for their clocks.
_FASTEST_MEMS = 40e3


def check_rate(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each rate that suggests time stamps in another unit, or a wrong given rate.

    A rate that only bench instruments reach is a warning.
    """
    found = []
    advice = "Check the unit of the time stamps (s, ms, us, ns), or give the sampling rate in Hz."
    for rate in dict.fromkeys(p.series.rate_hz for p in profiles):
        samples = f"The samples come at {rate:.4g} Hz"
        if _FASTEST_MEMS < rate <= _FASTEST:
            text = f"{samples}: no MEMS sensor is that fast."
            found.append(Finding("warning", "fast-rate", text, advice))
        elif not _SLOWEST <= rate <= _FASTEST:
            text = f"{samples}: no IMU is that {'slow' if rate < 1 else 'fast'}."
            found.append(Finding("error", "absurd-rate", text, advice))
    return tuple(found)


#: Change of temperature that is reported, in degrees.
_LARGE_CHANGE = 3.0


def temperature_finding(temperature: Temperature | None) -> tuple[Finding, ...]:
    """Return a note on a large change of temperature."""
    degrees = temperature.samples[np.isfinite(temperature.samples)] if temperature else np.zeros(0)
    # Means suppress the thermometer's own noise.
    change = float(np.ptp(np.convolve(degrees, np.full(9, 1 / 9), "valid"))) if degrees.size > 32 else 0.0
    if change <= _LARGE_CHANGE:
        return ()
    text = f"The temperature changes by {change:.1f} degrees C during the log."
    return (Finding("info", "temperature", text),)
