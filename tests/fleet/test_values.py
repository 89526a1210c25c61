"""Tests of the values of a log for the statistics of a fleet: estimates, and squares without bias."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import imucal
from imucal.errors import DataError
from imucal.fleet.population import population
from imucal.fleet.values import log_values
from tests.fleet.records import RATE, fit_of, quick_fit, simulated

#: A model with weak terms.
TEXT = "N=1e-3 + B=6e-4 + K=2e-4"


@pytest.mark.parametrize("seed", range(4))
def test_a_known_band_gives_the_same_values_as_a_search(seed: int) -> None:
    """The fit of filtered samples contains the band; a fit with a chosen model requires a search."""
    corner = np.exp(-2 * np.pi * (8 + 4 * seed) / RATE)
    behind = signal.lfilter([1 - corner], [1, -corner], simulated("N=1e-3 + K=2e-4", 3000, 95, seed))
    fit = fit_of(np.asarray(behind))
    assert fit.settings["response_coefficients"]
    assert fit.criterion == "given"
    assert log_values("u", fit) == log_values("u", replace(fit, criterion="chance"))


@pytest.mark.slow
def test_the_variance_of_a_weak_random_walk_is_unbiased() -> None:
    """The mean over 60 records is K², and the law at K² has their scatter; bounds alone would lose this."""
    text, truth = "N=1e-3 + B=6e-4 + K=2e-4", 2e-4**2
    values = [log_values("u", quick_fit(simulated(text, 10_000, 16, i)))["K"] for i in range(60)]
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
    logs = [log_values(f"u{i}", quick_fit(simulated("N=9e-5 + K=1e-4", 4000, 91, i)))["K"] for i in range(60)]
    squares = np.array([log.square for log in logs])
    weights = np.array([log.square_deviation(truth**2) for log in logs]) ** -2.0
    error = 1 / np.sqrt(weights.sum())
    assert 1 < truth**2 / (error * np.sqrt(60)) < 2
    assert abs(np.average(squares, weights=weights) - truth**2) < 2 * error
    found = population(logs)
    assert found.median.low <= truth <= found.median.high
    assert not any(unit.odd for unit in found.units)


def test_a_gauss_markov_term_keeps_its_correlation_time() -> None:
    """It equals the time in the log's fit; other terms have none."""
    fit = imucal.fit(
        imucal.AxisSeries.from_samples(simulated("N=1e-4 + GM(sigma=2e-3, T=2)", 20_000, 71), rate_hz=100.0),
        model="N + GM",
    )
    values = log_values("u", fit, model="N + GM")
    time = fit["GM"].correlation_time
    assert time is not None
    assert values["GM"].correlation_time == pytest.approx(time.value, rel=1e-6)
    assert values["N"].correlation_time is None


def test_a_population_accepts_values_of_logs() -> None:
    """The logs are weak; the limits of the median cover the truth, and each value has its unit's name."""
    logs = [log_values(f"u{i}", quick_fit(simulated(TEXT, 3000, 17, i))) for i in range(5)]
    assert logs[0]["N"].unit == "u0"
    found = population([log["N"] for log in logs])
    assert found.median.low <= 1e-3 <= found.median.high


@pytest.mark.parametrize("factor", [2.0**-9, 10.0])
def test_values_scale_with_the_samples(factor: float) -> None:
    """Squares and their deviations scale with the square; growth does not."""
    record = simulated(TEXT, 4000, 21)
    one, other = (log_values("u", quick_fit(k * record)) for k in (1.0, factor))
    for key, value in one.items():
        scaled = other[key]
        assert scaled.high == pytest.approx(factor * value.high, rel=1e-5)
        assert scaled.variance == pytest.approx(factor**2 * (value.variance or 0.0), rel=1e-5)
        assert scaled.variance_sd == pytest.approx(factor**2 * (value.variance_sd or 0.0), rel=1e-5)
        assert scaled.variance_growth == pytest.approx(value.variance_growth, rel=1e-5)


def test_estimates_are_those_of_the_fit() -> None:
    """Of the same model and level."""
    fit = fit_of(simulated(TEXT, 8000, 22))
    for key, value in log_values("u", fit).items():
        assert (value.value is None) == (fit[key].value is None)
        assert value.value is None or value.value == pytest.approx(fit[key].value, rel=1e-6)
        assert (value.low, value.high) == pytest.approx((fit[key].low, fit[key].high), rel=1e-6)


def test_fits_without_bins_and_other_models_are_rejected() -> None:
    fit = quick_fit(simulated(TEXT, 500, 19))
    with pytest.raises(DataError, match=r"found no bins in a fit of method 'mle'.*with imucal.fit;"):
        log_values("u", replace(fit, bins=None))
    for model, level, text in (("auto", 0.95, "give the terms"), ("N + X", 0.95, "X"), ("N", 1.5, "level")):
        with pytest.raises(ValueError, match=text):
            log_values("u", fit, model=model, level=level)
