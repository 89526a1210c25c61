"""Find what is not noise in an axis: lines, steps, cycles, drifts, a filter.

A fit by maximum likelihood removes it; `not_noise` reports it if nothing, or only a curve, is fitted.
"""

from collections.abc import Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding, Level
from imucal.fitting.noise_fit import Line
from imucal.fitting.spectral.band import Band, corner_of, find_band
from imucal.fitting.spectral.blocks import SeriesBlocks, bin_blocks, make_blocks
from imucal.fitting.spectral.disturbances import (
    Disturbance,
    disturbance_findings,
    doubtful_finding,
    exact_places,
    find_disturbances,
)
from imucal.fitting.spectral.hump import hump_finding
from imucal.fitting.spectral.lines import likely_cause, local_level
from imucal.fitting.spectral.models import richest
from imucal.processes import try_side_work
from imucal.recording import AxisSeries
from imucal.screening import amount

#: Lines named in a finding.
_NAMED = 4
#: Chance that a record without tones is said to hold one.
_CHANCE = 1e-4
#: A line that lifts the Allan variance at its own hump by less than this part is not worth a warning.
_VISIBLE = 0.1


def not_noise(series: AxisSeries, temperature: FloatArray | None = None) -> tuple[Finding, ...]:
    """Return what is not noise in an axis at rest; nothing of one that is too short for a noise model.

    Samples are finite, gaps are allowed; `temperature`, shape (n,), is in degrees Celsius at the samples, or
    None. Takes about a quarter of the time of `fit_mle`, whose first steps these are.
    """
    try:
        blocks = make_blocks(series, temperature)
    except DataError:
        return ()
    found, _ = find_disturbances(blocks.blocks, exact=exact_places(series))
    common = tuple(name for one in found for name in one.names)
    whole = bin_blocks(blocks.blocks, blocks.scale, ("R", *common))
    band = find_band(whole, richest(None))
    return (
        *tone_finding(blocks, series, fitted=False),
        *disturbance_findings(found, series, blocks.scale, fitted=False),
        *_roll_off_finding(band, series),
    )


def find_shapes(
    series: AxisSeries, blocks: SeriesBlocks
) -> tuple[tuple[Disturbance, ...], tuple[Disturbance, ...], tuple[Finding, ...]]:
    """Return the shapes that the fit removes, the doubtful ones, and the findings about both."""
    nothing: tuple[Disturbance, ...] = ()
    (found, doubtful), failed = try_side_work(
        lambda: find_disturbances(blocks.blocks, exact=exact_places(series)),
        (nothing, nothing),
        what="No search for steps and cycles",
        code="not-checked",
        axis=series.name,
    )
    findings = disturbance_findings(found, series, blocks.scale, fitted=True)
    findings += doubtful_finding(doubtful, series, blocks.scale)
    return found, doubtful, findings + failed


def line_finding(lines: Sequence[Line], series: AxisSeries) -> tuple[Finding, ...]:
    """Return what a fit says of the lines that it left out, strongest first."""
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
    """Return what may make the lines of an axis: a warning where they shape its Allan curve.

    Where they do not and are `fitted` around, `line_finding` says enough.
    """
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
    text = f"{series.name} has {count}{effect}: {'; '.join(named)}."
    advice = "Remove the source and record again; the fit leaves lines out." if visible else ""
    return (Finding(level, "tone", text, advice, axis=series.name),)


def _sure_lines(blocks: SeriesBlocks, series: AxisSeries) -> tuple[list[Line], float]:
    """Return the lines that chance does not make, and how much they bend the Allan curve at most.

    That is what a line adds where it adds most, relative to the noise there. A sine's Allan variance
    A² sin⁴(x)/x², x = pi f tau, peaks at 0.525 A², tau = 0.371 / f, where white noise of the density S of
    the line's surroundings has S / tau.
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
    """Return a note on the output filter or the vibration that shapes the spectrum."""
    nyquist, corner = series.rate_hz / 2, corner_of(band)
    if band.hump:
        return (hump_finding(band.hump, rate_hz=series.rate_hz, axis=series.name, fitted=False),)
    if corner is not None:
        text = (
            f"The density of {series.name} falls to half near {corner * nyquist:.3g} Hz: a low-pass filter "
            f"shapes its output, sampled at {series.rate_hz:.4g} Hz."
        )
    elif not band.flat:
        text = (
            f"An output filter or a vibration shapes the density of {series.name} near "
            f"{band.fraction * nyquist:.3g} Hz and above, sampled at {series.rate_hz:.4g} Hz."
        )
    else:
        return ()
    advice = "Read N from the flat part below the filter, not from the first points of the curve."
    return (Finding("info", "roll-off", text, advice, axis=series.name),)
