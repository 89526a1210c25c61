"""Jumps of the level that stay: a tilted table, a bias that switches."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screening.profile import Profile
from imucal.screening.words import amount

#: A step must stand out by this many robust deviations: chance gives 5 once in a million.
_LIMIT = 9.0
#: Steps are looked for between means of 2^j windows, while this many of them fit into the log.
_LEAST_MEANS = 40
#: Nearer to the ends of the log than this part of it, a jump is no level that stays.
_CLEAR = 0.05
#: Median of |normal|.
_MEDIAN_NORMAL = 0.6744898


@dataclass(frozen=True, slots=True)
class _Step:
    score: float
    time_s: float
    height: float


def check_steps(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding for the largest jump that stands out of the axis's own wander.

    The mean after each moment minus the mean before it, over spans of doubling length; noise of any
    colour makes these differences normal, with a deviation that their median gives.
    """
    step = _largest(profile)
    if step is None:
        return ()
    series = profile.series
    first = step.time_s > series.duration_s / 2
    keep = (0.0, round(step.time_s - 1, 1)) if first else (round(step.time_s + 1, 1), series.duration_s)
    return (
        Finding(
            level="warning",
            code="step",
            text=(
                f"The level of {series.name} jumps by {amount(abs(step.height), series.sensor)} at "
                f"{step.time_s:.1f} s and stays there."
            ),
            advice=(
                "Fix the IMU so that nothing tilts it, and keep one side of the jump: "
                "the jump would be fitted as a random walk."
            ),
            axis=series.name,
            keep_s=keep,
        ),
    )


def _largest(profile: Profile) -> _Step | None:
    windows = profile.windows
    rest = ~profile.disturbed
    mean, seconds = windows.mean[rest], windows.time_s[rest]
    # Without the noise to dither it, a value toggles by an LSB when its mean moves by none at all.
    lsb = profile.lsb or 0.0
    least = lsb if profile.noise < 0.5 * lsb else 0.0
    best: _Step | None = None
    span = 2
    while span * _LEAST_MEANS <= mean.size:
        jumps, places = _jumps(mean, span)
        scale = float(np.median(np.abs(jumps))) / _MEDIAN_NORMAL
        clear = max(0, int(_CLEAR * mean.size) - span)
        top = clear + int(np.abs(jumps[clear : jumps.size - clear]).argmax())
        height = float(jumps[top])
        score = abs(height) / scale if scale > 0 else 0.0
        if score > _LIMIT and abs(height) > least and (best is None or score > best.score):
            best = _Step(score, float(seconds[places[top]]), height)
        span *= 2
    return best


def _jumps(mean: FloatArray, span: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the next `span` windows minus that of the last, and the index between them."""
    total = np.concatenate([[0.0], np.cumsum(mean - mean[0])])
    jumps = (total[2 * span :] - 2 * total[span:-span] + total[: -2 * span]) / span
    return jumps, np.arange(span, span + jumps.size)
