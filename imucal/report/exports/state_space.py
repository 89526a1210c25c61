"""An axis's slow noise as first-order states of a Kalman filter: x[t+1] = phi x[t] + q w[t].

Flicker has no finite state space; a bank of Gauss-Markov processes with log-spaced T and variance
``B^2 ln(r) / pi`` each (r the ratio of neighbours) has its psd to 0.7 % at 1.5 states a decade, inside the
bank, which reaches from where flicker begins to stand out of the white noise to the length of the record.
"""

import math
from collections.abc import Iterator

from imucal.noise.terms import GaussMarkov
from imucal.report.exports.config_numbers import Numbers
from imucal.report.result import AxisReport

#: States a decade of correlation time.
_PER_DECADE = 1.5
#: How far the bank reaches below the time at which flicker and white noise are equal.
_MARGIN = 10.0


def flicker_bank(B: float, shortest_s: float, longest_s: float) -> tuple[GaussMarkov, ...]:
    """Return Gauss-Markov terms whose sum is flicker B for times between `shortest_s` and `longest_s`."""
    steps = max(1, math.ceil(_PER_DECADE * math.log10(longest_s / shortest_s)))
    ratio = (longest_s / shortest_s) ** (1 / steps)
    sigma = B * math.sqrt(math.log(ratio) / math.pi)
    return tuple(GaussMarkov(sigma=sigma, T=shortest_s * ratio**i) for i in range(steps + 1))


def states(numbers: Numbers, axis: AxisReport) -> Iterator[tuple[str, GaussMarkov]]:
    """Yield the Gauss-Markov terms of an axis, and those that stand for its flicker, with the term's name."""
    for estimate in axis.fit.estimates:
        if estimate.symbol == GaussMarkov.symbol and estimate.value and estimate.correlation_time is not None:
            sigma = estimate.value * numbers.choices.factor(GaussMarkov.symbol)
            yield estimate.key, GaussMarkov(sigma=sigma, T=estimate.correlation_time.value)
    if axis.fit["B"].value is None:
        return
    period = 1 / float(f"{axis.rate_hz:.9g}")
    flicker, white = numbers.of(axis, "B").value, numbers.of(axis, "N").value
    equal_s = white**2 / (2 * math.log(2) / math.pi * flicker**2)
    longest = max(axis.duration_s, 10 * period)
    shortest = min(max(period, equal_s / _MARGIN), longest / 2)
    yield from (("B", term) for term in flicker_bank(flicker, shortest, longest))
