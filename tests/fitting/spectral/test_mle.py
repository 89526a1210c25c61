"""Tests of maximum likelihood, from samples to a NoiseFit."""

import json

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import DataError
from imucal.recording import AxisSeries
from tests.fitting.fits import fitted, simulated

#: True models of two records of 2e5 samples at 100 Hz; every term is well above its detection limit.
PLAIN = "N=1e-3 + B=2e-3 + K=6e-4"
RICH = "Q=1e-5 + N=1e-3 + GM(sigma=2e-3, T=3) + K=3e-4"


@pytest.mark.parametrize("text", [PLAIN, RICH])
def test_model_and_values_are_found(text: str) -> None:
    """The true values are within four standard errors and inside the 99.99 % intervals."""
    result = fitted(simulated(text, 200_000, 1, rate_hz=100.0), rate_hz=100.0, level=0.9999)
    truth = dict(part.split("=") for part in text.split(" + ") if "GM" not in part)
    assert str(result.model) == (" + ".join(p.split("=")[0].split("(")[0] for p in text.split(" + ")))
    deviation = dict(zip(result.parameters, np.sqrt(np.diag(result.covariance)), strict=True))
    found = {term.symbol: term.coefficient for term in result.model.terms}
    for key, value in truth.items():
        assert abs(found[key] - float(value)) < 4 * deviation[key]
        assert result[key].low < float(value) < result[key].high


def test_a_gauss_markov_term_has_intervals_for_sigma_and_time() -> None:
    """Both true values are inside their 99.99 % intervals."""
    result = fitted(simulated(RICH, 200_000, 1, rate_hz=100.0), rate_hz=100.0, level=0.9999)
    found = result["GM"]
    assert found.correlation_time is not None
    assert found.low < 2e-3 < found.high
    assert found.correlation_time.low < 3.0 < found.correlation_time.high


@pytest.mark.parametrize("gain", [-1e-9, 1e9])
def test_scaling_the_samples_only_scales_the_estimates(gain: float) -> None:
    """Model, times, goodness of fit and bounds agree to rounding."""
    samples = simulated(RICH, 30_000, 2, rate_hz=100.0)
    plain, scaled = fitted(samples, rate_hz=100.0), fitted(gain * samples, rate_hz=100.0)
    assert str(plain.model) == str(scaled.model)
    assert scaled.goodness.statistic == pytest.approx(plain.goodness.statistic, rel=1e-5, abs=1e-5)
    for before, after in zip(plain.estimates, scaled.estimates, strict=True):
        assert (before.key, before.status) == (after.key, after.status)
        # Limits are exact to a hundredth of a standard error, and rounding changes the path to them.
        npt.assert_allclose(after.high, abs(gain) * before.high, rtol=1e-3)
        if before.value is not None:
            assert after.value == pytest.approx(abs(gain) * before.value, rel=1e-5)


def test_an_offset_has_no_effect() -> None:
    """The fit estimates the mean of the samples."""
    samples = simulated(PLAIN, 30_000, 3, rate_hz=100.0)
    plain, moved = fitted(samples, rate_hz=100.0), fitted(samples + 9.81, rate_hz=100.0)
    npt.assert_allclose([e.high for e in moved.estimates], [e.high for e in plain.estimates], rtol=1e-4)


def test_the_rate_only_changes_units() -> None:
    """At ten times the rate, N is divided by sqrt(10), K is multiplied by it, and B stays the same."""
    samples = simulated(PLAIN, 100_000, 4, rate_hz=100.0)
    slow = fitted(samples, "N + B + K", rate_hz=100.0)
    fast = fitted(samples, "N + B + K", rate_hz=1000.0)
    factors = {"N": 10**-0.5, "B": 1.0, "K": 10**0.5}
    for key, factor in factors.items():
        assert fast[key].value == pytest.approx(factor * (slow[key].value or 0.0), rel=1e-9)


def test_the_fit_is_deterministic() -> None:
    """Two fits of the same samples are equal to the last bit."""
    samples = simulated(RICH, 20_000, 5, rate_hz=100.0)
    first, second = fitted(samples), fitted(samples)
    assert first.estimates == second.estimates
    npt.assert_array_equal(first.covariance, second.covariance)


@pytest.mark.parametrize(
    ("model", "keys"),
    [
        ("N", ["N", "B", "K"]),
        ("N + B + K", ["N", "B", "K"]),
        ("N + 2*GM + K", ["N", "B", "GM1", "GM2", "K"]),
        ("Q + N + K + R", ["Q", "N", "B", "K", "R"]),
        ("B", ["N", "B", "K"]),
    ],
)
def test_a_given_model_is_fitted_and_n_b_k_are_always_reported(model: str, keys: list[str]) -> None:
    """Each term has an estimate or an upper bound."""
    result = fitted(simulated("N=1 + K=0.02 + B=0.1", 20_000, 6), model)
    assert [e.key for e in result.estimates] == keys
    assert result.criterion == "given"
    for estimate in result.estimates:
        assert np.isfinite(estimate.high)
        assert estimate.low >= 0
        assert (estimate.status == "bounded") == (estimate.value is None)


def test_absent_terms_have_an_upper_bound() -> None:
    """White noise has no B and no K, so the fit reports how large they might be."""
    result = fitted(simulated("N=1", 50_000, 7))
    assert str(result.model) == "N"
    for key in ("B", "K"):
        assert result[key].status == "bounded"
        assert 0 < result[key].high < 0.1


def test_a_bounded_term_is_removed_from_a_given_model() -> None:
    """A given K that is not detected keeps its bound, but the model omits it."""
    result = fitted(simulated("N=1", 20_000, 8), "N + K")
    assert str(result.model) == "N"
    assert result["K"].status == "bounded"
    assert result.parameters == ("N",)


def test_one_of_two_exchangeable_terms_is_kept() -> None:
    """Either B or K can be omitted, but the data need one of them."""
    result = fitted(simulated("N=1 + K=0.012", 3000, 4), "N + B + K")
    assert result.goodness.statistic < 3
    assert {result["B"].status, result["K"].status} == {"estimated", "bounded"}


def test_undetected_gauss_markov_terms_are_numbered_too() -> None:
    """Two given Gauss-Markov terms are bounded in white noise, each with its own key."""
    result = fitted(simulated("N=1", 20_000, 15), "N + 2*GM")
    assert [e.key for e in result.estimates] == ["N", "B", "GM1", "GM2", "K"]
    assert str(result.model) == "N"
    one = fitted(simulated("N=1 + GM(sigma=1, T=50)", 20_000, 15), "N + 2*GM")
    assert one["GM1"].status == "estimated"
    assert one.parameters[:2] == ("N", "GM1.sigma")


def test_near_models_are_reported() -> None:
    """The chosen model comes first with delta 0; the others follow in order up to a delta of 6."""
    result = fitted(simulated("N=1 + B=0.05 + K=1e-3", 100_000, 9))
    deltas = [c.delta for c in result.candidates]
    assert deltas[0] == 0
    assert deltas == sorted(deltas)
    assert deltas[-1] <= 6
    assert result.candidates[0].structure == str(result.model)


def test_the_covariance_is_positive_definite_and_named() -> None:
    """It has one row per parameter, and correlations are between -1 and 1."""
    result = fitted(simulated(RICH, 100_000, 10, rate_hz=100.0), "Q + N + GM + K", rate_hz=100.0)
    assert result.parameters == ("Q", "N", "K", "GM.sigma", "GM.T")
    assert np.all(np.linalg.eigvalsh(result.correlation) > 0)
    assert np.all(np.abs(result.correlation) <= 1 + 1e-12)


def test_settings_are_json_values() -> None:
    """A report contains the settings that the fit used."""
    result = fitted(simulated(PLAIN, 10_000, 11))
    assert json.loads(json.dumps(dict(result.settings))) == dict(result.settings)


def test_a_short_record_has_a_wide_interval_of_n_and_bounds() -> None:
    """One hundred samples determine only N."""
    result = fitted(simulated("N=1", 100, 12))
    assert result["N"].low < 1 < result["N"].high
    assert all(np.isfinite(e.high) for e in result.estimates)


def test_too_few_samples_are_rejected() -> None:
    """The error states how many there are and how many are needed."""
    with pytest.raises(DataError) as caught:
        fitted(np.arange(20.0))
    assert str(caught.value) == (
        "gyro_x: 20 samples, expected at least 64 for a noise model; record for longer"
    )


@pytest.mark.parametrize("level", [0.0, 9.81])
def test_constant_samples_are_rejected(level: float) -> None:
    """A sensor whose last digit does not change has no noise to model."""
    with pytest.raises(DataError) as caught:
        fitted(np.full(1000, level))
    assert str(caught.value) == (
        "gyro_x: all 1000 samples are equal, expected noise; "
        "check that the sensor was on and that its resolution shows its noise"
    )


@pytest.mark.parametrize(
    "samples",
    [
        np.where(np.arange(5000) % 2 == 0, 1.0, -1.0),
        np.arange(5000.0),
        np.sin(np.arange(5000) / 40),
        np.concatenate([np.zeros(4000), np.ones(1000)]),
        np.round(np.random.default_rng(1).standard_normal(5000) / 3),
        np.random.default_rng(2).standard_cauchy(5000),
    ],
    ids=["alternating", "line", "sine", "step", "coarse", "cauchy"],
)
@pytest.mark.filterwarnings("error")
def test_unusual_samples_give_finite_numbers_or_an_error(samples: np.typing.NDArray[np.float64]) -> None:
    """No estimate is NaN, whatever the samples are."""
    try:
        result = fitted(samples)
    except DataError:
        return
    for estimate in result.estimates:
        assert np.isfinite(estimate.low)
        assert not np.isnan(estimate.high)
        assert estimate.value is None or np.isfinite(estimate.value)
    assert np.isfinite(result.goodness.statistic)


def test_the_fit_uses_the_full_curve_without_a_filter() -> None:
    series = AxisSeries.from_samples(simulated("N=1", 5000, 13), rate_hz=1.0)
    npt.assert_array_equal(fitted(series).used, [0, 1])


@pytest.mark.parametrize(("offset", "slope"), [(0.0, 1.0), (9.8, 1e-3), (0.0, 7.7)])
def test_a_straight_line_is_rejected(offset: float, slope: float) -> None:
    """A counter that was mistaken for an axis contains no noise; the error explains it for every step."""
    with pytest.raises(DataError) as caught:
        fitted(offset + slope * np.arange(2000.0))
    assert str(caught.value) == (
        "gyro_x: all 2000 samples are on one straight line, expected noise; "
        "check that the column holds a measurement and not a counter"
    )
