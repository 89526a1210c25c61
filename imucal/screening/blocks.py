"""An axis at rest as a few dozen means: the slow part, in which drifts show."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.screening.profile import Profile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Means over equal spans of time; `time_s` (middle, s) and `mean` (U) have shape (k,)."""

    time_s: FloatArray
    mean: FloatArray


def blocks(profile: Profile, count: int) -> Blocks:
    """Return the means of the undisturbed windows over `count` equal spans; empty spans are left out."""
    windows = profile.windows
    rest = ~profile.disturbed
    middle = windows.time_s[rest] + windows.length_s / 2
    place = np.minimum((middle / profile.series.duration_s * count).astype(np.int64), count - 1)
    number = np.bincount(place, minlength=count)
    filled = number > 0
    offset = float(windows.mean[rest][0]) if middle.size else 0.0
    total = np.bincount(place, weights=windows.mean[rest] - offset, minlength=count)
    when = np.bincount(place, weights=middle, minlength=count)
    return Blocks(time_s=when[filled] / number[filled], mean=offset + total[filled] / number[filled])
