"""Spectral lines: detection, exclusion and likely causes.

An ordinate whose square exceeds the local level by more than chance belongs to a line (a motor, mains, a
clock). It is left out together with its neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from imucal.allan.dct import DctBins
from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.noise_fit import Line
from imucal.fitting.regressors import cycle_ordinates

#: False alarm rate per record.
_CHANCE = 0.01
#: Number of lowest ordinates that are never left out, because they contain walk and drift.
_LOWEST = 48
#: Bins on each side of a bin that determine its local level.
_NEIGHBOURS = 8
#: Degrees of freedom of a median per ordinate, for single ones.
_MEDIAN_EFFICIENCY = 0.5
#: Median of the square of a standard normal.
_MEDIAN = 0.4549
#: Fewest ordinates on each side that a line must exceed: enough for their median.
_NEAR = 64
#: Their least number as a share of the frequency.
_NEAR_SHARE = 1 / 800
#: Largest number of lines subtracted as sines, to limit the time of a record with many.
_MAX_SINES = 16
#: Ordinates on each side for the fit of a sine.
_ABOUT = 200
#: Largest share of the power near the line that a sine may leave: more is not a steady line.
_REMAINS = 0.1
#: A line's tail is left out down to this share of the level.
_TAIL = 0.05
#: Least number of neighbours left out on each side.
_MIN_SKIP = 3
#: Largest number of neighbours left out, as a share of the frequency: wider tails are subtracted as a sine.
_MAX_SKIP = 0.02


@dataclass(frozen=True, kw_only=True)
class Sine:
    """A steady line: cosine cos(omega (t + 1/2)) + sine sin(omega (t + 1/2)), omega in rad/sample."""

    omega: float
    cosine: float
    sine: float

    @property
    def amplitude(self) -> float:
        return float(np.hypot(self.cosine, self.sine))

    def ordinates(self, n: int, count: int) -> FloatArray:
        theta = np.pi / n * np.arange(1, count + 1, dtype=np.float64)
        phase = float(np.arctan2(-self.sine, self.cosine))
        return self.amplitude * cycle_ordinates(n, theta, self.omega, phase)


def find_lines(
    ordinates: FloatArray, bins: DctBins, *, scale: float, rate_hz: float
) -> tuple[BoolArray | None, tuple[Line, ...]]:
    """Return the mask of the ordinates to keep, shape (n-1,), or None for all; and the lines by strength.

    `ordinates` k = 1 … n-1 are in units of `scale` U.
    """
    size = ordinates.size
    starts = bins.first - 1
    total, peaks = _totals_and_peaks(ordinates, bins)
    count = bins.count.astype(np.float64)
    kept: BoolArray | None = None
    for _ in range(2):
        level, sureness = _level(total, count, bins)
        limit = level * _limit(sureness, _CHANCE / max(size, 1))
        suspects = np.flatnonzero(peaks > limit)
        if not suspects.size:
            break
        square = ordinates * ordinates
        spans = [slice(int(starts[at]), int(starts[at] + bins.count[at])) for at in suspects]
        over = [
            s.start + np.flatnonzero(square[s] > limit[at]) for at, s in zip(suspects, spans, strict=True)
        ]
        found = np.concatenate([starts[:0], *over])
        found = _standing_out(square, found[found >= _LOWEST])
        if not found.size:
            break
        of_bin = np.searchsorted(starts, found, side="right") - 1
        excess = square[found] / level[of_bin]
        reach = np.ceil(np.sqrt(excess / _TAIL) / np.pi)
        reach = np.minimum(np.maximum(reach, _MIN_SKIP), np.maximum(_MIN_SKIP, _MAX_SKIP * found)).astype(
            np.int64
        )
        kept = outside(np.maximum(found - reach, _LOWEST), found + reach + 1, size)
        total, count = (np.add.reduceat(values * kept, starts) for values in (square, np.ones(size)))
    if kept is None:
        return None, ()
    lines = []
    for start, stop in zip(*(ends.tolist() for ends in left_out(kept)), strict=True):
        top = start + int(np.argmax(square[start:stop]))
        at = int(np.searchsorted(starts, top, side="right")) - 1
        power = max(float(square[start:stop].sum()) - (stop - start) * float(level[at]), 0.0)
        # A sine of amplitude A has a sum of squares n A²/2.
        amplitude = scale * float(np.sqrt(2 * power / bins.n))
        lines.append(Line(frequency_hz=(top + 1) * rate_hz / (2 * bins.n), amplitude=amplitude))
    return kept, tuple(sorted(lines, key=lambda line: -line.amplitude))


def _limit(sureness: FloatArray, chance: float) -> FloatArray:
    """Return the ratio of a square to the local level that is exceeded with probability `chance`."""
    # The level is an estimate: F has a far heavier tail than chi-squared for few ordinates.
    return np.asarray(scipy.special.fdtri(1.0, sureness, 1.0 - chance))


def local_level(
    ordinates: FloatArray, kept: BoolArray | None, bins: DctBins, *, chance: float
) -> tuple[FloatArray, FloatArray]:
    """Return the mean square around each bin, and the largest ratio of a square to it, shape (b,) each.

    An ordinate without lines exceeds this ratio with probability `chance` per record.
    """
    weight = np.ones(ordinates.size) if kept is None else kept.astype(np.float64)
    total = np.add.reduceat(np.square(ordinates) * weight, bins.first - 1)
    level, sureness = _level(total, np.add.reduceat(weight, bins.first - 1), bins)
    return level, _limit(sureness, chance / max(ordinates.size, 1))


def _totals_and_peaks(ordinates: FloatArray, bins: DctBins) -> tuple[FloatArray, FloatArray]:
    total, peaks = np.empty((2, bins.size))
    for here, seen, starts in bins.parts():
        square = np.square(ordinates[seen])
        total[here] = np.add.reduceat(square, starts)
        peaks[here] = np.maximum.reduceat(square, starts)
    return total, peaks


def _level(total: FloatArray, count: FloatArray, bins: DctBins) -> tuple[FloatArray, FloatArray]:
    """Return the median of the neighbouring bins' mean squares and its degrees of freedom."""
    mean = np.log(np.maximum(total, 1e-300) / np.maximum(count, 1.0))
    known = np.flatnonzero(count > 0)
    mean = np.interp(np.arange(mean.size), known, mean[known])
    # The median of one squared normal is 0.455 of its mean; of many it is the mean.
    mean -= np.where(bins.count == 1, np.log(_MEDIAN), 0.0)
    padded = np.pad(mean, _NEIGHBOURS, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    level: FloatArray = np.exp(np.median(windows, axis=1))
    ordinates = np.convolve(np.pad(count, _NEIGHBOURS, mode="edge"), np.ones(2 * _NEIGHBOURS + 1), "valid")
    return level, np.maximum(_MEDIAN_EFFICIENCY * ordinates, 1.0)


def _standing_out(square: FloatArray, found: IntArray) -> IntArray:
    """Return the found ordinates that exceed their neighbours: an edge or peak of a filter is no line."""
    apart = np.maximum(_NEAR, _MAX_SKIP / 2 * found[1:])
    groups = np.split(found, np.flatnonzero(np.diff(found) > apart) + 1)
    kept = [near for near in groups if near.size and _is_line(square, near)]
    return np.concatenate(kept) if kept else found[:0]


def _is_line(square: FloatArray, near: IntArray) -> bool:
    """Whether the highest of some ordinates exceeds its neighbours, or the neighbours of all.

    A wandering line is as wide as all found ordinates; a resonance is wider.
    """
    top = int(near[np.argmax(square[near])])
    reach = max(_NEAR, int(_NEAR_SHARE * top))
    if top < 4 * _NEAR or _exceeds(square, top, square[max(top - reach, 0) : top + reach + 1]):
        return True
    first, last = int(near[0]), int(near[-1])
    reach = max(_NEAR, last - first + 1, int(_MAX_SKIP * last))
    sides = square[max(first - reach, 0) : first], square[last + 1 : last + 1 + reach]
    return last - first < 2 * _MAX_SKIP * last and all(
        side.size and _exceeds(square, top, side) for side in sides
    )


def _exceeds(square: FloatArray, top: int, others: FloatArray) -> bool:
    limit = _limit(np.array([_MEDIAN_EFFICIENCY * others.size]), _CHANCE / square.size)
    return bool(square[top] > limit[0] * np.median(others) / _MEDIAN)


def outside(first: IntArray, stop: IntArray, size: int) -> BoolArray:
    """Return the mask of 0 … size-1 outside all spans from `first` to before `stop`."""
    steps = np.zeros(size + 1, dtype=np.int64)
    np.add.at(steps, np.clip(first, 0, size), 1)
    np.add.at(steps, np.clip(stop, 0, size), -1)
    return np.asarray(np.cumsum(steps[:size]) == 0)


def left_out(kept: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first index of each run that is not kept, and the index after its end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], kept, [True]]).astype(np.int8)))
    return edges[::2], edges[1::2]


def without_strong_lines(ordinates: FloatArray, bins: DctBins) -> tuple[FloatArray, tuple[Sine, ...]]:
    """Return the ordinates minus the steady sines whose tails are too wide to be left out, and the sines."""
    found: list[Sine] = []
    for _ in range(_MAX_SINES):
        total, peaks = _totals_and_peaks(ordinates, bins)
        level, sureness = _level(total, bins.count.astype(np.float64), bins)
        at = int(np.argmax(np.where(bins.first > _LOWEST, peaks / level, 0.0)))
        first, stop = int(bins.first[at]) - 1, int(bins.first[at] + bins.count[at]) - 1
        top = first + int(np.argmax(np.abs(ordinates[first:stop])))
        excess = ordinates[top] ** 2 / level[at]
        sure = excess > float(_limit(sureness[[at]], _CHANCE / max(ordinates.size, 1))[0])
        if not sure or np.sqrt(excess / _TAIL) / np.pi <= max(_MIN_SKIP, _MAX_SKIP * top) or top < _LOWEST:
            break
        sine = _fitted_sine(ordinates, bins.n, top)
        rest = ordinates - sine.ordinates(bins.n, ordinates.size)
        near = slice(max(top - _MIN_SKIP, 0), top + _MIN_SKIP + 1)
        if np.sum(rest[near] ** 2) > _REMAINS * np.sum(ordinates[near] ** 2):
            break
        found.append(sine)
        ordinates = rest
    return ordinates, tuple(found)


def _fitted_sine(ordinates: FloatArray, n: int, top: int) -> Sine:
    first = max(top - _ABOUT, 0)
    seen = ordinates[first : top + _ABOUT + 1]
    theta = np.asarray(np.pi / n * np.arange(first + 1, first + 1 + seen.size), dtype=np.float64)

    def columns(omega: float) -> FloatArray:
        return np.stack([cycle_ordinates(n, theta, omega, phase) for phase in (0.0, -np.pi / 2)], axis=1)

    def misfit(place: float) -> float:
        matrix = columns(np.pi / n * place)
        return float(np.sum((seen - matrix @ np.linalg.lstsq(matrix, seen, rcond=None)[0]) ** 2))

    grid = top + 1 + np.linspace(-1, 1, 17)
    nearest = grid[int(np.argmin([misfit(place) for place in grid.tolist()]))]
    place = float(
        scipy.optimize.minimize_scalar(
            misfit, bounds=(nearest - 0.15, nearest + 0.15), method="bounded", options={"xatol": 1e-7}
        ).x
    )
    omega = np.pi / n * place
    cosine, sine = np.linalg.lstsq(columns(omega), seen, rcond=None)[0].tolist()
    return Sine(omega=omega, cosine=cosine, sine=sine)


def with_sines(
    lines: tuple[Line, ...], sines: Sequence[Sine], *, scale: float, rate_hz: float
) -> tuple[Line, ...]:
    """Return all lines, the strongest first; the remainder of a sine is not another line."""
    unit = rate_hz / (2 * np.pi)
    whole = [Line(frequency_hz=sine.omega * unit, amplitude=sine.amplitude * scale) for sine in sines]
    places = np.array([line.frequency_hz for line in whole])
    others = [line for line in lines if not np.any(np.abs(line.frequency_hz / places - 1) < _MAX_SKIP)]
    return tuple(sorted((*whole, *others), key=lambda line: -line.amplitude))


#: Mains frequencies, in Hz.
_MAINS = (50.0, 60.0)
#: Number of harmonics of the mains to compare.
_HARMONICS = 3
#: Largest relative error of the mains' frequency: 0.2 Hz of 50 Hz.
_GRID_ERROR = 4e-3


def likely_cause(frequency_hz: float, *, rate_hz: float, resolution_hz: float) -> str:
    """Return the likely cause of a tone; frequencies above half the rate appear folded."""
    for mains in _MAINS:
        for harmonic in range(1, _HARMONICS + 1):
            true = harmonic * mains
            close = max(resolution_hz, _GRID_ERROR * true)
            folded = abs(true - round(true / rate_hz) * rate_hz)
            if abs(frequency_hz - folded) < close and folded > 2 * close:
                name = f"{mains:.0f} Hz mains" + (f", harmonic {harmonic}" if harmonic > 1 else "")
                return name if true == folded else f"{name}, folded by the sampling"
    divisor = rate_hz / frequency_hz
    whole = round(divisor)
    off = abs(rate_hz / whole - frequency_hz)
    if 2 <= whole <= 8 and off < resolution_hz < 5e-3 * frequency_hz:
        return f"the sampling rate over {whole}: the timing of the logger or the sensor"
    if frequency_hz < 1:
        return "a beat of two clocks, or a heating or cooling cycle"
    if frequency_hz < 15:
        return "the swaying of a building or table, or a folded higher tone"
    if frequency_hz < 250:
        return f"a fan or motor at {60 * frequency_hz:.0f} rpm, or a folded higher tone"
    return "electronics, or a resonance"
