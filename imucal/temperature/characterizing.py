"""Recording of a temperature ramp -> the bias of each axis over the temperature."""

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.errors import DataError
from imucal.recording import Recording
from imucal.temperature.findings import ramp_findings
from imucal.temperature.fitting import Lags, cubic_of, curve_on, fit_axis, held_out
from imucal.temperature.ramp import AxisBlocks, Ramp
from imucal.temperature.result import AxisThermal, Branch, Thermal, blocks_shown

__all__ = ["thermal"]

#: Temperatures at which the branches are compared.
_LEVELS = 24
#: Order of the cubic of flight stacks.
_CUBIC = 3


def thermal(recording: Recording) -> Thermal:
    """Return the bias of each axis over the temperature, from a log at rest in which the IMU heats and cools.

    Raises
    ------
    DataError
        If the log has no temperature, a span below 5 K, too few samples, or no axis.
    """
    if not recording.series:
        raise DataError("the log has no axis of an IMU", place=recording.source.path)
    ramp = Ramp.of(recording)
    lags = Lags.of(ramp)
    blocks = [AxisBlocks.of(series, ramp) for series in recording.series]
    axes = tuple(_axis(ramp, lags, one) for one in blocks)
    return Thermal(
        source=recording.source,
        low_c=float(ramp.temperature.min()),
        high_c=float(ramp.temperature.max()),
        fastest_k_per_s=float(np.abs(ramp.speed_k_per_s).max()),
        branches=_branches(ramp),
        axes=axes,
        findings=(*recording.findings, *ramp_findings(recording, ramp, blocks, axes)),
    )


def _axis(ramp: Ramp, lags: Lags, axis: AxisBlocks) -> AxisThermal:
    fit = fit_axis(ramp, lags, axis)
    cubic = cubic_of(ramp, axis, _CUBIC)
    cubic_rest = axis.means - curve_on(cubic, ramp, axis.places)
    both = ramp.heats.size > 1
    return AxisThermal(
        sensor=axis.series.sensor,
        axis=axis.series.axis,
        curve=fit.curve,
        cubic=cubic,
        noise=float(np.sqrt(axis.white_variance)),
        before=_rms(axis.means - axis.means.mean(), axis),
        left=_rms(fit.rest, axis),
        held_out=fit.held_out,
        cubic_held_out=float(held_out(ramp, lags, axis, "present")[_CUBIC]) if both else None,
        hysteresis=_hysteresis(ramp, axis, cubic_rest),
        hysteresis_left=_hysteresis(ramp, axis, fit.rest),
        shown=blocks_shown(ramp, axis, fit.rest),
    )


def _rms(rest: FloatArray, axis: AxisBlocks) -> float:
    """Return the rms of what is left of the blocks, without white noise."""
    least = axis.white_variance / axis.counts.sum()
    return float(np.sqrt(max(float(np.mean(rest**2 - axis.white_variance / axis.counts)), least)))


def _hysteresis(ramp: Ramp, axis: AxisBlocks, rest: FloatArray) -> float | None:
    """Return the largest difference between heating and cooling at one temperature, in U."""
    heats = ramp.heating[axis.places]
    temperature = ramp.temperature[axis.places]
    edges = np.linspace(ramp.temperature.min(), ramp.temperature.max(), _LEVELS + 1)
    level = np.clip(np.searchsorted(edges, temperature, side="right") - 1, 0, _LEVELS - 1)

    def means(chosen: BoolArray) -> FloatArray:
        count = np.bincount(level[chosen], minlength=_LEVELS)
        total = np.bincount(level[chosen], weights=rest[chosen], minlength=_LEVELS)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    apart = np.abs(means(heats) - means(~heats))
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else None


def _branches(ramp: Ramp) -> tuple[Branch, ...]:
    branches = []
    for number in range(ramp.heats.size):
        places = np.flatnonzero(ramp.branch == number)
        after = min(int(places[-1]) + 1, ramp.blocks - 1)
        branches.append(
            Branch(
                start_s=float(ramp.edges_s[places[0]]),
                end_s=float(ramp.edges_s[places[-1] + 1]),
                from_c=float(ramp.temperature[places[0]]),
                to_c=float(ramp.temperature[after]),
            )
        )
    return tuple(branches)
