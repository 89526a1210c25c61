"""The windows of an axis, and which of them are disturbed: computed once for all checks.

A window is disturbed if it is louder than the quiet ones, or has another mean. All limits come from the
axis's own quiet windows, so that a touch does not hide itself by raising the limit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.clock import Segment
from imucal.evidence import value_step
from imucal.recording import AxisSeries, Sensor
from imucal.units import G0

#: Length of a window, in s: long compared with a knock's ringing.
_LENGTH_S = 0.5
#: Minimum samples of a window: its variance then has 15 degrees of freedom.
_MIN_SAMPLES = 16
#: Number of windows wanted from a short log.
_USUAL_WINDOWS = 64
#: Samples processed at a time; a mapped file is never fully in memory.
_BLOCK = 1 << 17


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows(ReadOnlyArrays):
    """Statistics of each window of an axis; all arrays have shape (k,), in order of time.

    A window has `width` samples and spans `length_s` if none is missing. It begins at sample index `start`,
    at `time_s` after the first sample. `step_variance` is half the mean square of successive differences: the
    variance of white noise. `repeats` counts samples equal to the previous one.
    """

    width: int
    length_s: float
    start: IntArray
    time_s: FloatArray
    mean: FloatArray
    variance: FloatArray
    step_variance: FloatArray
    repeats: IntArray
    low: FloatArray
    high: FloatArray

    @property
    def size(self) -> int:
        return self.start.size

    @property
    def end_s(self) -> FloatArray:
        return self.time_s + self.length_s

    def take(self, keep: NDArray[np.bool_]) -> "Windows":
        names = ("start", "time_s", "mean", "variance", "step_variance", "repeats", "low", "high")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


def cut(series: AxisSeries, *, length_s: float = _LENGTH_S, least: int = _MIN_SAMPLES) -> Windows:
    """Return the windows of an axis without NaN; none if it never has `least` samples in a row.

    A window never spans a gap longer than a quarter of its length. The last window of a stretch ends with it,
    so it may overlap the previous one.
    """
    width = max(least, min(round(series.rate_hz * length_s), series.n // _USUAL_WINDOWS))
    starts, places = _starts(series.clock.segments, width)
    size = max(1, _BLOCK // width)
    batches = (starts[first : first + size] for first in range(0, starts.size, size))
    columns = [_statistics(series.samples, batch, width) for batch in batches]
    mean, variance, step_variance, repeats, low, high = np.concatenate([np.empty((6, 0)), *columns], axis=1)
    return Windows(
        width=width,
        length_s=width * series.tau0,
        start=starts,
        time_s=places * series.tau0,
        mean=mean,
        variance=variance,
        step_variance=step_variance,
        repeats=repeats.astype(np.int64),
        low=low,
        high=high,
    )


def _starts(segments: tuple[Segment, ...], width: int) -> tuple[IntArray, FloatArray]:
    """Return the starts of windows, clear of long gaps: index, and grid place from the first sample."""
    if not segments:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    table = np.array([(s.start, s.stop, s.offset) for s in segments], dtype=np.int64)
    missing = table[1:, 2] - (table[:-1, 2] + table[:-1, 1] - table[:-1, 0])
    breaks = np.flatnonzero(missing > width // 4) + 1
    firsts = table[np.r_[0, breaks], 0]
    stops = table[np.r_[breaks - 1, len(table) - 1], 1]
    starts = [np.zeros(0, dtype=np.int64)]
    for first, stop in zip(firsts.tolist(), stops.tolist(), strict=True):
        if stop - first >= width:
            even = np.arange(first, stop - width + 1, width)
            rest = (stop - first) % width
            starts.append(np.append(even, stop - width) if rest else even)
    index, shifts = np.concatenate(starts), table[:, 2] - table[:, 0]
    shift = shifts[np.searchsorted(table[:, 0], index, side="right") - 1]
    return index, (index + shift - shifts[0]).astype(np.float64)


def _statistics(samples: FloatArray, starts: IntArray, width: int) -> FloatArray:
    """Return mean, variance, step variance, repeats, low and high of some windows, shape (6, k)."""
    even = starts.size * width
    block = samples[starts[0] : starts[-1] + width]
    if block.size == even and np.all(np.diff(starts) == width):
        table = np.asarray(block).reshape(starts.size, width)
    else:
        table = np.lib.stride_tricks.sliding_window_view(block, width)[starts - starts[0]]
    # Subtract the first sample to keep precision with a large offset.
    mean = table[:, 0] + (table - table[:, :1]).mean(axis=1)
    rest = table - mean[:, None]
    steps = np.diff(table, axis=1)
    return np.stack(
        [
            mean,
            np.einsum("ij,ij->i", rest, rest) / (width - 1),
            np.einsum("ij,ij->i", steps, steps) / (2 * (width - 1)),
            (steps == 0).sum(axis=1),
            table.min(axis=1),
            table.max(axis=1),
        ]
    )


#: False alarm rate of an axis at rest.
_FALSE_ALARM = 1e-4
#: Factor on a limit, because real noise varies with temperature.
_MARGIN = 1.25
#: A spike exceeds this many robust deviations and is at most two samples long.
_SPIKE = 5 * 1.4826
#: Fraction of a window above which outliers are no spikes.
_MAX_SPIKES = 0.15
#: Minimum number of windows for the limits.
_MIN_WINDOWS = 8
#: Median of chi2(1).
_MEDIAN_CHI2 = 0.4549364


def usual_variance(windows: Windows) -> float:
    """Return the median variance of the windows that are not constant, in U²; 0 if all are."""
    varying = windows.variance[windows.variance > 0]
    return float(np.median(varying)) if varying.size else 0.0


def quietest(variance: FloatArray, count: int) -> float:
    """Return the median variance of the `count` quietest windows in a row, in U²; 0 if all are constant.

    This is the reference for a log that is mostly in motion.
    """
    logs = np.log(variance[variance > 0])
    if logs.size > count:
        first = int(np.argmin(np.convolve(logs, np.ones(count), "valid")))
        logs = logs[first : first + count]
    return float(np.exp(np.median(logs))) if logs.size else 0.0


def disturbed(windows: Windows, lsb: float | None, quiet: Windows | None = None) -> NDArray[np.bool_]:
    """Return which windows are disturbed, shape (k,).

    The variance, or the jump of the mean, exceeds the limit of chance and the resolution `lsb`. The limits
    are estimated from the `quiet` windows, by default all.
    """
    if windows.size < _MIN_WINDOWS:
        return np.zeros(windows.size, dtype=bool)
    quiet = quiet or windows
    p_above = _FALSE_ALARM / windows.size
    least = lsb or 0.0
    varying = quiet.variance[quiet.variance > 0]
    limit = variance_limit(varying, p_above) if varying.size else 0.0
    loud = windows.variance > max(_MARGIN * limit, least**2)
    jumps, usual = _jumps(windows), _jumps(quiet)
    scale = np.sqrt(np.median(usual[usual > 0] ** 2) / _MEDIAN_CHI2) if np.any(usual > 0) else 0.0
    off = jumps > max(np.sqrt(_MARGIN) * -scipy.special.ndtri(p_above) * scale, least)
    loud[1:] |= off
    loud[:-1] |= off
    return loud


def variance_limit(variances: FloatArray, p_above: float) -> float:
    """Return the variance that a quiet window exceeds with a probability of at most about `p_above`.

    Its tail falls as exp(-x/c); c is estimated between the median and the 80 % quantile. Windows in motion
    raise c, so the limit is at most that of two degrees of freedom with the same median.
    """
    middle, upper = (float(q) for q in np.quantile(variances, [0.5, 0.8]))
    reach = math.log(0.5 / p_above)
    fitted = middle + (upper - middle) / math.log(0.5 / 0.2) * reach
    return min(fitted, middle * (1 + reach / math.log(2)))


def _jumps(windows: Windows) -> FloatArray:
    """Return the change of the mean from each window to the next; 0 over a gap."""
    jumps = np.abs(np.diff(windows.mean))
    jumps[np.diff(windows.time_s) > 1.5 * windows.length_s] = 0.0
    return jumps


def without_spikes(series: AxisSeries, windows: Windows, suspects: NDArray[np.bool_]) -> Windows:
    """Return the windows, with outliers of one or two samples removed from the suspects' statistics."""
    mean, variance = windows.mean.copy(), windows.variance.copy()
    offsets = np.arange(windows.width)
    for index in np.array_split(
        np.flatnonzero(suspects), max(1, suspects.sum() * windows.width // (1 << 18))
    ):
        table = series.samples[windows.start[index, None] + offsets]
        keep = ~_spikes(table)
        rare = (~keep).sum(axis=1) <= max(2, _MAX_SPIKES * windows.width)
        count = keep.sum(axis=1)
        middle = np.where(keep, table, 0).sum(axis=1) / count
        rest = np.where(keep, table - middle[:, None], 0)
        mean[index] = np.where(rare, middle, mean[index])
        variance[index] = np.where(rare, (rest**2).sum(axis=1) / (count - 1), variance[index])
    return replace(windows, mean=mean, variance=variance)


def _spikes(table: FloatArray) -> NDArray[np.bool_]:
    """Return which samples of each row are outliers, alone or in pairs."""
    rest = np.abs(table - np.median(table, axis=1, keepdims=True))
    deviation = np.median(rest, axis=1, keepdims=True)
    # Most samples of a coarse axis may be equal.
    deviation = np.where(deviation > 0, deviation, rest.mean(axis=1, keepdims=True))
    out = np.pad(rest > _SPIKE * deviation, ((0, 0), (2, 2)))
    left, here, right = out[:, 1:-3], out[:, 2:-2], out[:, 3:-1]
    far_left, far_right = out[:, :-4], out[:, 4:]
    longer = (left & right) | (left & far_left) | (right & far_right)
    return here & ~longer


#: Number of stretches that are searched for the LSB.
_STRETCHES = 16
#: Length of such a stretch, in samples.
_STRETCH = 2048


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """What the checks need to know of one axis besides its samples.

    Attributes
    ----------
    left_out
        Number of NaN, infinite and impossible samples.
    windows
        Mean and variance of suspect windows exclude spikes.
    disturbed
        Which windows are not at rest, shape (k,).
    lsb
        Step of the values in U.
    noise
        Standard deviation of the white noise per sample, in U.
    """

    left_out: int
    windows: Windows
    disturbed: NDArray[np.bool_]
    lsb: float | None
    noise: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile(Measured):
    """One axis for the checks, without the samples that are left out."""

    series: AxisSeries

    @classmethod
    def of(cls, series: AxisSeries, found: Measured) -> "Profile":
        """Return the profile of an axis that was measured, perhaps in another process."""
        return cls(series=series.finite(), **vars(found))

    @property
    def name(self) -> str:
        return self.series.name

    @property
    def constant(self) -> bool:
        return not self.windows.size or bool(self.windows.low.min() == self.windows.high.max())


def profile(series: AxisSeries, resting: Callable[[Windows], Windows] | None = None) -> Profile:
    """Return the profile of an axis.

    For a log that is mostly in motion, `resting` selects the windows at rest.
    """
    return Profile.of(series, measured(series, resting))


def measured(series: AxisSeries, resting: Callable[[Windows], Windows] | None = None) -> Measured:
    """Return what `profile` adds to an axis."""
    n, series = series.n, series.finite()
    windows = cut(series)
    lsb = resolution(series)
    marks = disturbed(windows, lsb, resting and resting(windows))
    if marks.any():
        windows = without_spikes(series, windows, marks)
        marks = disturbed(windows, lsb, resting and resting(windows))
    quiet = windows.step_variance[~marks & (windows.variance > 0)]
    return Measured(
        left_out=n - series.n,
        windows=windows,
        disturbed=marks,
        lsb=lsb,
        noise=float(np.sqrt(np.median(quiet))) if quiet.size else 0.0,
    )


def excerpt(n: int) -> list[slice]:
    """Return at most 16 stretches of 2048 indices, spread evenly over `n` samples."""
    if n <= _STRETCHES * _STRETCH:
        return [slice(0, n)]
    firsts = np.linspace(0, n - _STRETCH, _STRETCHES).astype(np.int64)
    return [slice(first, first + _STRETCH) for first in firsts.tolist()]


def resolution(series: AxisSeries) -> float | None:
    """Return the step between neighbouring values, in U; None if values are constant or not on a lattice."""
    return value_step(np.concatenate([series.samples[part] for part in excerpt(series.n)]))


def span(start_s: float, end_s: float) -> str:
    """Return ``12.3 to 15.2 s``: always in seconds, because users cut the log in seconds."""
    return f"{start_s:.1f} to {end_s:.1f} s"


def amount(value: float, sensor: Sensor) -> str:
    """Return ``0.0012 rad/s (0.0688 deg/s)`` or ``0.012 m/s^2 (1.22 mg)``."""
    if sensor is Sensor.GYROSCOPE:
        return f"{_figure(value)} rad/s ({_figure(math.degrees(value))} deg/s)"
    return f"{_figure(value)} m/s^2 ({_figure(value / G0 * 1e3)} mg)"


def _figure(value: float) -> str:
    """Return three digits, without an exponent if four or five digits are enough."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e5 else f"{value:.3g}"


def name_list(names: list[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    *first, last = names or [""]
    return f"{', '.join(first)} and {last}" if first else last
