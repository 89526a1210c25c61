"""Findings about a temperature ramp: what it can't show, and what disturbs it."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from imucal.findings import Finding
from imucal.recording import AXES, Recording, Sensor, Temperature
from imucal.temperature.ramp import AxisBlocks, Ramp
from imucal.temperature.result import AxisThermal
from imucal.units import duration, pretty

#: A smaller span leaves most of the working range of an IMU unknown, in K.
_NARROW_K = 20.0
#: Fewer steps of the temperature per span are coarse.
_STEPS = 50
#: A bias that is behind by more than this has its own temperature, in K.
_BEHIND_K = 5.0
#: A larger turn of gravity between two blocks is no effect of temperature, in rad.
_TURN = math.radians(1.0)
#: A turn within a change of the temperature of this share of the span is not caused by it.
_STILL_SHARE = 0.05
#: Hysteresis that is left is named above this share of the change of the bias.
_SHARE = 0.25
#: A smaller hysteresis than this multiple of the noise of a sample is none.
_NOISE = 4.0
#: Topics whose samples a flight stack has corrected already.
_CORRECTED = frozenset({"sensor_combined", "vehicle_imu"})


def ramp_findings(
    recording: Recording, ramp: Ramp, blocks: Sequence[AxisBlocks], axes: Sequence[AxisThermal]
) -> Iterator[Finding]:
    """Yield the findings about a ramp, the most important first."""
    yield from _attitude(ramp, blocks)
    yield from _branches(ramp)
    yield from _too_fast(ramp, axes)
    yield from _hysteresis(axes)
    yield from _narrow(ramp)
    if recording.temperature is not None:
        yield from _coarse(recording.temperature)
    yield from _no_effect(recording, axes)


def _attitude(ramp: Ramp, blocks: Sequence[AxisBlocks]) -> Iterator[Finding]:
    """Yield an error if gravity turns faster than the temperature could turn it."""
    triad = [one for one in blocks if one.series.sensor is Sensor.ACCELEROMETER]
    if len(triad) != len(AXES):
        return
    places = set(triad[0].places.tolist()).intersection(*(one.places.tolist() for one in triad))
    both = np.array(sorted(places))
    force = np.column_stack([one.means[np.isin(one.places, both)] for one in triad])
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    # The turn itself may be in the block between.
    turn = np.linalg.norm(direction[2:] - direction[:-2], axis=1)
    heat = ramp.temperature[both]
    still = np.abs(heat[2:] - heat[:-2]) < _STILL_SHARE * ramp.span_k
    found = np.flatnonzero((turn > _TURN) & still)
    if not found.size:
        return
    worst = int(found[np.argmax(turn[found])])
    degrees = math.degrees(float(turn[worst]))
    text = (
        f"The IMU turned by {degrees:.2g}° at {duration(float(ramp.edges_s[both[worst] + 1]))}, so the bias "
        "of the accelerometer and gravity can't be told apart."
    )
    advice = "Fix the IMU in the chamber, and record again."
    yield Finding("error", "thermal-attitude", text, advice, axis="accel")


def _branches(ramp: Ramp) -> Iterator[Finding]:
    if ramp.heats.size > 1:
        return
    only = "rises" if ramp.heats[0] else "falls"
    text = f"The temperature only {only}: hysteresis, lag and the remaining error are unknown."
    yield Finding("warning", "thermal-one-branch", text, "Record heating and cooling in one log.")


def _too_fast(ramp: Ramp, axes: Sequence[AxisThermal]) -> Iterator[Finding]:
    """Yield a warning if the part with the bias is far behind the thermometer."""
    slowest = max(axes, key=lambda one: one.curve.lag_s)
    fastest = float(np.abs(ramp.speed_k_per_s).max())
    behind = slowest.curve.lag_s * fastest
    if behind < _BEHIND_K:
        return
    text = (
        f"The ramp is fast: the temperature changes by up to {60 * fastest:.2g} K/min, and {slowest.name} "
        f"follows {slowest.curve.lag_s:.0f} s later, up to {behind:.2g} K behind."
    )
    slow = 60 * _BEHIND_K / slowest.curve.lag_s
    advice = f"Heat and cool by less than {slow:.2g} K/min."
    yield Finding("warning", "thermal-fast", text, advice, axis=slowest.name)


def _hysteresis(axes: Sequence[AxisThermal]) -> Iterator[Finding]:
    for one in axes:
        left = one.hysteresis_left
        if left is None or left < _SHARE * one.curve.change or left < _NOISE * one.noise:
            continue
        text = (
            f"Heating and cooling differ by up to {left:.2g} {pretty(one.sensor.unit)} at the same "
            f"temperature, {100 * left / max(one.curve.change, left):.0f} % of the effect of temperature: "
            "no curve describes both."
        )
        advice = "Heat and cool more slowly; if it stays, the part has hysteresis."
        yield Finding("warning", "thermal-hysteresis", text, advice, axis=one.name)


def _narrow(ramp: Ramp) -> Iterator[Finding]:
    if ramp.span_k >= _NARROW_K:
        return
    text = f"The temperature spans only {ramp.span_k:.2g} K."
    yield Finding("warning", "thermal-narrow", text, "Record the whole range in which the IMU works.")


def _coarse(temperature: Temperature) -> Iterator[Finding]:
    known = temperature.samples[np.isfinite(temperature.samples)]
    levels = np.unique(known)
    step = float(np.median(np.diff(levels)))
    if step * _STEPS < float(np.ptp(levels)):
        return
    text = f"The temperature has steps of {step:.2g} K, which are coarse for its span."
    yield Finding("warning", "thermal-steps", text, "Log the temperature with more digits.")


def _no_effect(recording: Recording, axes: Sequence[AxisThermal]) -> Iterator[Finding]:
    corrected = [name for name in recording.source.topics if name.split("/")[-1] in _CORRECTED]
    flat = [one.name for one in axes if one.curve.order == 0 and not one.curve.gradient]
    if corrected:
        text = f"Topic {corrected[0]} contains samples that the flight stack has corrected."
        advice = "Log the raw samples (sensor_accel, sensor_gyro), with the compensation switched off."
        yield Finding("warning", "thermal-corrected", text, advice)
    elif flat:
        text = f"No effect of temperature beyond noise on {', '.join(flat)}."
        advice = "If you expect one: is a compensation already on?"
        yield Finding("info", "thermal-no-effect", text, advice)
