"""Vibration and sway: an interval of frequencies with more power than the white noise below and above it.

A low-pass filter can imitate such a hump, and the fit then reports too much white noise. Repeated fits of
power laws to the bins outside find the interval, which is excluded as a whole.
"""

from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.likelihood import derivatives, evaluate
from imucal.fitting.spectral.maximum import fit_blindly
from imucal.fitting.spectral.models import COLUMN, Structure, models_of
from imucal.fitting.spectral.ordinates import Ordinates

#: A hump is the run of bins with the largest sum of standardised residuals, each less this.
_EXCESS = 0.5
#: Least sum of a hump: chance does not reach it.
_SUM = 25.0
#: Least ratio of its density to the noise.
_TIMES = 3.0
#: Least number of ordinates below the hump, to know the noise there.
_BELOW = 16.0
#: Least share of all ordinates above the hump.
_ABOVE = 0.05
#: Number of bins on both sides that show what is next to a hump.
_NEXT = 4
#: Least share of white noise in the density of these bins: with less, a filter is more likely.
_WHITE = 0.6
#: The same next to a strong hump, which no filter makes.
_WHITE_IF_STRONG = 0.4
#: Ratio to the noise of a strong hump.
_STRONG = 10.0
#: A plateau with no lower density below it is white noise behind a filter: least ratio to the noise, …
_ABOVE_NOISE = 1.3
#: … least width in octaves, …
_OCTAVES = 2.5
#: … width in octaves of the cells that are compared, …
_CELL = 0.5
#: … least number of ordinates of a cell, …
_COUNT = 200
#: … and largest difference of the cells, in addition to chance.
_EVEN = 0.12
#: Factor that widens the interval: the next bins may belong to it and be low by chance.
_GUARD = 1.2
#: Largest number of fits; the interval is usually the same after three.
_ROUNDS = 10
#: Fewest bins of a fit.
_MIN_BINS = 24


@dataclass(frozen=True, kw_only=True)
class Hump:
    """An interval of frequencies, as fractions of Nyquist, with up to `times` the density of the noise."""

    low: float
    high: float
    times: float

    def outside(self, fraction: FloatArray) -> BoolArray:
        return np.asarray((fraction < self.low) | (fraction > self.high))

    def wider(self) -> "Hump":
        return replace(self, low=self.low / _GUARD, high=min(self.high * _GUARD, (1 + self.high) / 2))


def find_hump(ordinates: Ordinates, structure: Structure) -> Hump | None:
    """Return the hump in the spectrum of noise with a `structure` of power laws; None if there is none.

    The caller checks whether the structure describes the rest of the spectrum.
    """
    order = np.argsort(ordinates.fraction, kind="stable")
    fraction, size = ordinates.fraction[order], ordinates.size[order]
    model = models_of([structure], ordinates.names)
    hump: Hump | None = None
    for _ in range(_ROUNDS):
        seen = ordinates[hump.outside(ordinates.fraction)] if hump else ordinates
        if seen.size.size < _MIN_BINS:
            return None
        found = fit_blindly(seen, model, keep=(1, 2, 4), tolerance=1e-3)
        spectrum = evaluate(ordinates, model, found.theta).spectrum[0]
        ratio = (ordinates.rest(found.beta[0]) / ordinates.size / spectrum)[order]
        first, last, total = largest_run((ratio - 1) * np.sqrt(size / 2) - _EXCESS)
        enough_around = size[:first].sum() >= _BELOW and size[last + 1 :].sum() >= _ABOVE * size.sum()
        if total < _SUM or not enough_around:
            return None
        previous, hump = (
            hump,
            Hump(
                low=float(fraction[first - 1] + fraction[first]) / 2,
                high=float(fraction[last] + fraction[last + 1]) / 2,
                times=float(ratio[first : last + 1].max()),
            ),
        )
        if previous == hump:
            break
    white = (derivatives(ordinates, model, found.theta)[COLUMN["N"]] / spectrum)[order]
    edges = np.concatenate([white[max(first - _NEXT, 0) : first], white[last + 1 :][:_NEXT]])
    if hump is None or hump.times < _TIMES:
        return None
    inside = slice(first, last + 1)
    if is_plateau(
        fraction[: last + 1], size[: last + 1], (ratio * spectrum[order])[: last + 1], ratio[inside]
    ):
        return None
    return hump.wider() if edges.min() >= (_WHITE if hump.times < _STRONG else _WHITE_IF_STRONG) else None


def is_plateau(fraction: FloatArray, size: FloatArray, density: FloatArray, ratio: FloatArray) -> bool:
    """Whether a run of bins is a plateau and not a hump.

    `ratio` is the density of the run relative to the noise; the other arrays also contain the bins below it.
    """
    cell = np.floor(np.log2(fraction / fraction[-1]) / _CELL)
    starts = np.flatnonzero(np.diff(cell, prepend=-np.inf))
    count = np.add.reduceat(size, starts)
    level = np.add.reduceat(density * size, starts) / count
    inside = np.zeros(fraction.size)
    inside[-ratio.size :] = ratio
    times = np.add.reduceat(inside * size, starts) / count
    least = round(_OCTAVES / _CELL)
    for i in range(starts.size - least + 1):
        run = slice(i, i + least)
        mean = np.average(level[run], weights=count[run])
        allowed = _EVEN * mean + 2 * mean * np.sqrt(2 / count)
        known = count[run].min() >= _COUNT and times[run].min() >= _ABOVE_NOISE
        if (
            known
            and np.all(np.abs(level[run] - mean) <= allowed[run])
            and np.all(level[:i] >= mean - allowed[:i])
        ):
            return True
    return False


def largest_run(values: FloatArray) -> tuple[int, int, float]:
    """Return the first and last index of the run with the largest sum, and the sum."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = int(np.argmax(total - np.minimum.accumulate(total)))
    first = int(np.argmin(total[: last + 1]))
    return first, last - 1, float(total[last] - total[first])


def hump_finding(hump: Hump, *, rate_hz: float, axis: str, fitted: bool) -> Finding:
    """Return the warning for a hump; if it is not `fitted`, nothing was left out."""
    low, high = hump.low * rate_hz / 2, hump.high * rate_hz / 2
    text = (
        f"The density between {low:.3g} and {high:.3g} Hz is up to {hump.times:.2g} times the noise: a "
        "vibration or a sway."
    )
    if fitted:
        text += " The fit leaves these frequencies out; the Allan curve contains them."
    advice = "Record on a firm surface, away from motors, fans and footsteps."
    return Finding("warning", "hump", text, advice, axis=axis)
