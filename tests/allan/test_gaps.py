"""Tests of Allan variances with missing samples: no bias, valid intervals, no invented samples."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from numpy.typing import NDArray

from imucal.allan import allan_curve, variance
from imucal.allan.variance import (
    _positive,
    longest_run,
    run_variances,
    variances,
    window_variances,
)
from imucal.arrays import FloatArray
from imucal.clock import Clock, Segment
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import AxisSeries
from tests.slow_cases import first_by_default

MODEL = NoiseModel.parse("N=1 + K=0.0031622776601683794")
PLACES = 32_768


def _series(samples: FloatArray, keep: NDArray[np.bool_] | None = None) -> AxisSeries:
    series = AxisSeries.from_samples(samples, rate_hz=100.0)
    return series if keep is None else series.keeping(keep)


def _scattered(rng: np.random.Generator, places: int = PLACES) -> NDArray[np.bool_]:
    return rng.random(places) >= 0.1


def _bursts(rng: np.random.Generator, number: int, share: float, places: int = PLACES) -> NDArray[np.bool_]:
    keep, length = np.ones(places, dtype=bool), int(share * places)
    for start in rng.integers(0, places - length, number):
        keep[start : start + length] = False
    return keep


def _naive_windows(samples: FloatArray, keep: NDArray[np.bool_], m: int) -> float:
    """Return half the mean square of differences between window means of the present samples."""
    squares = []
    for start in range(samples.size - 2 * m + 1):
        parts = [slice(start, start + m), slice(start + m, start + 2 * m)]
        if all(keep[part].sum() >= m / 2 for part in parts):
            first, second = (samples[part][keep[part]].mean() for part in parts)
            squares.append((second - first) ** 2)
    return float(np.mean(squares) / 2)


def _naive_pairs(samples: FloatArray, keep: NDArray[np.bool_], m: int) -> float:
    """Return the Allan variance from the mean square differences of all present pairs."""
    total = 0.0
    for k in range(1, 2 * m):
        both = keep[k:] & keep[:-k]
        mean_square = float(np.mean((samples[k:] - samples[:-k])[both] ** 2))
        total += (2 * m - k - 4 * max(m - k, 0)) * mean_square
    return float(total / (2 * m * m))


def test_windows_agree_with_their_definition() -> None:
    """Before the correction for losses, a loop over all pairs of windows agrees to rounding."""
    rng = np.random.default_rng(1)
    samples, keep = MODEL.simulate(500, rate_hz=1.0, rng=rng) + 9.8, _scattered(rng, 500)
    keep[0] = keep[-1] = True
    m = np.array([1, 2, 7, 50, 200])
    found = window_variances(_series(samples, keep), m)
    npt.assert_allclose(
        found.avar * found.inflation, [_naive_windows(samples, keep, k) for k in m.tolist()], rtol=1e-10
    )


def test_windows_far_from_gaps_agree_with_their_definition() -> None:
    """With few gaps, full windows are summed without counting their samples."""
    rng = np.random.default_rng(31)
    samples, keep = MODEL.simulate(90_000, rate_hz=1.0, rng=rng) - 9.8, np.ones(90_000, dtype=bool)
    for start, length in ((20_000, 1), (41_000, 700), (41_900, 5000)):
        keep[start : start + length] = False
    integral = np.concatenate([[0.0], np.cumsum(np.where(keep, samples - samples[keep].mean(), 0.0))])
    filled = np.concatenate([[0], np.cumsum(keep)])
    m = np.array([1, 64, 500, 9000, 22_000])
    found = window_variances(_series(samples, keep), m)
    for i, k in enumerate(m.tolist()):
        sums, sizes = integral[k:] - integral[:-k], filled[k:] - filled[:-k]
        both = (sizes[k:] >= k * keep.mean() / 2) & (sizes[:-k] >= k * keep.mean() / 2)
        means = sums / np.maximum(sizes, 1)
        assert found.terms[i] == both.sum()
        expected = np.mean((means[k:] - means[:-k])[both] ** 2) / 2
        npt.assert_allclose(found.avar[i] * found.inflation[i], expected, rtol=1e-8)


@pytest.mark.parametrize(("gaps", "length"), [(3, 200), (12, 5000)])
def test_shortcuts_for_long_records_are_accurate(
    gaps: int, length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Separate long runs agree with rows; fewer windows inside runs cost 1 % of the interval."""
    rng, n = np.random.default_rng(7741), 1_600_000
    samples = rng.standard_normal(n) + 2e-3 * rng.standard_normal(n).cumsum()
    keep = np.ones(n, dtype=bool)
    for start in rng.integers(0, n - length, gaps):
        keep[start : start + length] = False
    series, m = _series(samples, keep), 2 ** np.arange(0, 18, 3)
    found = window_variances(series, m)
    monkeypatch.setattr(variance, "_LONG", n)
    rows = window_variances(series, m)
    npt.assert_array_equal(found.terms, rows.terms)
    npt.assert_allclose(found.avar, rows.avar, rtol=1e-9)
    monkeypatch.setattr(variance, "_MAX_SPACING", 1)
    monkeypatch.setattr(variance, "_MIN_WINDOWS", n)
    every = window_variances(series, m)
    npt.assert_array_less(np.abs(rows.avar / every.avar - 1), 0.01 * 4 * np.sqrt(1.5 * m / n))
    assert np.any(rows.avar != every.avar)


def test_windows_agree_with_the_estimator_from_all_pairs() -> None:
    """It is independent and unbiased; both are precise at these averaging times."""
    rng = np.random.default_rng(10)
    samples, keep = MODEL.simulate(20_000, rate_hz=1.0, rng=rng), _scattered(rng, 20_000)
    keep[0] = keep[-1] = True
    m = np.array([1, 2, 4, 8, 16])
    pairs = [_naive_pairs(samples, keep, k) for k in m.tolist()]
    # The weights of pairs differ, which causes 1 to 2 % with 20,000/m windows.
    npt.assert_allclose(window_variances(_series(samples, keep), m).avar, pairs, rtol=0.03)


def test_values_without_gaps_are_exact() -> None:
    """There is no correction for losses."""
    samples = MODEL.simulate(4096, rate_hz=1.0, rng=np.random.default_rng(2))
    m = np.array([1, 4, 64])
    found = window_variances(_series(samples), m)
    npt.assert_allclose(found.avar, variances(samples, m), rtol=1e-11)
    npt.assert_allclose(found.inflation, 1.0)


def _pattern(kind: str, rng: np.random.Generator, places: int) -> NDArray[np.bool_]:
    match kind:
        case "10 % scattered":
            keep = _scattered(rng, places)
        case "20 bursts of 0.5 %":
            keep = _bursts(rng, 20, 0.005, places)
        case "5 bursts of 4 %":
            keep = _bursts(rng, 5, 0.04, places)
        case _:
            keep = np.ones(places, dtype=bool)
            for start in rng.integers(0, places - 8, places // 80):
                keep[start : start + 8] = False
    keep[0] = keep[-1] = True
    return keep


@pytest.mark.parametrize(
    "kind",
    first_by_default(["10 % scattered", "20 bursts of 0.5 %", "5 bursts of 4 %", "many bursts of 8"], 2),
)
def test_values_are_unbiased(kind: str) -> None:
    """The mean over 60 series with N and K is right to four standard errors at m = 1, 16, 256, 1024.

    The full study is in docs/results/accuracy.md.
    """
    rng, m = np.random.default_rng(3), np.array([1, 16, 256, 1024])
    true = MODEL.avar(m.astype(np.float64), rate_hz=1.0)
    ratios = []
    for _ in range(60):
        series = _series(MODEL.simulate(PLACES, rate_hz=1.0, rng=rng), _pattern(kind, rng, PLACES))
        ratios.append(window_variances(series, m).avar / true)
    error = np.std(ratios, axis=0) / np.sqrt(60)
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1) < 4 * error)


@pytest.mark.parametrize("share", [0.1, 0.6])
def test_random_losses_do_not_bias_white_noise(share: float) -> None:
    """The shares of lost samples are 10 and 60 %."""
    rng, m = np.random.default_rng(11), np.array([1, 2, 3, 10, 100])
    ratios = []
    for _ in range(40):
        keep = rng.random(8192) >= share
        ratios.append(window_variances(_series(rng.standard_normal(8192), keep), m).avar * m)
    error = np.std(ratios, axis=0) / np.sqrt(40)
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1) < 4 * error)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["10 % scattered", "5 bursts of 4 %", "many bursts of 8"])
def test_intervals_with_gaps_have_the_nominal_coverage(kind: str) -> None:
    """In 150 series of 4096 samples it is 87 to 100 % at every octave and 92 to 98 % on average."""
    rng = np.random.default_rng(4)
    covered, count = np.zeros((2, 11))
    for _ in range(150):
        samples = MODEL.simulate(4096, rate_hz=100.0, rng=rng)
        curve = allan_curve(_series(samples, _pattern(kind, rng, 4096)))
        true = np.sqrt(MODEL.avar(curve.m.astype(np.float64), rate_hz=100.0))
        low, high = curve.confidence_interval(0.95)
        there = np.isin(2 ** np.arange(11), curve.m)
        covered[there] += (low <= true) & (true <= high)
        count[there] += 1
    assert count.min() > 120
    share = covered / count
    assert share.min() > 0.95 - 4.5 * np.sqrt(0.95 * 0.05 / 150)
    assert 0.92 < share.mean() < 0.98


def test_no_value_has_less_than_one_degree_of_freedom() -> None:
    """With half of 64 samples lost, the longest averages have exactly one."""
    rng = np.random.default_rng(0)
    keep = rng.random(64) >= 0.5
    keep[0] = keep[-1] = True
    edf = allan_curve(_series(rng.standard_normal(64), keep)).edf
    assert edf[-1] == 1.0
    assert np.all(edf >= 1.0)


def test_isolated_samples_are_rejected() -> None:
    """Three samples far apart have no adjacent windows."""
    keep = np.zeros(2001, dtype=bool)
    keep[[0, 500, 2000]] = True
    with pytest.raises(DataError) as caught:
        allan_curve(_series(np.random.default_rng(5).standard_normal(2001), keep), taus=[0.01])
    assert str(caught.value) == (
        "gyro_x: too many samples are missing for an Allan variance: 3 of 2001 are present, without "
        "filled neighbouring windows or positive values"
    )


def test_a_constant_with_gaps_has_a_curve_of_zeros() -> None:
    """The screening reports a stuck sensor; here its variance is zero."""
    keep = np.arange(1000) % 7 != 3
    curve = allan_curve(_series(np.full(1000, 9.81), keep))
    npt.assert_allclose(curve.avar, 0.0, atol=1e-25)
    assert np.all(np.isfinite(curve.edf))


def test_separate_rests_use_differences_inside_runs_only() -> None:
    """The value is the mean over runs weighted by their differences, so a jump between runs has no effect."""
    samples = np.random.default_rng(6).standard_normal(3000)
    samples[1100:] += 50.0
    keep = np.ones(3000, dtype=bool)
    keep[1000:1100] = False
    series, m = _series(samples, keep), np.array([1, 5, 100])
    first, second = samples[:1000], samples[1100:]
    first_terms, second_terms = 1001 - 2 * m, 1901 - 2 * m
    sums = first_terms * variances(first, m) + second_terms * variances(second, m)
    expected = sums / (first_terms + second_terms)
    npt.assert_allclose(run_variances(series, m).avar, expected, rtol=1e-9)
    curve = allan_curve(replace(series, clock=replace(series.clock, apart=True)))
    assert curve.computed == "runs"
    assert curve.m[-1] == 256
    assert longest_run(series.clock) == 1900


def test_adjacent_segments_are_one_run() -> None:
    """Two files of a recording may be contiguous; here a third follows after a gap."""
    segments = ((0, 400, 0), (400, 1000, 400), (1000, 1500, 1007))
    parts = tuple(Segment(start=start, stop=stop, offset=offset) for start, stop, offset in segments)
    samples = np.random.default_rng(8).standard_normal(1500)
    clock = Clock(source="given rate", rate_hz=100.0, segments=parts)
    series = replace(_series(samples), clock=clock)
    assert longest_run(clock) == 1000
    found = run_variances(series, np.array([1, 20, 300]))
    npt.assert_array_equal(found.terms, [999 + 499, 961 + 461, 401])


def test_a_factor_too_long_for_every_run_is_omitted() -> None:
    """Runs of 40 samples have no second difference of 21."""
    keep = np.ones(1000, dtype=bool)
    keep[40::41] = False
    series = _series(np.random.default_rng(7).standard_normal(1000), keep)
    npt.assert_array_equal(run_variances(series, np.array([1, 20, 21])).m, [1, 20])


def _naive_added(samples: FloatArray, keep: NDArray[np.bool_], m: int) -> float:
    """Return the contribution of losses to `_naive_windows`, from loops over windows and lags."""
    n = samples.size
    fewest = max(keep.mean() / 2 * m, 1.0)
    centred = np.where(keep, samples - samples[keep].mean(), 0.0)
    lost, count, scatter, freedom = 0.0, 0, 0.0, 0
    for start in range(n - 2 * m + 1):
        parts = [slice(start, start + m), slice(start + m, start + 2 * m)]
        for part in parts:
            scatter += float(np.sum(np.square(centred[part][keep[part]])))
            filled = int(keep[part].sum())
            scatter -= float(centred[part].sum()) ** 2 / max(filled, 1)
            freedom += max(filled - 1, 0)
        sizes = [int(keep[part].sum()) for part in parts]
        if min(sizes) >= fewest:
            lost += 1 / sizes[0] + 1 / sizes[1] - 2 / m
            count += 1
    inside = scatter / freedom if freedom else 0.0
    edges = np.flatnonzero(np.diff(keep.astype(int)))
    lengths = (edges[1::2] - edges[::2]).tolist()
    total = 0.0
    for k in range(min(m, 4 * int(np.ceil(np.mean(lengths))))):
        both = keep[k:] & keep[: n - k]
        share = (both.sum() / (n - k) - keep.mean() ** 2) / (keep.mean() - keep.mean() ** 2)
        apart = np.mean(np.square((samples[k:] - samples[: n - k])[both]))
        total += (2 if k else 1) * (1 - k / m) * share * (inside - apart / 2)
    return lost / count / 2 * total


@pytest.mark.parametrize("share", [0.3, 0.75])
def test_the_contribution_of_losses_agrees_with_its_definition(share: float) -> None:
    """For bursts of about three samples and slow noise, loops over windows and lags agree to rounding.

    If less than half is present, a window needs only half of that share.
    """
    rng, n = np.random.default_rng(21), 400
    samples = MODEL.simulate(n, rate_hz=1.0, rng=rng).cumsum()
    keep = np.repeat(rng.random(n // 2) < share, 2)
    keep[0] = keep[-1] = True
    m = np.array([2, 3, 10, 40])
    found = window_variances(_series(samples, keep), m)
    added = [_naive_added(samples, keep, k) for k in m.tolist()]
    npt.assert_array_equal(found.m, m)
    npt.assert_allclose(found.avar * (found.inflation - 1), added, rtol=1e-8)
    assert np.all(np.abs(found.inflation - 1) > 1e-3)


def test_negative_values_and_values_without_differences_are_omitted() -> None:
    """Zeros of a constant are kept, and an inflation is at least 1."""
    found = _positive(
        np.array([1, 2, 3, 4, 5]),
        np.array([2.0, -1.0, 0.0, 1.0, 3.0]),
        np.array([1.0, 9.0, 9.0, 0.0, 9.0]),
        np.array([3.0, 1.0, 0.0, 1.0, 2.7]),
    )
    npt.assert_array_equal(found.m, [1, 3, 5])
    npt.assert_array_equal(found.avar, [2.0, 0.0, 3.0])
    npt.assert_array_equal(found.terms, [1.0, 9.0, 9.0])
    npt.assert_array_equal(found.inflation, [1.5, 1.0, 1.0])


def test_the_pattern_of_losses_is_computed_in_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairs are inside chunks of 64 samples, the last one shorter; loops over chunks and lags agree."""
    monkeypatch.setattr(variance, "_CHUNK", 64)
    rng, n = np.random.default_rng(22), 150
    samples, keep = rng.standard_normal(n).cumsum(), np.repeat(rng.random(n // 3) < 0.6, 3)
    keep[0] = keep[-1] = True
    found = variance._pattern(_series(samples, keep))
    share, correlation, structure = keep.mean(), [], []
    for k in range(found[0].size):
        pairs, possible, squares = 0, 0, 0.0
        for start in range(0, n, 64):
            seen, values = keep[start : start + 64], samples[start : start + 64]
            both = seen[k:] & seen[: seen.size - k]
            pairs, possible = pairs + int(both.sum()), possible + both.size
            squares += float(np.sum(np.square((values[k:] - values[: seen.size - k])[both])))
        correlation.append(pairs / possible - share**2)
        structure.append(squares / pairs)
    npt.assert_allclose(found[0], np.array(correlation) / correlation[0], rtol=1e-9)
    npt.assert_allclose(found[1], structure, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("length", "count", "lags"), [(0, 0, 1), (1, 30, 4), (3, 20, 12), (70, 2, 256), (300, 2, 256)]
)
def test_the_pattern_covers_four_mean_gaps(length: int, count: int, lags: int) -> None:
    """There is at least one lag, and at most 256 or the length of the record."""
    keep = np.ones(1000, dtype=bool)
    for start in range(10, 10 + count * (length + 2), length + 2):
        keep[start : start + length] = False
    found = variance._pattern(_series(np.random.default_rng(23).standard_normal(1000), keep))
    assert [part.size for part in found] == [lags, lags]
