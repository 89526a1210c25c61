"""Whether values form two groups, as the units of two batches do."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from imucal.arrays import BoolArray, FloatArray

#: Fewest values of a group: one value alone is an odd unit.
_FEWEST = 2
#: Fewest values for a test.
_MIN_VALUES = 2 * _FEWEST + 1
#: Largest p-value of two groups: a fleet has about 18 terms, each of which is tested.
_ALARM = 0.002
#: Normal samples that give the distribution of the statistic.
_DRAWS = 9999
#: Seed of these samples, so that a fleet has the same p-value every time.
_SEED = 20_261_130


@dataclass(frozen=True, kw_only=True, eq=False)
class Groups:
    """Two groups of values: which are in the upper one, shape (n,), and the deviation within both.

    `p_value` is the probability of such a division of normal values.
    """

    is_upper: BoolArray
    deviation: float
    p_value: float


def find_groups(values: FloatArray) -> Groups | None:
    """Return the two groups of values, shape (n,); None if they may be one normal group.

    The statistic is the smallest share of the sum of squares that is within two groups of neighbours. Its
    distribution for normal values depends only on n, so normal samples give the p-value.

    Source: Engelman & Hartigan (1969), J. American Statistical Association 64, p. 1647.
    """
    n = values.size
    if n < _MIN_VALUES or not np.ptp(values) > 0:
        return None
    order = np.argsort(values, kind="stable")
    shares = _shares_within(values[order][None, :])[0]
    cut = int(np.argmin(shares))
    share = float(shares[cut])
    p_value = (1 + int(np.count_nonzero(_null(n) <= share))) / (1 + _DRAWS)
    if p_value > _ALARM:
        return None
    is_upper = np.zeros(n, dtype=np.bool_)
    is_upper[order[cut + _FEWEST :]] = True
    total = float(np.sum((values - values.mean()) ** 2))
    return Groups(is_upper=is_upper, deviation=math.sqrt(share * total / (n - 2)), p_value=p_value)


def _shares_within(ordered: FloatArray) -> FloatArray:
    """Return the share of squares within two groups, shape (rows, cuts), for sorted rows, shape (rows, n).

    The first cut leaves `_FEWEST` values in the lower group, the last one as many in the upper group.
    """
    n = ordered.shape[1]
    centred = ordered - ordered.mean(axis=1, keepdims=True)
    sums = np.cumsum(centred, axis=1)[:, _FEWEST - 1 : n - _FEWEST]
    sizes = np.arange(_FEWEST, n - _FEWEST + 1)
    # The sum of the upper group is minus that of the lower one.
    between = sums**2 * (1 / sizes + 1 / (n - sizes))
    total = np.sum(centred**2, axis=1, keepdims=True)
    shares: FloatArray = np.maximum(1 - between / total, 0.0)
    return shares


@cache
def _null(n: int) -> FloatArray:
    """Return the smallest shares of normal samples of n values, shape (draws,)."""
    rng = np.random.default_rng([_SEED, n])
    smallest = [
        _shares_within(np.sort(rng.standard_normal((size, n)), axis=1)).min(axis=1) for size in _chunks(n)
    ]
    return np.concatenate(smallest)


def _chunks(n: int) -> list[int]:
    """Return numbers of samples that are drawn at a time: about a million values."""
    size = max(1_000_000 // n, 1)
    whole, rest = divmod(_DRAWS, size)
    return [size] * whole + ([rest] if rest else [])
