"""Ticks of a coarse clock that are about as long as the period.

If the tick is shorter, some ticks pass without a sample; if it is longer, some have two. These ticks are
regular, so the numbers of samples have a line in their spectrum; random losses have none.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray, median, percentile
from imucal.readers.clocks.runs import Runs

#: Largest distance of steps from whole ticks, in units of the stamps' resolution: each stamp is rounded.
_MAX_OFF_UNITS = 1.01
#: The same in ticks: with a resolution of a tick, any steps are whole.
_MAX_OFF = 0.2
#: Largest usual number of ticks in a step over empty ticks: two, unless several samples are missing.
_MAX_USUAL_LONG = 2
#: Stamps of a run that are examined.
_STAMPS = 16_384
#: Runs that are examined.
_RUNS = 5
#: Most ticks per stamp.
_MAX_TICKS = 8
#: Fewest cycles of a line: fewer may be chance.
_MIN_CYCLES = 4
#: Least height of a line in units of the height that regular ticks cause; jitter lowers it.
_MIN_HEIGHT = 0.6
#: Largest height: multiples of the frequency have higher lines.
_MAX_HEIGHT = 1.5
#: Least height of a line in standard deviations of the noise of random losses.
_MIN_SIGNIFICANT = 5.0
#: Least height of a line relative to the highest one.
_MIN_RELATIVE = 0.6
#: Height above which the lines at multiples of the rate are not needed.
_CERTAIN = 10.0
#: Numbers of lines that are added if each is weak.
_LINES = (4, 8, 16, 32)
#: Least mean power of these lines in units of the power that regular ticks cause.
_MIN_EXCESS = 0.3
#: Bands with their own level of noise.
_BANDS = 40
#: Quantile of the normal distribution that a variable exceeds with a probability of 1e-9.
_NORMAL_LIMIT = 6.0
#: Largest share of lost samples.
_MAX_LOST = 0.5
#: Least share of double ticks that regular ones cause, relative to their rate, in spite of losses.
_MIN_DOUBLE = 0.2
#: Largest error of the rate of a line, in cycles of the run.
_RATE_ERROR = 0.2
#: Least share of steps of one tick, relative to the expected one: a line that is due to jitter has fewer.
_MIN_SINGLE = 0.5
#: Phases of a cycle.
_PHASES = 16
#: Least share of samples that share a tick.
_MIN_SHARED = 1e-4


@dataclass(frozen=True, kw_only=True)
class CoarseClock:
    """Samples of period `tau_ns` on a clock with ticks of `tick_ns`."""

    tau_ns: float
    tick_ns: float
    #: Whether the cycle is a whole number of ticks, as if every nth sample was lost.
    regular: bool
    #: Whether no two samples share a tick.
    single: bool


def coarse_clock(runs: Runs, unit: float) -> CoarseClock | None:
    """Return the clock with ticks of about `unit` ns if empty or double ticks are regular; otherwise None."""
    whole = np.rint(runs.steps / unit)
    if whole.sum() <= 0:
        return None
    tick = float(runs.steps.sum() / whole.sum())
    off = percentile(np.abs(runs.steps - whole * tick), 99)
    longer = whole[whole > 1]
    if off > min(_MAX_OFF_UNITS * runs.quantum_ns, _MAX_OFF * tick):
        return None
    if percentile(whole, 10) > 1 or (longer.size and median(longer) > _MAX_USUAL_LONG):
        return None
    parts = [part[:_STAMPS] for part in runs.parts[:: -(-len(runs.parts) // _RUNS)]]
    shares = [share for part in parts if (share := _regular_share(part, tick))]
    if 2 * len(shares) <= len(parts):
        return None
    share = median(shares)
    if np.mean(whole <= 1) < _MIN_SINGLE * _single_steps(max(share, 0.0), float(whole.sum()) / whole.size):
        return None
    tau = tick / (1 - share)
    single = np.count_nonzero(whole < 1) <= _MIN_SHARED * whole.size
    # The rate of a line is known to a share of a cycle in a run.
    cycle = 1 / abs(share)
    regular = abs(cycle - round(cycle)) < _RATE_ERROR * cycle**2 / parts[0].size
    if single:
        between = np.concatenate([np.diff(np.flatnonzero(np.diff(part) > 1.5 * tick)) for part in runs.parts])
        regular = regular and between.size > 0 and percentile(between, 5) == percentile(between, 95)
    return CoarseClock(tau_ns=tau, tick_ns=tick, regular=bool(regular), single=bool(single))


def _single_steps(share: float, mean_step: float) -> float:
    """Return the expected share of steps of one tick, with a share of regularly empty ticks and losses."""
    kept = min(1 / mean_step / (1 - share), 1.0)
    return max(1 - share / (1 - share), 0.0) * kept


def _regular_share(stamps: IntArray, tick: float) -> float:
    """Return the share of regularly empty ticks (negative: of double ticks); 0 without a line."""
    # Not np.rint: it rounds halves to even numbers, and would pair ticks after a move by half a tick.
    at = np.floor((stamps - stamps[0]) / tick + 0.5).astype(np.int64)
    if at.min() < 0 or at.max() > _MAX_TICKS * at.size:
        return 0.0
    counts = np.bincount(at).astype(np.float64)
    n, mean = counts.size, float(counts.mean())
    noise = float(counts.std()) * np.sqrt(n)
    if noise == 0:
        return 0.0
    width = 8 << n.bit_length()
    heights = np.abs(np.fft.rfft(counts - mean, width))
    rates = np.arange(heights.size) / width
    # With a regular share r of the ticks, the others have mean / (1 - r) samples on average.
    expected = rates * n * mean / np.maximum(1 - rates, 0.1)
    possible = (rates * n >= _MIN_CYCLES) & (heights < _MAX_HEIGHT * expected)
    possible &= (heights > _MIN_HEIGHT * expected) & (mean > (1 - _MAX_LOST) * (1 - rates))
    possible &= heights > _MIN_SIGNIFICANT * noise
    possible[1:-1] &= (heights[1:-1] >= heights[:-2]) & (heights[1:-1] >= heights[2:])
    peaks = np.flatnonzero(possible)
    rate = 0.0
    if peaks.size:
        # Sidelobes are lower than their line; multiples of the rate are as high, but expected to be higher.
        peaks = peaks[heights[peaks] > _MIN_RELATIVE * heights[peaks].max()]
        peak = peaks[np.argmin(np.abs(np.log(heights[peaks] / expected[peaks])))]
        rate = float(rates[peak])
        if heights[peak] > _CERTAIN * noise:
            return _signed(counts, rate)
    several = _rate_of_many_lines(heights**2, n, mean)
    if several and np.mean(counts > 1) <= _MIN_DOUBLE * several:
        return several
    return _signed(counts, several or rate)


def _signed(counts: FloatArray, rate: float) -> float:
    """Return the rate of a cycle, negative if some phases have two samples; 0 if it shows neither."""
    phase = (rate * np.arange(counts.size) % 1.0 * _PHASES).astype(np.int64)
    means = np.bincount(phase, counts, _PHASES) / np.maximum(np.bincount(phase, minlength=_PHASES), 1)
    middle = float(counts.mean())
    if middle - means.min() >= means.max() - middle:
        return rate
    # With few shared ticks, the line is that of a period longer than two ticks.
    return -rate if np.mean(counts > 1) > _MIN_DOUBLE * rate else 0.0


def _rate_of_many_lines(power: FloatArray, n: int, mean: float) -> float:
    """Return the rate whose multiples have more power than random losses cause; 0 if there is none.

    All multiples of the rate have lines of the same height. The sum of the power at K frequencies, in units
    of the noise, has a gamma distribution of shape K.
    """
    if power.size < _BANDS:
        return 0.0
    # Losses in runs have more power at low frequencies; the median of exponential power is ln 2 of its mean.
    bands = np.array_split(power, _BANDS)
    noise = np.concatenate([np.full(band.size, median(band) / np.log(2)) for band in bands])
    noise = np.maximum(noise, 1e-9 * power.mean())
    relative = power / noise
    width = 2 * (power.size - 1)
    best, significance = 0.0, 0.0
    for lines in _LINES:
        rates = np.arange(_MIN_CYCLES * lines * width // n, width // 2) / (lines * width)
        height = (rates * n * mean / (1 - rates)) ** 2 / noise[np.rint(rates * width).astype(np.int64)]
        total = np.zeros(rates.size)
        prime = np.zeros(rates.size)
        primes = 0
        for multiple in range(1, lines + 1):
            # One high line is no sum of weak ones.
            line = np.minimum(relative[np.rint(rates * (multiple * width)).astype(np.int64)], height + 3)
            total += line
            if multiple % 2 and multiple % 3:
                prime += line
                primes += 1
        # A half or a third of the true rate has no lines at multiples that are prime to 6.
        is_high = prime / primes - 1 > _MIN_EXCESS * height
        possible = (total > _gamma_limit(lines)) & is_high & (mean > (1 - _MAX_LOST) * (1 - rates))
        if possible.any():
            highest = int(np.argmax(np.where(possible, total, 0.0)))
            excess = float(total[highest] / lines - 1) * np.sqrt(lines)
            if excess > significance:
                best, significance = float(rates[highest]), excess
    return best


def _gamma_limit(shape: int) -> float:
    """Return the value that a gamma variable exceeds with a probability of 1e-9.

    Wilson & Hilferty, The distribution of chi-square (1931).
    """
    third = 1 / (9 * shape)
    return float(shape * (1 - third + _NORMAL_LIMIT * np.sqrt(third)) ** 3)
