"""Tests of the joint fit of several records of one unit from their bins."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from scipy import signal

import imucal
from imucal import DataError, NoiseFit, PooledFit
from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.blocks import bin_blocks, make_blocks, ordinates_of
from imucal.fitting.spectral.given_model import BinFit, fit_bins
from imucal.recording import AxisSeries, Sensor
from tests.fleet.records import RATE, bins_from, fit_of, quick_fit, simulated
from tests.slow_cases import first_by_default

TRUTH = {"N": 1e-3, "K": 4e-4}
TEXT = "N=1e-3 + K=4e-4"
#: Number of pools, records per pool and samples per record.
POOLS, RECORDS, SAMPLES = 30, 3, 2000


@pytest.fixture(scope="module")
def pools() -> list[PooledFit]:
    """Return pools of records with one truth."""
    return [
        imucal.pool([quick_fit(simulated(TEXT, SAMPLES, 31, i, j)) for j in range(RECORDS)], model="N + K")
        for i in range(POOLS)
    ]


def one_record(parts: list[FloatArray]) -> FloatArray:
    """Return the parts as one record with long gaps of different lengths between them."""
    pieces = [parts[0]]
    for number, part in enumerate(parts[1:], 1):
        pieces += [np.full(400 * number, np.nan), part]
    return np.concatenate(pieces)


@pytest.mark.parametrize("model", ["N + B + K", "N + GM", "N + K + R"])
@pytest.mark.parametrize("scale", first_by_default([77.0, 1.0], 1))
def test_a_pool_equals_the_fit_of_one_record_with_long_gaps(model: str, scale: float) -> None:
    """All numbers agree, although each record has its own scale."""
    parts = [
        simulated("N=1e-3 + GM(sigma=2e-3, T=0.5) + K=4e-4", n, 5, n) * scale for n in (6000, 4000, 7500)
    ]
    whole = fit_of(one_record(parts), model)
    pooled = imucal.pool([fit_of(part, model) for part in parts], model=model)
    assert not any(test.differs for test in pooled.homogeneity)
    assert [e.key for e in pooled.estimates] == [e.key for e in whole.estimates]
    for ours, theirs in zip(pooled.estimates, whole.estimates, strict=True):
        assert ours.status == theirs.status
        npt.assert_allclose(ours.value or 0.0, theirs.value or 0.0, rtol=1e-6)
        npt.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], rtol=1e-6)
    npt.assert_allclose(pooled.goodness.statistic, whole.goodness.statistic, rtol=1e-6)
    assert str(pooled.model) == str(whole.model)


def test_bins_contain_the_exact_ordinates() -> None:
    """Short and long gaps reduce the information of some blocks."""
    samples = one_record([simulated(TEXT, 3000, 6), simulated(TEXT, 2000, 7)])
    samples[100:140] = np.nan
    found = fit_of(samples)
    blocks = make_blocks(AxisSeries.from_samples(samples, rate_hz=RATE).finite())
    whole = bin_blocks(blocks.blocks, blocks.scale)
    assert found.bins is not None
    again = ordinates_of(found.bins)
    for name in ("size", "power", "lam", "length", "sign", "basis", "cross", "gram"):
        npt.assert_array_equal(getattr(again, name), getattr(whole, name))


@pytest.mark.slow
def test_limits_have_the_nominal_coverage(pools: list[PooledFit]) -> None:
    """The tolerance is three standard errors."""
    least = 0.95 - 3 * np.sqrt(0.95 * 0.05 / POOLS)
    for key, truth in TRUTH.items():
        assert np.mean([p[key].low <= truth <= p[key].high for p in pools]) >= least


def test_equal_records_rarely_differ(pools: list[PooledFit]) -> None:
    """About 5 % of the pools differ, and the mean statistic is the degrees of freedom."""
    most = 0.05 + 3 * np.sqrt(0.95 * 0.05 / POOLS)
    for key in TRUTH:
        tests = [next(t for t in p.homogeneity if t.key == key) for p in pools]
        assert np.mean([t.differs for t in tests]) <= most
    white = [p.homogeneity[0].statistic for p in pools]
    dof = RECORDS - 1
    assert abs(np.mean(white) - dof) < 3 * np.sqrt(2 * dof / POOLS)


def test_a_different_record_is_found_and_widens_the_interval() -> None:
    """N is 10 % larger in one record; the limits are much wider than for equal records."""
    fits = [quick_fit(simulated(TEXT, 6000, 8, i)) for i in range(3)]
    odd = [*fits, quick_fit(simulated("N=1.1e-3 + K=4e-4", 6000, 8, 9))]
    same, pooled = imucal.pool(fits), imucal.pool(odd)
    white = pooled.homogeneity[0]
    assert white.key == "N"
    assert white.differs
    assert white.p_value < 1e-6
    assert 0.02 < white.spread < 0.1
    assert pooled["N"].widening > 2
    assert pooled["N"].low < min(same["N"].low, 1e-3)
    assert pooled["N"].high > 1.05e-3
    assert [finding.code for finding in pooled.findings] == ["records-differ"]
    assert not same.findings
    assert not same["N"].widening > 1
    assert pooled.model.terms[0].values[0] == pooled["N"].value


def test_a_step_of_one_record_does_not_affect_the_others() -> None:
    """It is removed from its record only, and the test compares the remaining noise."""
    rng = np.random.default_rng(32)
    parts = [simulated("N=1e-3", 4000, 33, i) for i in range(2)]
    stepped = parts[0] + np.where(np.arange(4000) < 2000 + int(rng.integers(100)), 0.0, 5e-3)
    with_step, plain = (fit_of(part, "N + K") for part in (stepped, parts[1]))
    assert with_step.bins is not None
    assert any(name.startswith("step") for name in with_step.bins.names)
    pooled = imucal.pool([with_step, plain], model="N + K")
    same = imucal.pool([fit_of(part, "N + K") for part in parts], model="N + K")
    for ours, theirs in zip(pooled.homogeneity, same.homogeneity, strict=True):
        assert ours.p_value == pytest.approx(theirs.p_value, abs=0.1)
        assert 0 <= ours.statistic < 10


def test_a_negative_mean_square_is_an_upper_bound() -> None:
    """Squares of a weak term may all be negative; the joint bound is finite and the spread too."""
    pooled = imucal.pool(
        [
            quick_fit(simulated(f"N={n} + B=2e-4 + K=1e-4", 2000, 92, 7, i))
            for i, n in enumerate((1e-3, 1e-3, 1.4e-3))
        ]
    )
    assert pooled.homogeneity[0].differs
    assert all(np.isfinite(test.spread) for test in pooled.homogeneity)
    weak = [estimate for estimate in pooled.estimates if estimate.value is None]
    assert weak
    assert all(estimate.low == 0 < estimate.high for estimate in weak)


def test_a_filter_of_one_record_is_not_used_for_all() -> None:
    """Of three records with different N, one is behind a filter; no filter fits all, in any order."""
    corner = np.exp(-2 * np.pi * 15 / RATE)
    behind = signal.lfilter([1 - corner], [1, -corner], simulated("N=1e-3 + K=2e-5", 4000, 94, 0))
    records = [
        *(simulated(f"N={n} + K=2e-5", 4000, 97, 0, i) for i, n in enumerate((1e-3, 1.5e-3))),
        np.asarray(behind),
    ]
    assert fit_of(records[2]).response is not None
    for order in ((0, 1, 2), (2, 0, 1)):
        assert _joint([records[i] for i in order]).band.poles == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_known_band_gives_the_same_values_as_a_search(seed: int) -> None:
    """The fit of filtered samples contains the band; a fit with a chosen model requires a search."""
    corner = np.exp(-2 * np.pi * (8 + 4 * seed) / RATE)
    behind = signal.lfilter([1 - corner], [1, -corner], simulated("N=1e-3 + K=2e-4", 3000, 95, seed))
    fit = fit_of(np.asarray(behind))
    assert fit.settings["response_coefficients"]
    assert fit.criterion == "given"
    assert imucal.log_values("u", fit) == imucal.log_values("u", replace(fit, criterion="chance"))


def test_a_random_walk_in_only_one_record_is_found() -> None:
    """Most records lack the weak term, so the joint interval includes zero."""
    still = [quick_fit(simulated("N=1e-3", 6000, 10, i)) for i in range(3)]
    pooled = imucal.pool([*still, quick_fit(simulated("N=1e-3 + K=3e-3", 6000, 10, 9))])
    assert next(t for t in pooled.homogeneity if t.key == "K").differs
    assert pooled["K"].widening > 1
    assert pooled["K"].low == 0
    assert pooled["K"].high > 1.5e-3


@pytest.mark.slow
def test_widened_limits_cover_the_mean_of_scattered_records() -> None:
    """N scatters by 25 % between records, and the limits cover the median unit's value."""
    rng = np.random.default_rng(12)
    covered = []
    for i in range(16):
        values = 1e-3 * np.exp(0.25 * rng.standard_normal(3))
        fits = [quick_fit(simulated(f"N={value}", 1000, 13, i, j)) for j, value in enumerate(values)]
        found = imucal.pool(fits, model="N")["N"]
        covered.append(found.low <= 1e-3 <= found.high)
    assert np.mean(covered) >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 16)


def _joint(records: list[FloatArray]) -> BinFit:
    return fit_bins([bins_from(record) for record in records], ("N", "B", "K"), level=0.95)


@pytest.mark.parametrize("factor", [2.0**-9, 10.0])
def test_pooled_estimates_scale_with_the_samples(factor: float) -> None:
    """Probabilities stay the same, and squared coefficients scale with the square."""
    records = [simulated(TEXT, 3000, 15, i) for i in range(2)]
    plain, scaled = (imucal.pool([quick_fit(k * one) for one in records]) for k in (1.0, factor))
    for ours, theirs in zip(scaled.estimates, plain.estimates, strict=True):
        npt.assert_allclose([ours.low, ours.high], [factor * theirs.low, factor * theirs.high], rtol=1e-5)
    chances = [[test.p_value for test in pooled.homogeneity] for pooled in (scaled, plain)]
    npt.assert_allclose(chances[0], chances[1], rtol=1e-2)
    one, other = (imucal.log_values("u", quick_fit(k * records[0])) for k in (1.0, factor))
    weak = [key for key, value in one.items() if value.variance is not None]
    assert weak
    for key in weak:
        npt.assert_allclose(other[key].variance or 0, factor**2 * (one[key].variance or 0), rtol=1e-5)
        npt.assert_allclose(other[key].variance_sd or 0, factor**2 * (one[key].variance_sd or 0), rtol=1e-5)
        npt.assert_allclose(other[key].variance_growth, one[key].variance_growth, rtol=1e-5)


@pytest.mark.slow
def test_the_variance_of_a_weak_random_walk_is_unbiased() -> None:
    """The mean over 60 records is K², and the law at K² has their scatter; bounds alone would lose this."""
    text, truth = "N=1e-3 + B=6e-4 + K=2e-4", 2e-4**2
    values = [imucal.log_values("u", quick_fit(simulated(text, 10_000, 16, i)))["K"] for i in range(60)]
    assert sum(value.value is None for value in values) > 12
    squares = np.array([value.variance for value in values])
    deviations = np.array([(v.variance_sd or 0.0) + v.variance_growth * truth for v in values])
    assert np.sum(squares < 0) > 3
    scatter = float(np.std(squares, ddof=1))
    assert abs(np.mean(squares) - truth) < 2 * scatter / np.sqrt(60)
    # The scatter itself has a standard error of 9 %.
    assert 0.8 < np.mean(deviations) / scatter < 1.25


@pytest.mark.slow
def test_a_barely_detected_random_walk_is_pooled_without_bias() -> None:
    """K is one to two standard errors in each of 60 logs; low estimates must not get more weight.

    With standard errors at each log's own estimate, the mean square would be half the truth.
    """
    truth = 1e-4
    logs = [
        imucal.log_values(f"u{i}", quick_fit(simulated("N=9e-5 + K=1e-4", 4000, 91, i)))["K"]
        for i in range(60)
    ]
    squares = np.array([log.square for log in logs])
    weights = np.array([log.square_deviation(truth**2) for log in logs]) ** -2.0
    error = 1 / np.sqrt(weights.sum())
    assert 1 < truth**2 / (error * np.sqrt(60)) < 2
    assert abs(np.average(squares, weights=weights) - truth**2) < 2 * error
    found = imucal.population(logs)
    assert found.median.low <= truth <= found.median.high
    assert not any(unit.odd for unit in found.units)


def test_a_gauss_markov_term_keeps_its_correlation_time() -> None:
    """It equals the time in the log's fit; other terms have none."""
    fit = imucal.fit(
        imucal.AxisSeries.from_samples(simulated("N=1e-4 + GM(sigma=2e-3, T=2)", 20_000, 71), rate_hz=100.0),
        model="N + GM",
    )
    values = imucal.log_values("u", fit, model="N + GM")
    time = fit["GM"].correlation_time
    assert time is not None
    assert values["GM"].correlation_time == pytest.approx(time.value, rel=1e-6)
    assert values["N"].correlation_time is None


def test_a_population_accepts_values_of_logs() -> None:
    """The logs are weak; the limits of the median cover the truth, and each value has its unit's name."""
    logs = [imucal.log_values(f"u{i}", quick_fit(simulated(TEXT, 3000, 17, i))) for i in range(5)]
    assert logs[0]["N"].unit == "u0"
    found = imucal.population([log["N"] for log in logs])
    assert found.median.low <= 1e-3 <= found.median.high


def test_a_pool_of_one_record_equals_its_fit() -> None:
    """It has no homogeneity test."""
    record = fit_of(simulated(TEXT, 3000, 18))
    pooled = imucal.pool([record])
    assert pooled.records == 1
    assert pooled.homogeneity == ()
    npt.assert_allclose(pooled["N"].high, record["N"].high, rtol=1e-9)
    with pytest.raises(KeyError, match="the fit has N, B, K"):
        pooled["Q"]


def _other(kind: str, fit: NoiseFit) -> NoiseFit:
    changes: dict[str, dict[str, object]] = {
        "bins": {"bins": None},
        "rate": {"rate_hz": 200.0},
        "sensor": {"sensor": Sensor.ACCELEROMETER},
        "filter": {"response": Response(cutoff_hz=20.0)},
    }
    return replace(fit, **changes[kind])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("bins", "fit 2 of 2 .*: found no bins, expected .*with imucal.fit;"),
        ("rate", "fit 2 of 2: found 200 Hz, expected 100 Hz as in fit 1; pool records of one sampling rate"),
        ("sensor", "fit 2 of 2: found .*accelerometer, expected .* as in fit 1"),
        ("filter", "fit 2 of 2: found an output filter at 20 Hz, expected no output filter as in fit 1"),
    ],
)
def test_records_of_different_settings_are_rejected(kind: str, text: str) -> None:
    fit = quick_fit(simulated(TEXT, 500, 19))
    with pytest.raises(DataError, match=text):
        imucal.pool([fit, _other(kind, fit)])


@pytest.mark.parametrize(
    ("model", "level", "text"),
    [("auto", 0.95, "give the terms"), ("N + X", 0.95, "X"), ("N", 1.5, "level must be between 0 and 1")],
)
def test_model_selection_and_invalid_levels_are_rejected(model: str, level: float, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        imucal.pool([quick_fit(simulated(TEXT, 500, 19))], model=model, level=level)


def test_an_empty_pool_is_rejected() -> None:
    with pytest.raises(ValueError, match="found no fits, expected at least one"):
        imucal.pool([])
