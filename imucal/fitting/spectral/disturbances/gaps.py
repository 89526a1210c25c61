"""Completion of missing samples by expectation-maximisation, without a model.

For a smooth spectrum S, the precision of the missing samples given the observed ones is the missing block of
C' diag(1/S) C (C the DCT). Conjugate gradients give their mean, a random draw their covariance, and

    E[X_k² | observed] = (mean X_k)² + var X_k

replaces X_k². The variance's share of it is information lost to the gaps.

If most samples are missing, a spectrum of free steps is undetermined. Then S is a sum of power laws. If the
share p of samples is seen, and N² is the white noise, the mean of X_k is about w (X_k + E_k), with the Wiener
filter w = S / (S + (1/p - 1) N²) and white noise E_k of the variance (1/p - 1) N²; for white noise w = p.

Source: Dempster, Laird & Rubin (1977), JRSS B 39; draws: Papandreou & Yuille (2010), NIPS 23; lost
information: Louis (1982), JRSS B 44.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucal.allan.dct import DctBins, dct2, idct2
from imucal.arrays import BoolArray, FloatArray, IntArray

#: Largest expected change of the spectrum in a next round.
_MOVED = 3e-4
#: Largest number of rounds.
_ROUNDS = 40
#: Samples of the longest gap above which fewer rounds are made.
_LONG = 64
#: Rounds beside a long gap: the record informs about some frequencies only, and more rounds make lines of the
#: others.
_ROUNDS_IF_LONG = 8
#: Ratio of the frequencies over which a variance is averaged.
_NEAR = 1.5
#: Least number of groups on each side over which it is averaged.
_NEIGHBOURS = 2
_STEPS = 40
_CLOSE = 1e-3
#: Largest number of missing samples for direct sums; beyond, transforms are faster.
_FEW = 1000
#: Largest number of sines per sample for direct sums.
_DIRECT = 30
_SEED = 20_24
#: Share of missing samples above which the spectrum is a sum of power laws.
_MOST = 0.6
#: Rounds for it: neighbours' differences start it with nearly the white noise, slow noise follows in few.
_ROUNDS_IF_SPARSE = 8
#: Fraction of Nyquist from which the spectrum is taken for white: the rest has room for slow noise.
WHITE_FROM = 1 / 8
#: Slopes of the power laws: white noise, flicker, random walk.
_SLOPES = (0, -1, -2)
#: Start of slow noise, in multiples of the white noise at the lowest group: too little, so that updates end
#: below the most likely value if it is weakly determined.
_SLOW_START = 1e-3
#: Multiplicative updates of their sum: 200 take about 10 ms.
_UPDATES = 200


def complete(
    samples: FloatArray, seen: BoolArray, bins: DctBins
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return expected ordinates, their variances, the lost information, and a draw of the missing samples.

    `samples`, shape (n,), are overwritten; only `seen` ones count. The results have the shapes (n-1,) twice,
    (b,) and (g,).
    """
    n = samples.size
    gaps = np.flatnonzero(~seen)
    if gaps.size > _MOST * n:
        return _complete_sparse(samples, seen, bins)
    samples[gaps] = _between(samples, gaps)
    mean = float(samples.mean())
    samples -= mean
    groups = _groups(bins)
    pairs = _Pairs.of(gaps, n, groups)
    # Long arrays are overwritten or deleted early to save memory.
    mean_of, count = dct2(samples), np.diff(groups, append=n - 1)
    variance, spectrum = np.zeros(groups.size), np.zeros(groups.size)
    longest = int(np.diff(np.flatnonzero(seen), prepend=-1, append=n).max()) - 1
    for number in range(_ROUNDS if longest <= _LONG else _ROUNDS_IF_LONG):
        previous, spectrum = spectrum, _means(mean_of[1:], groups) + variance
        if number and np.all(np.abs(spectrum - previous) * variance < _MOVED * previous * spectrum):
            break
        right = idct2(_weighed(mean_of, 1 / spectrum, groups))[gaps]
        del mean_of
        draw = np.empty(n)
        np.random.default_rng(_SEED).standard_normal(out=draw[1:])
        drawn = idct2(_weighed(draw, 1 / np.sqrt(spectrum), groups))[gaps]
        del draw
        apply = _precision(gaps, pairs, 1 / spectrum, groups, n)
        ends = np.maximum(np.append(groups, n - 1), (n - 1) // 2)
        unit = float(np.median(np.repeat(spectrum, np.diff(ends))))
        samples[gaps] -= _conjugate(apply, right, unit)
        error = _conjugate(apply, drawn, unit)
        # Its expectation is the number of missing samples; a draw's deviation would shift the level.
        drawn_size = float(drawn @ error)
        # It is zero if one draw of a few samples is within the solver's tolerance.
        error *= np.sqrt(gaps.size / drawn_size) if drawn_size > 0 else 1.0
        variance = _smooth(_means(dct2(_padded(error, gaps, n))[1:], groups), groups, count)
        mean_of = dct2(samples)
    # Smooth: if a group's own power set its weight, the level would be too high.
    share = variance / (_smooth(_means(mean_of[1:], groups), groups, count) + variance)
    loss = share[np.searchsorted(groups, bins.first - 1, side="right") - 1]
    return mean_of[1:], np.repeat(variance, count), np.clip(loss, 0.0, 0.99), mean + samples[gaps] + error


def _complete_sparse(
    samples: FloatArray, seen: BoolArray, bins: DctBins
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the results of `complete` if few samples are seen.

    In the white part of the spectrum N² scales X_k and E_k, so its level has the information of all samples
    that are seen.
    """
    n, gaps = samples.size, np.flatnonzero(~seen)
    share = 1 - gaps.size / n
    groups = _groups(bins)
    count = np.diff(groups, append=n - 1)
    white = 0.5 * float(np.mean(np.square(np.diff(samples[seen]))))
    mean = float(samples[seen].mean())
    samples[gaps] = mean
    samples -= mean
    middle = groups + 0.5 * (count + 1)
    laws = np.array([(middle / middle[-1]) ** slope for slope in _SLOPES])
    # The noise of the missing samples' places adds to the white noise.
    with_lost = np.concatenate([laws[:1] / share, laws[1:]])
    size = np.array([white, *np.zeros(len(_SLOPES) - 1)])
    for _ in range(_ROUNDS_IF_SPARSE):
        spectrum = size @ laws
        known = spectrum / (spectrum + (1 / share - 1) * size[0])
        apply = _precision(gaps, None, 1 / spectrum, groups, n)
        right = idct2(_weighed(dct2(samples), 1 / spectrum, groups))[gaps]
        samples[gaps] -= _conjugate(apply, right, white)
        ordinates = dct2(samples)[1:]
        power = _means(ordinates, groups) / known**2
        size = _sizes_of_laws(power, with_lost, count)
        if np.all(np.abs(size @ laws - spectrum) < _CLOSE * spectrum):
            break
    draw = np.append(0.0, np.random.default_rng(_SEED).standard_normal(n - 1))
    error = _conjugate(apply, idct2(_weighed(draw, 1 / np.sqrt(spectrum), groups))[gaps], white)
    # With w p ordinates a bin prefers S to white noise by as much as the ordinates w (X_k + E_k) do.
    keep = np.sqrt(known * np.where(groups >= WHITE_FROM * n, 1.0, share))
    loss = 1 - keep[np.searchsorted(groups, bins.first - 1, side="right") - 1]
    return ordinates, np.repeat((1 - known) * spectrum, count), loss, mean + samples[gaps] + error


def _sizes_of_laws(power: FloatArray, laws: FloatArray, count: IntArray) -> FloatArray:
    """Return the sizes of the laws, shape (l, g), whose sum maximises Whittle's likelihood.

    `power`, shape (g,), is the mean square of the `count` ordinates of each group.

    Source: Févotte, Bertin & Durrieu (2009), Neural Comput. 21(3), multiplicative updates.
    """
    size = np.asarray(float(count @ power) / float(count.sum()) / laws[:, 0])
    size[1:] *= _SLOW_START
    for _ in range(_UPDATES):
        total = size @ laws
        size = size * np.sqrt((laws @ (count * power / total**2)) / (laws @ (count / total)))
    return size


def _smooth(variance: FloatArray, groups: IntArray, count: IntArray) -> FloatArray:
    """Return the means of a variance over neighbouring groups, shape of `groups`.

    A low draw in a group alone could reduce the spectrum in each round, down to zero.
    """
    middle, place = groups + 0.5 * count, np.arange(groups.size)
    first = np.minimum(np.searchsorted(middle, middle / _NEAR), np.maximum(place - _NEIGHBOURS, 0))
    stop = np.searchsorted(middle, middle * _NEAR, side="right")
    stop = np.maximum(stop, np.minimum(place + _NEIGHBOURS + 1, groups.size))
    total = np.concatenate([np.zeros((2, 1)), np.cumsum([variance * count, count], axis=1)], axis=1)
    weighted, number = total[:, stop] - total[:, first]
    return np.asarray(weighted / number)


def _between(samples: FloatArray, gaps: IntArray) -> FloatArray:
    """Return straight lines over each gap, shape (g,); constants at the ends of the record.

    A line joins the means of as many samples on either side as are missing: a single neighbour's noise over a
    whole gap would add far too much power at low frequencies.
    """
    begins = np.diff(gaps, prepend=-2) > 1
    gap = np.cumsum(begins) - 1
    first, after = gaps[begins], gaps[np.append(begins[1:], True)[: gaps.size]] + 1
    size = after - first
    low = np.maximum(first - size, np.append(0, after[:-1]))
    high = np.minimum(after + size, np.append(first[1:], samples.size))
    ends = np.stack([low, first, after, high])
    ends[:2, first == 0], ends[2:, after == samples.size] = (
        ends[2:, first == 0],
        ends[:2, after == samples.size],
    )
    left, right = (
        np.add.reduceat(np.append(samples, 0.0), sides.T.ravel())[::2] / np.diff(sides, axis=0)[0]
        for sides in (ends[:2], ends[2:])
    )
    fraction = (gaps - first[gap] + 1) / (size + 1)[gap]
    return np.asarray(left[gap] + fraction * (right - left)[gap])


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Distances between missing samples: `lag`, shape (l,), and its indices of |i-j| and i+j+1, (g, g)."""

    lag: IntArray
    apart: IntArray
    beyond: IntArray

    @classmethod
    def of(cls, gaps: IntArray, n: int, groups: IntArray) -> "_Pairs | None":
        if gaps.size > _FEW:
            return None
        apart, beyond = np.abs(gaps[:, np.newaxis] - gaps), gaps[:, np.newaxis] + gaps + 1
        lag, which = np.unique(np.stack([apart, beyond]), return_inverse=True)
        if lag.size * groups.size > _DIRECT * n:
            return None
        which = which.reshape(2, *apart.shape)
        return cls(lag, which[0], which[1])


def _precision(
    gaps: IntArray, pairs: _Pairs | None, weight: FloatArray, groups: IntArray, n: int
) -> Callable[[FloatArray], FloatArray]:
    """Return the product with the missing block of C' diag(w) C, w the weight of each group, as a function.

    Its element i, j is r(i-j) + r(i+j+1) with r(l) = sum over k of w_k cos(pi k l / n) / n.
    """
    if pairs is not None:
        of_lag = _cosine_sums(pairs.lag, weight, groups, n)
        matrix = of_lag[pairs.apart] + of_lag[pairs.beyond]
        return lambda values: np.asarray(matrix @ values)

    def by_transforms(values: FloatArray) -> FloatArray:
        return np.asarray(idct2(_weighed(dct2(_padded(values, gaps, n)), weight, groups))[gaps])

    return by_transforms


def _cosine_sums(lag: IntArray, weight: FloatArray, groups: IntArray, n: int) -> FloatArray:
    """Return the sum over k = 1 … n-1 of w_k cos(pi k l / n) / n at each lag, shape (l,).

    The sum over equal weights from a to b - 1 is w (sin((b - 1/2) t) - sin((a - 1/2) t)) / (2 sin(t/2)).
    """
    edge = np.append(groups, n - 1) + 0.5
    fall = -np.diff(weight, prepend=0.0, append=0.0)
    sums = np.full(lag.size, float(weight @ np.diff(edge)))
    # Lags 0 and 2n are equivalent, and their sine is zero.
    for at in np.flatnonzero(lag % (2 * n)).tolist():
        angle = np.pi * int(lag[at]) / n
        sums[at] = float(fall @ np.sin(edge * angle)) / (2 * np.sin(angle / 2))
    return sums / n


def _padded(values: FloatArray, gaps: IntArray, n: int) -> FloatArray:
    padded = np.zeros(n)
    padded[gaps] = values
    return padded


def _weighed(ordinates: FloatArray, weight: FloatArray, groups: IntArray) -> FloatArray:
    """Multiply ordinates 0 … n-1 in place by their group's weight, ordinate 0 by 0."""
    ordinates[0] = 0.0
    for (start, stop), factor in zip(_spans(ordinates.size - 1, groups), weight.tolist(), strict=True):
        ordinates[start + 1 : stop + 1] *= factor
    return ordinates


def _means(ordinates: FloatArray, groups: IntArray) -> FloatArray:
    means = [
        float(np.mean(np.square(ordinates[start:stop]))) for start, stop in _spans(ordinates.size, groups)
    ]
    return np.maximum(means, 1e-300)


def _spans(n: int, groups: IntArray) -> list[tuple[int, int]]:
    return list(pairwise([*groups.tolist(), n]))


def _groups(bins: DctBins) -> IntArray:
    """Return the first index of each group of bins of 16 ordinates or more."""
    starts = bins.first - 1
    chosen = [0]
    for start in starts[1:].tolist():
        if start - chosen[-1] >= 16 and bins.n - 1 - start >= 16:
            chosen.append(start)
    return np.array(chosen, dtype=np.int64)


def _conjugate(apply: Callable[[FloatArray], FloatArray], right: FloatArray, unit: float) -> FloatArray:
    """Solve ``apply(x) = right`` by conjugate gradients, to a small fraction of the samples' noise."""
    x = np.zeros(right.size)
    rest = right.copy()
    direction = rest.copy()
    size = rest @ rest
    goal = _CLOSE**2 * max(float(size), right.size / unit)
    for _ in range(_STEPS):
        if size <= goal:
            break
        image = apply(direction)
        step = size / (direction @ image)
        x += step * direction
        rest -= step * image
        previous, size = size, rest @ rest
        direction = rest + size / previous * direction
    return x
