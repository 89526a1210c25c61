"""Disturbances in words, and where in the samples a step lies exactly."""

from collections.abc import Sequence

import numpy as np

from imucal.findings import Finding
from imucal.fitting.spectral.disturbances import Disturbance, ExactPlace
from imucal.recording import AxisSeries
from imucal.units import pretty

#: The search tells a step's place to this share of the record.
_COARSE = 1 / 1000


def exact_places(series: AxisSeries) -> ExactPlace:
    """Return what puts a step at the sample where it splits its surroundings best.

    Of two levels in white noise, the place of least squares maximises the weighted square of their
    difference. The surroundings end at other steps.
    """

    def exact(about: float, taken: Sequence[float], apart: float) -> int:
        grid = series.clock.grid()
        reach = max(int(_COARSE * grid[-1]), 8)
        low = max([about - 2 * reach, *(place for place in taken if place <= about)])
        high = min([about + 2 * reach, *(place for place in taken if place > about)])
        first, stop = np.searchsorted(grid, [low, high])
        samples, places = series.samples[first:stop], grid[first + 1 : stop]
        allowed = np.abs(places - about) <= reach
        for place in taken:
            allowed &= np.abs(places - place) >= apart
        if samples.size < 4 or not allowed.any():
            return round(about)
        left = np.cumsum(samples - samples.mean())[:-1]
        count = np.arange(1.0, samples.size)
        contrast = np.where(allowed, left**2 / (count * (samples.size - count)), -1.0)
        return int(places[int(np.argmax(contrast))])

    return exact


def disturbance_findings(
    found: Sequence[Disturbance], series: AxisSeries, scale: float
) -> tuple[Finding, ...]:
    """Return a finding for each kind that was taken out; `scale` is U per scaled unit."""
    words = {
        "temperature": _temperature_finding,
        "warm-up": _warm_up_finding,
        "step": _step_finding,
        "cycle": _cycle_finding,
    }
    return tuple(
        say([one for one in found if one.kind == kind], series, scale)
        for kind, say in words.items()
        if any(one.kind == kind for one in found)
    )


def _temperature_finding(found: list[Disturbance], series: AxisSeries, scale: float) -> Finding:
    (one,) = found
    lag = f", with a lag of {one.value * series.tau0:.3g} s" if one.value else ""
    return Finding(
        level="info",
        code="temperature",
        axis=series.name,
        text=f"The axis follows the temperature ({_amount(one, series, scale)} per degree C{lag}); a linear "
        "effect is taken out with the fit.",
        advice="Use the noise model together with a temperature compensation.",
    )


def _warm_up_finding(found: list[Disturbance], series: AxisSeries, _: float) -> Finding:
    (one,) = found
    return Finding(
        level="warning",
        code="warm-up-fitted",
        axis=series.name,
        text=f"The axis settles exponentially, with a time constant of {one.value * series.tau0:.3g} s; this "
        "drift is taken out with the fit.",
        advice="Leave out the first part of the record, or let the sensor warm up before recording.",
    )


def _step_finding(found: list[Disturbance], series: AxisSeries, scale: float) -> Finding:
    """Name the jumps in order of time; the longest part without one is worth keeping."""
    found = sorted(found, key=lambda one: one.value)
    times = [one.value * series.tau0 for one in found]
    jumps = [
        f"{one.size[0] * scale:+.3g} {pretty(series.unit)} at {t:.1f} s"
        for one, t in zip(found, times, strict=True)
    ]
    ends = np.array([0.0, *times, series.duration_s])
    longest = int(np.argmax(np.diff(ends)))
    return Finding(
        level="warning",
        code="step",
        axis=series.name,
        text=f"The level jumps by {', '.join(jumps)}"
        f"{'; the jumps are' if len(found) > 1 else ' and stays there; the jump is'} taken out with the fit.",
        advice="Fix the IMU so that nothing tilts it, or look for a bias that switches.",
        keep_s=(round(float(ends[longest]), 1), round(float(ends[longest + 1]), 1)),
    )


def _cycle_finding(found: list[Disturbance], series: AxisSeries, scale: float) -> Finding:
    found = sorted(found, key=lambda one: -one.amplitude)
    cycles = [
        f"{2 * np.pi / one.value * series.tau0:.4g} s (amplitude {_amount(one, series, scale)})"
        for one in found
    ]
    return Finding(
        level="warning",
        code="cycle",
        axis=series.name,
        text=f"The axis swings with a period of {', '.join(cycles)}; taken out with the fit.",
        advice="Look for a heating or cooling that switches, and record at a steady temperature.",
    )


def _amount(one: Disturbance, series: AxisSeries, scale: float) -> str:
    return f"{one.amplitude * scale:.3g} {pretty(series.unit)}"
