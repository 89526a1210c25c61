"""Findings about disturbances of an axis: lines, steps, cycles, drifts, a filter.

A fit by maximum likelihood removes them; `not_noise` reports them if only a curve or nothing is fitted.
"""

from collections.abc import Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding, Level
from imucal.fitting.noise_fit import Line
from imucal.fitting.regressors import (
    Bump,
    LevelChange,
    Ramp,
    Regressor,
    Step,
    TemperatureEffect,
    WarmUp,
    Wave,
)
from imucal.fitting.spectral.blocks import SeriesBlocks, make_blocks
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.band_search import find_band
from imucal.fitting.spectral.disturbances.hump import hump_finding
from imucal.fitting.spectral.disturbances.lines import likely_cause, local_level
from imucal.fitting.spectral.disturbances.shapes import (
    Disturbance,
    exact_places,
    find_disturbances,
    regressors_of,
    with_shape,
)
from imucal.fitting.spectral.models import richest
from imucal.recording import AxisSeries
from imucal.screening import amount
from imucal.side_work import try_side_work
from imucal.units import pretty

#: Largest number of lines listed in a finding.
_NAMED = 4
#: False alarm rate of tones per record.
_CHANCE = 1e-4
#: Relative increase of the Allan variance by a line below which there is no warning.
_VISIBLE = 0.1
#: Time constants after which a warm-up has settled to 5 %.
_SETTLED = 3.0
#: Standard deviations within which a smooth change of level takes place.
_WIDE = 4.0
#: Excess of a change of level from which a walk is the unlikely reading: 2 of 117 short walks have more.
_LIKELY = 6.0
#: Share of the record within which jumps in one direction are one shift.
_ONE_SHIFT = 0.02


def not_noise(series: AxisSeries, temperature: FloatArray | None = None) -> tuple[Finding, ...]:
    """Return findings about disturbances of an axis at rest; () if it is too short for a noise model.

    Samples are finite, gaps are allowed; `temperature`, shape (n,), is in degrees Celsius.
    """
    try:
        blocks = make_blocks(series, temperature)
    except DataError:
        return ()
    found, _ = find_disturbances(blocks.blocks, exact=exact_places(series))
    whole = blocks.binned((Ramp(), *regressors_of(found)))
    band = find_band(whole, richest(None))
    return (
        *tone_finding(blocks, series, fitted=False),
        *disturbance_findings(found, series, blocks.scale, fitted=False),
        *_roll_off_finding(band, series),
    )


def find_shapes(
    series: AxisSeries, blocks: SeriesBlocks
) -> tuple[tuple[Disturbance[Regressor], ...], tuple[Disturbance[Regressor], ...], tuple[Finding, ...]]:
    """Return the shapes that the fit removes, the doubtful ones, and the findings about the removed ones."""
    nothing: tuple[Disturbance[Regressor], ...] = ()
    (found, doubtful), failed = try_side_work(
        lambda: find_disturbances(blocks.blocks, exact=exact_places(series)),
        (nothing, nothing),
        what="No search for steps and cycles",
        code="not-checked",
        axis=series.name,
    )
    findings = disturbance_findings(found, series, blocks.scale, fitted=True)
    return found, doubtful, findings + failed


def line_finding(lines: Sequence[Line], series: AxisSeries) -> tuple[Finding, ...]:
    """Return the finding about the lines that a fit leaves out."""
    if not lines:
        return ()
    named = ", ".join(
        f"{line.frequency_hz:.4g} Hz (amplitude {line.amplitude:.3g} {series.unit})"
        for line in lines[:_NAMED]
    )
    more = f" and {len(lines) - _NAMED} weaker ones" if len(lines) > _NAMED else ""
    text = f"{'Line' if len(lines) == 1 else 'Lines'} at {named}{more}; left out of the fit."
    advice = "Look for a motor, a fan or mains near the sensor; the Allan curve still contains the lines."
    return (Finding("info", "line", text, advice, axis=series.name),)


def tone_finding(blocks: SeriesBlocks, series: AxisSeries, *, fitted: bool) -> tuple[Finding, ...]:
    """Return the finding about possible causes of lines: a warning if they bend the Allan curve."""
    lines, hump = _sure_lines(blocks, series)
    visible = hump > _VISIBLE
    if not lines or (fitted and not visible):
        return ()
    named = []
    for line in lines[:_NAMED]:
        cause = likely_cause(
            line.frequency_hz, rate_hz=series.rate_hz, resolution_hz=1.5 * series.rate_hz / series.n
        )
        height = amount(line.amplitude, series.sensor)
        named.append(f"{height} at {line.frequency_hz:.4g} Hz, perhaps {cause}")
    if len(lines) > _NAMED:
        named.append(f"and {len(lines) - _NAMED} weaker")
    many = len(lines) > 1
    count = f"{len(lines)} tones" if many else "a tone"
    effect = f", which {'bend' if many else 'bends'} the Allan curve" if visible else ""
    level: Level = "warning" if visible else "info"
    text = f"The axis has {count}{effect}: {'; '.join(named)}."
    advice = "Remove the source and record again; the fit leaves lines out." if visible else ""
    return (Finding(level, "tone", text, advice, axis=series.name),)


def _sure_lines(blocks: SeriesBlocks, series: AxisSeries) -> tuple[list[Line], float]:
    """Return the significant lines, and their largest relative increase of the Allan variance.

    A sine's Allan variance A² sin⁴(x)/x², x = pi f tau, has its peak 0.525 A² at tau = 0.371 / f. White noise
    of the density S around the line has the Allan variance S / tau.
    """
    block = max(blocks.blocks, key=lambda block: block.bins.n)
    n, bins = block.bins.n, block.bins
    if not blocks.lines:
        return [], 0.0
    level, limit = local_level(block.ordinates, block.kept, bins, chance=_CHANCE)
    sure, hump = [], 0.0
    for line in blocks.lines:
        at = int(np.searchsorted(bins.first, 2 * n * line.frequency_hz / series.rate_hz, side="right")) - 1
        noise = float(level[at]) * blocks.scale**2
        # A sine of amplitude A has a sum of squares n A²/2.
        if n * line.amplitude**2 / 2 > limit[at] * noise:
            sure.append(line)
            density = noise * series.tau0
            hump = max(hump, 0.525 * line.amplitude**2 * 0.371 / (line.frequency_hz * density))
    return sure, hump


def _roll_off_finding(band: Band, series: AxisSeries) -> tuple[Finding, ...]:
    nyquist = series.rate_hz / 2
    if band.hump:
        return (hump_finding(band.hump, rate_hz=series.rate_hz, axis=series.name, fitted=False),)
    if band.corner is not None:
        text = (
            f"The density of the axis falls to half near {band.corner * nyquist:.3g} Hz: a low-pass filter "
            f"shapes its output, sampled at {series.rate_hz:.4g} Hz."
        )
    elif not band.flat:
        text = (
            f"An output filter or a vibration shapes the density of the axis near "
            f"{band.fraction * nyquist:.3g} Hz and above, sampled at {series.rate_hz:.4g} Hz."
        )
    else:
        return ()
    advice = "Read N from the flat part below the filter, not from the first points of the curve."
    return (Finding("info", "roll-off", text, advice, axis=series.name),)


def disturbance_findings(
    found: Sequence[Disturbance[Regressor]], series: AxisSeries, scale: float, *, fitted: bool
) -> tuple[Finding, ...]:
    """Return a finding for each class of shapes; `scale` is U per scaled unit."""
    findings: list[Finding] = []
    if temperatures := with_shape(found, TemperatureEffect):
        findings.append(_temperature_finding(temperatures, series, scale, fitted=fitted))
    if warm_ups := with_shape(found, WarmUp):
        findings.append(_warm_up_finding(warm_ups, series, fitted=fitted))
    if steps := with_shape(found, Step):
        findings.append(_step_finding(steps, series, scale, fitted=fitted))
    if cycles := with_shape(found, Wave):
        findings.append(_cycle_finding(cycles, series, scale, fitted=fitted))
    return tuple(findings)


def _temperature_finding(
    found: list[Disturbance[TemperatureEffect]], series: AxisSeries, scale: float, *, fitted: bool
) -> Finding:
    (one,) = found
    lag_s = one.shape.lag * series.tau0
    lag = f", with a lag of {_rounded(lag_s, 3)} s" if lag_s else ""
    text = f"The axis follows the temperature ({_amount(one, series, scale)} per degree C{lag})"
    if fitted:
        text += "; the fit removes a linear effect"
        advice = "Use the noise model together with a temperature compensation."
    else:
        advice = "Record at a steady temperature, or compensate first; K and B include the thermal drift."
    level: Level = "info" if fitted else "warning"
    return Finding(level, "temperature", f"{text}.", advice, axis=series.name)


def _warm_up_finding(found: list[Disturbance[WarmUp]], series: AxisSeries, *, fitted: bool) -> Finding:
    (one,) = found
    time = one.shape.time_constant * series.tau0
    end = "; the fit removes this drift" if fitted else ": a warm-up"
    settled, length = _SETTLED * time, series.duration_s
    keep_s = (round(settled, 1), round(length, 1)) if settled < length / 2 else None
    text = f"The axis settles exponentially, with a time constant of {_rounded(time, 3)} s{end}."
    advice = "Leave out the first part of the record, or let the sensor warm up before recording."
    code = "warm-up-fitted" if fitted else "warm-up"
    return Finding("warning", code, text, advice, axis=series.name, keep_s=keep_s)


def _step_finding(
    found: list[Disturbance[Step]], series: AxisSeries, scale: float, *, fitted: bool
) -> Finding:
    """Report the jumps in order of time; jumps in one direction shortly after each other are one shift."""
    found = sorted(found, key=lambda one: one.shape.place)
    times = [one.shape.place * series.tau0 for one in found]
    shifts: list[tuple[float, float, float]] = []
    for one, time in zip(found, times, strict=True):
        size = one.size[0] * scale
        first, before, last = shifts[-1] if shifts else (0.0, 0.0, 0.0)
        if before * size > 0 and time - last < _ONE_SHIFT * series.duration_s:
            shifts[-1] = (first, before + size, time)
        else:
            shifts.append((time, size, time))
    jumps = [
        f"{size:+.3g} {pretty(series.unit)} "
        + (f"from {first:.1f} to {last:.1f} s" if last > first else f"at {first:.1f} s")
        for first, size, last in shifts
    ]
    several = len(shifts) > 1
    stays = "" if several else " and stays there"
    taken_out = f"; the fit removes the jump{'s' * several}" if fitted else ""
    ends = np.array([0.0, *times, series.duration_s])
    longest = int(np.argmax(np.diff(ends)))
    keep_s = (round(float(ends[longest]), 1), round(float(ends[longest + 1]), 1))
    text = f"The level jumps by {', '.join(jumps)}{stays}{taken_out}."
    advice = "Fix the IMU so that nothing tilts it, or look for a bias that switches."
    return Finding("warning", "step", text, advice, axis=series.name, keep_s=keep_s)


def _cycle_finding(
    found: list[Disturbance[Wave]], series: AxisSeries, scale: float, *, fitted: bool
) -> Finding:
    taken_out = "; the fit removes it" if fitted else ""
    text = f"The axis swings with a period of {_periods(found, series, scale)}{taken_out}."
    advice = "Look for a heater or cooler that switches, and record at a steady temperature."
    return Finding("warning", "cycle", text, advice, axis=series.name)


def doubtful_findings(
    doubtful: Sequence[Disturbance[Regressor]], series: AxisSeries, scale: float
) -> tuple[Finding, ...]:
    """Return a finding for each shape that is as likely as noise; `scale` is U per scaled unit."""
    findings: list[Finding] = []
    for warm_up in with_shape(doubtful, WarmUp):
        time = warm_up.shape.time_constant * series.tau0
        shape = f"a warm-up with a time constant of about {_rounded(time, 2)} s"
        advice = "Let the sensor warm up, leave out the first part (--skip), or record for longer."
        findings.append(_doubtful("info", "warm-up-doubtful", shape, advice, series))
    for cycle in with_shape(doubtful, Wave):
        shape = f"a cycle with a period of {_periods([cycle], series, scale)}"
        advice = "Record for longer to see whether it continues."
        findings.append(_doubtful("info", "cycle-doubtful", shape, advice, series))
    for temperature in with_shape(doubtful, TemperatureEffect):
        shape = f"an effect of the temperature ({_amount(temperature, series, scale)} per degree C)"
        advice = "Record at a steady temperature, or for longer."
        findings.append(_doubtful("info", "temperature-doubtful", shape, advice, series))
    levels: list[Disturbance[LevelChange] | Disturbance[Bump]] = [
        *with_shape(doubtful, LevelChange),
        *with_shape(doubtful, Bump),
    ]
    for level in levels:
        place = level.shape.place * series.tau0
        within = _WIDE * level.shape.width * series.tau0
        size = _amount(level, series, scale)
        shape = (
            f"{level.shape.description} of {size} around {_rounded(place, 3)} s, within about "
            f"{_rounded(within, 2)} s"
        )
        advice = "Look for heating, air conditioning or a load at that time, and record without it."
        importance: Level = "warning" if level.excess > _LIKELY else "info"
        findings.append(_doubtful(importance, "level-doubtful", shape, advice, series))
    return tuple(findings)


def _rounded(seconds: float, digits: int) -> str:
    """Return a time with some digits and without an exponent."""
    return f"{float(f'{seconds:.{digits}g}'):g}"


def _doubtful(level: Level, code: str, shape: str, advice: str, series: AxisSeries) -> Finding:
    text = (
        f"There may be {shape}, or a random walk that looks like it: the record can't distinguish them. The "
        "limits of N, B and K allow for both."
    )
    return Finding(level, code, text, advice, axis=series.name)


def _periods(found: Sequence[Disturbance[Wave]], series: AxisSeries, scale: float) -> str:
    return ", ".join(
        f"{2 * np.pi / one.shape.frequency * series.tau0:.4g} s (amplitude {_amount(one, series, scale)})"
        for one in sorted(found, key=lambda one: -one.amplitude)
    )


def _amount(one: Disturbance[Regressor], series: AxisSeries, scale: float) -> str:
    return f"{one.amplitude * scale:.3g} {pretty(series.unit)}"
