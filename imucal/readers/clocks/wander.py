"""The wander of stamps about their places, which shows uncounted losses.

Independent losses of a share p move the stamps like a random walk: the variance of their lateness grows by p
periods squared per sample. Late stamps catch up, so the variance does not grow.
"""

from imucal.arrays import FloatArray, percentile

#: Wander above which the rate may be wrong: losses of 0.3 % change N by 0.15 %.
MAX_WANDER = 0.003
#: Spans of lateness that fit into the stamps.
_SPANS = 20
#: Lower of two percentiles, in percent, whose distance is the width of spans: a few gaps do not change it.
_LOW = 15
#: Upper percentile, in percent, as far from the median.
_HIGH = 85
#: Distance of these percentiles of normal spans, in standard deviations.
_DEVIATIONS = 2.07
#: Ratio of the variances of long and short spans below which the growth is chance.
_MIN_GROWTH = 2.0


def wander(late: FloatArray, places_per_stamp: float, tick: float) -> float:
    """Return the variance per place, in periods squared, by which stamps wander about their places.

    `late` is the lateness of stamps, shape (n,), and `tick` their resolution, in periods.
    """
    if late.size < 4:
        return 0.0
    far = max(late.size // _SPANS, 2)
    # Stamps that are rounded to ticks, or late, differ from each other, but no more with distance. The
    # difference of two independent roundings has the variance tick²/6.
    near = max(_variance(late, 1), tick**2 / 6)
    growth = _variance(late, far)
    if growth < _MIN_GROWTH * near:
        return 0.0
    return (growth - near) / ((far - 1) * places_per_stamp)


def _variance(late: FloatArray, far: int) -> float:
    spans = late[far:] - late[:-far]
    return float(((percentile(spans, _HIGH) - percentile(spans, _LOW)) / _DEVIATIONS) ** 2)
