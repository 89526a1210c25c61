"""Findings of a calibration: its limits, and the next step."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.poses import moved_rests
from imucal.calibration.result import Calibration, rms
from imucal.calibration.slow_noise import AccelerometerEstimate
from imucal.findings import Finding, Level

__all__ = ["Facts", "findings_of", "worse_than_before"]

#: P-value of chi² below which the base does not explain the residuals.
_UNEXPLAINED = 0.01
#: Length of a short rest, in s.
_SHORT_S = 2.0
#: Change of temperature of a warm-up, in K.
_WARMING_K = 2.0
#: Share of a random walk in the slow noise that suggests a warm-up.
_WALK_SHARE = 0.5
#: Share of the deviation of G above which an unknown earth rate is reported.
_EARTH_SHARE = 1 / 3
#: Factor from which a noise report belongs to another sensor or unit.
_OTHER_NOISE = 3.0
#: Ratio of the residuals to the noise from which `beyond-noise` is a warning without a noise report too.
#: Flicker noise reaches a ratio of 2 in simulated logs, and 3.9 in a log of an Xsens MTi whose result agrees
#: with
#: its certificate. Scale drift and nonlinearity of 0.2 % have 6 to 7.
_FAR_BEYOND = 5.0
#: Common scale error of a gyroscope that suggests a wrong sampling rate: datasheets give 1 to 3 %.
_RATE_ERROR = 0.03
#: Largest spread of the three scales relative to their common error.
_RATE_SPREAD = 0.5
#: Largest mean rate at rest of firmware that subtracts it, in deviations of its white noise.
_ZEROED = 4.0
#: Factor by which an error of gravity after the calibration must exceed the one before to be more than
#: rounding.
_WORSE = 1.02
#: The same for turns.
_WORSE_TURNS = 1.1
#: P-value of the turns from which their errors say nothing: unknown misalignments of the accelerometer, which
#: turn the directions of gravity by a degree, explain both.
_EXPLAINED = 0.05
_RECORD_AGAIN = "Do not use this calibration. Record again: each face and six edges, 5 s each."
#: Most times listed.
_LISTED = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Facts:
    """Facts from which the findings follow, with the calibration.

    `z` are the differences of the halves of all rests in deviations, shape (m, 3) or (m, 6). `trouble` is why
    the turns are not explained, with a fix, or None. `rate_hz` is of the gyroscope, `stamped` whether the log
    has time stamps. `final_rate`, shape (3,), is the median size of the mean rate in the last quarter of a
    rest, and `gyro_noise` its deviation by white noise; 0 on an axis whose samples at rest do not change.
    """

    found: Calibration
    in_hand: bool
    z: FloatArray
    estimate: AccelerometerEstimate
    trouble: Finding | None
    rate_hz: float
    stamped: bool
    final_rate: FloatArray
    gyro_noise: FloatArray

    @property
    def starts_s(self) -> FloatArray:
        return np.array([rest.start_s for rest in self.found.rests])

    @property
    def used(self) -> BoolArray:
        return np.array([rest.used for rest in self.found.rests])


def findings_of(facts: Facts) -> tuple[Finding, ...]:
    """Return the findings, errors first."""
    every = (_rests, _noise, _warming, _place, _observability, _turns)
    found = [*worse_than_before(facts.found), *(finding for check in every for finding in check(facts))]
    order = ("error", "warning", "info")
    return tuple(sorted(found, key=lambda finding: order.index(finding.level)))


def worse_than_before(found: Calibration) -> Iterator[Finding]:
    """Yield an error if gravity at the rests, or the turns, fit worse than without a calibration."""
    used = [rest for rest in found.rests if rest.used]
    before, after = rms(rest.before for rest in used), rms(rest.residual for rest in used)
    noise = rms(rest.sigma or 0.0 for rest in used)
    if found.accelerometer.si and after > max(_WORSE * before, noise):
        text = (
            "The calibration makes the accelerometer worse: |f| at rest differs from gravity by "
            f"{1e3 * before:.3g} mm/s² rms before and {1e3 * after:.3g} after."
        )
        yield Finding("error", "worse-than-before", text, _RECORD_AGAIN, axis="accel")
    gyroscope = found.gyroscope
    if gyroscope is not None and gyroscope.si and not gyroscope.p >= _EXPLAINED:
        yield from _worse_turns(found)


def _worse_turns(found: Calibration) -> Iterator[Finding]:
    turns = [turn for turn in found.turns if turn.used]
    before = rms(math.hypot(*(turn.before_deg or ())) for turn in turns)
    after = rms(math.hypot(*(turn.residual_deg or ())) for turn in turns)
    if after > _WORSE_TURNS * before:
        text = (
            f"The calibration makes the gyroscope worse: the turns are wrong by {before:.2g}° rms before "
            f"and {after:.2g}° after."
        )
        yield Finding("error", "worse-than-before", text, _RECORD_AGAIN, axis="gyro")


def _rests(facts: Facts) -> Iterator[Finding]:
    moved = np.flatnonzero(~facts.used)
    if moved.size:
        size = np.abs(facts.z[moved]).max()
        text = (
            f"{_count(moved.size, 'rest')} moved and {'is' if moved.size == 1 else 'are'} not used, at "
            f"{_times(facts.starts_s[moved])}: their halves differ by up to {size:.1f} standard deviations."
        )
        if more := int(moved_rests(facts.z).sum()) - moved.size:
            text += f" {_count(more, 'more rest')} also moved but {'is' if more == 1 else 'are'} used."
        yield Finding("warning", "rest-moved", text, "Put the IMU on a firm surface and let go of it.")
    elif kept := int(moved_rests(facts.z).sum()):
        moved = np.flatnonzero(moved_rests(facts.z))
        text = (
            f"{_count(kept, 'rest')} moved, at {_times(facts.starts_s[moved])}. No other rest has the same "
            "attitude, so it is used, and its movement widens the intervals."
        )
        yield Finding("warning", "rest-moved", text, "Put the IMU on a firm surface and let go of it.")
    if facts.in_hand:
        text = "Rates up to 0.03 rad/s count as rest, so the intervals include hand tremor."
        yield Finding("info", "in-hand", text, "Put the IMU down for shorter intervals.")
    lengths = np.array([rest.end_s - rest.start_s for rest in facts.found.rests])
    short = lengths < _SHORT_S
    if short.any():
        cost = 100 * (math.sqrt(5.0 / float(np.median(lengths[short]))) - 1)
        text = (
            f"{_count(int(short.sum()), 'rest')} of {len(lengths)} last less than {_SHORT_S:g} s; the white "
            f"noise of their means is {cost:.0f} % larger than for 5 s."
        )
        yield Finding("info", "short", text, "Leave the IMU alone for 5 s in each attitude.")


def _noise(facts: Facts) -> Iterator[Finding]:
    for sensor, base in facts.found.noise.items():
        if base.factors:
            text = (
                f"The noise report of {sensor} is in SI units and the log in others. Its noise was "
                f"multiplied by {np.mean(base.factors):.4g}, the scale of this log."
            )
            yield Finding("info", "noise-scaled", text, axis=sensor)
        if not 1 / _OTHER_NOISE < base.ratio < _OTHER_NOISE:
            text = f"The noise models of {sensor} have {base.ratio:.3g} times the noise of the rests."
            advice = "Check that the noise report is for the same sensor, range and unit."
            yield Finding("warning", "noise-differs", text, advice, axis=sensor)
    found = facts.estimate
    level: Level
    if math.isnan(found.p):
        m, p = found.fit.jacobian.shape[0], int(found.fit.free.sum())
        text = f"{m} rests for {p} parameters leave no residuals to check the result."
        # Without a report the intervals are wide enough for any slow noise.
        level = "info"
        if any(base.checked for base in facts.found.noise.values()):
            level = "warning"
            text += " If the noise report does not fit this log, the intervals are too narrow."
        yield Finding(level, "unchecked", text, "Add three rests or more.", axis="accel")
    elif found.p < _UNEXPLAINED:
        residual = found.fit.residual
        rms, times = 1e3 * math.sqrt(float(np.mean(residual**2))), math.sqrt(found.chi2 / found.dof)
        worst = facts.starts_s[facts.used][np.argsort(-np.abs(residual))[:3]]
        text = (
            f"The rests differ from gravity by {rms:.2g} mm/s² rms, {times:.2g} times the noise: "
            f"nonlinearity, stress, tremor or temperature. The worst begin at {_times(worst)}."
        )
        # Expected without a noise report, and the intervals include it.
        checked = any(base.checked for base in facts.found.noise.values())
        advice = "Repeat the rests that differ most."
        level = "warning" if checked or times > _FAR_BEYOND else "info"
        yield Finding(level, "beyond-noise", text, advice, axis="accel")


def _warming(facts: Facts) -> Iterator[Finding]:
    advice = "Calibrate 15 min after switching on, or repeat the first attitude at the end."
    low, high = facts.found.temperature[1:] if facts.found.temperature else (0.0, 0.0)
    if high - low > _WARMING_K:
        text = f"The temperature changed from {low:.1f} to {high:.1f} °C, and bias and scale with it."
        yield Finding("warning", "warming", text, advice)
    elif facts.estimate.p < _UNEXPLAINED and facts.estimate.excess.walk_share > _WALK_SHARE:
        text = "The residuals of the rests change with time, as during a warm-up."
        yield Finding("warning", "warming", text, advice, axis="accel")


def _place(facts: Facts) -> Iterator[Finding]:
    place, gyro = facts.found.gravity, facts.found.gyroscope
    if place.origin == "unknown":
        text = (
            f"Gravity is assumed ({place.value} m/s²); all scales of the accelerometer share an error of up "
            f"to ±{196 * place.sigma / place.value:.1f} %."
        )
        advice = "Give the latitude: it reduces the error to ±0.01 %."
        yield Finding("warning", "gravity-unknown", text, advice, axis="accel")
    if gyro is not None and gyro.rest.earth_share > _EARTH_SHARE:
        share = f"{100 * gyro.rest.earth_share:.0f} %"
        text = f"The unknown earth rate causes {share} of the uncertainty of the g-sensitivity."
        yield Finding("info", "earth-rate", text, "Give the latitude.", axis="gyro")


#: Status of a parameter -> the finding about it.
_STATUSES = {
    "not-observable": Finding("warning", "not-observable", "not observable"),
    "weak": Finding("warning", "weak", "weakly determined"),
}


def _observability(facts: Facts) -> Iterator[Finding]:
    accelerometer, gyroscope = facts.found.accelerometer, facts.found.gyroscope
    add = accelerometer.suggestion
    for status, finding in _STATUSES.items():
        names = [name for name, parameter in accelerometer.parameters.items() if parameter.status == status]
        if names:
            share = f"{100 * (1 - add.ratio):.0f} %"
            text = f"The accelerometer's {_names(names)} {_are(names)} {finding.text}."
            advice = f"Add a rest with {add.text}: it reduces the largest uncertainty by {share}."
            yield replace(finding, text=text, advice=advice, axis="accel")
        every = gyroscope.parameters if gyroscope is not None and not facts.trouble else {}
        own = [name for name, parameter in every.items() if parameter.status == status]
        turned = [name for name in own if name.startswith(("scale", "misalignment"))]
        if turned:
            turns = [
                f"about {axis} (start with {_others(axis)} down)" for axis in sorted({n[-1] for n in turned})
            ]
            text = f"The gyroscope's {_names(turned)} {_are(turned)} {finding.text}."
            yield replace(finding, text=text, advice=f"Add turns {', '.join(turns)}.", axis="gyro")
        if len(own) > len(turned):
            text = f"The gyroscope's g-sensitivity is {finding.text}."
            yield replace(finding, text=text, advice="Add rests in six attitudes or more.", axis="gyro")


def _others(axis: str) -> str:
    return " or ".join(other for other in "xyz" if other != axis)


def _are(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


#: Why a turn is not used -> the finding about such turns.
_TURNS = {
    "wrong": Finding(
        "warning", "turn-wrong", "differ from the others", "Turn more slowly; look for lost samples."
    ),
    "gap": Finding("warning", "turn-gap", "have missing samples", "Record without losses."),
    "clipped": Finding("warning", "clipped", "exceed the range of the gyroscope", "Turn more slowly."),
    "long": Finding("info", "turn-long", "last more than 60 s", "Turn within some seconds."),
}


def _turns(facts: Facts) -> Iterator[Finding]:
    if facts.trouble:
        advice = f"{facts.trouble.advice} Otherwise, calibrate without the gyroscope."
        yield replace(facts.trouble, level="error", advice=advice)
    yield from _rate(facts)
    yield from _zeroed(facts)
    for why, finding in _TURNS.items():
        own = [turn for turn in facts.found.turns if turn.why == why]
        if own:
            sizes = [math.hypot(*turn.residual_deg) for turn in own if turn.residual_deg]
            by = f", by up to {max(sizes):.2g}°" if sizes else ""
            starts = _times(turn.start_s for turn in own)
            text = f"Turns at {starts} are not used: they {finding.text}{by}."
            advice = finding.advice
            if why == "wrong" and any(turn.known_deg is not None for turn in own):
                advice += " Check that the IMU was turned by the whole known angle."
            yield replace(finding, text=text, advice=advice, axis="gyro")


def _rate(facts: Facts) -> Iterator[Finding]:
    """Yield a warning if the three scales of a gyroscope without stamps are wrong by the same factor."""
    gyro = facts.found.gyroscope
    if gyro is None or not gyro.si or not gyro.scaled or facts.stamped:
        return
    scales = np.diag(gyro.M)
    common = float(scales.mean())
    if abs(common - 1) > _RATE_ERROR and np.ptp(scales) < _RATE_SPREAD * abs(common - 1):
        rate_hz = facts.rate_hz * common
        text = (
            f"All three scales of the gyroscope are wrong by {100 * (common - 1):+.1f} %. The log has no "
            f"time stamps, and a rate of {rate_hz:.4g} Hz instead of {facts.rate_hz:.4g} explains it."
        )
        yield Finding("warning", "rate-suspect", text, f"Check the rate: --rate {rate_hz:.4g}.", axis="gyro")


def _zeroed(facts: Facts) -> Iterator[Finding]:
    """Yield a warning if the rates at rest are 0: firmware subtracts their mean, or they are cut off."""
    if facts.found.gyroscope is None:
        return
    if not facts.gyro_noise.all():
        text = "The rates at rest are exactly 0 on some axis: the gyroscope has a dead band."
        advice = "Switch the dead band off, or use the raw output; it hides the bias and slow turns."
        yield Finding("warning", "dead-band", text, advice, axis="gyro")
    elif np.all(facts.final_rate < _ZEROED * facts.gyro_noise):
        text = (
            "The mean rate at rest is 0 on all axes: firmware subtracts it while the IMU is at rest. The "
            "bias is that of the remaining rates."
        )
        advice = "Switch the automatic zeroing off, or use the raw output."
        yield Finding("warning", "zeroed", text, advice, axis="gyro")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _times(times_s: Iterable[float]) -> str:
    listed = [f"{time:.1f} s" for time in times_s]
    more = len(listed) - _LISTED
    return ", ".join(listed[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _names(names: Iterable[str]) -> str:
    return ", ".join(name.replace("_", " ") for name in names)
