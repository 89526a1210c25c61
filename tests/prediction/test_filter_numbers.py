"""Tests of the two numbers of a filter: they cover the spectrum, are minimal and have closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS
from imucal.prediction import filter_numbers
from imucal.prediction.filter_numbers import correlation_times


@pytest.fixture(scope="module")
def drawn() -> NoiseFit:
    """Return a fit of white noise and flicker noise."""
    model = NoiseModel.parse("N=1e-3 + B=3e-4")
    samples = model.simulate(30_000, rate_hz=10.0, rng=np.random.default_rng(4201))
    return imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=10.0, sensor="gyroscope", axis="x"))


def known(drawn: NoiseFit, text: str) -> NoiseFit:
    """Return a fit whose model is known exactly."""
    model = NoiseModel.parse(text)
    estimates = []
    for i, term in enumerate(model.terms):
        time = getattr(term, "T", None)
        value = term.coefficient
        estimates.append(
            Estimate(
                key=f"{term.symbol}{i}",
                symbol=term.symbol,
                status="estimated",
                value=value,
                low=value,
                high=value,
                correlation_time=time and Interval(value=time, low=time, high=time),
            )
        )
    return replace(drawn, model=model, estimates=tuple(estimates), parameters=(), covariance=np.zeros((0, 0)))


@pytest.mark.parametrize(
    "text",
    [
        "N=1e-3 + B=3e-4 + K=3e-5",
        "Q=3e-4 + N=1e-3 + B=3e-4",
        "N=1e-3 + GM(sigma=1e-3, T=5)",
        "N=1e-3 + GM(sigma=4e-4, T=2) + GM(sigma=4e-4, T=200)",
    ],
)
@pytest.mark.parametrize("horizon", [60.0, 300.0])
def test_the_pair_covers_the_spectrum_and_nearly_touches_it(
    drawn: NoiseFit, text: str, horizon: float
) -> None:
    """The range is from a hundredth of the horizon's frequency to half the step's, with one equality."""
    pair = filter_numbers([known(drawn, text)], horizon_s=horizon)
    f = np.geomspace(0.01 / horizon, 0.5, 400)
    true = NoiseModel.parse(text).psd(f, rate_hz=1.0)
    covered = pair.white**2 + TERMS["K"].of(pair.walk).psd(f, 1.0)
    assert np.min(covered / true) == pytest.approx(1.0, abs=0.01)


def test_a_model_of_white_noise_and_random_walk_is_unchanged(drawn: NoiseFit) -> None:
    """It is the filter's own model."""
    pair = filter_numbers([known(drawn, "N=1e-3 + K=3e-5")])
    assert pair.white == pytest.approx(1e-3, rel=0.02)
    assert pair.walk == pytest.approx(3e-5, rel=0.02)
    assert all(ratio == pytest.approx(1.0, abs=0.02) for _, ratio in pair.ratios)


def test_flicker_is_covered_at_its_tangent(drawn: NoiseFit) -> None:
    """A pair that covers a psd of B²/omega everywhere has N_x K_x >= B²/2."""
    B = 3e-4
    pair = filter_numbers([known(drawn, f"N=1e-9 + B={B}")], step_s=0.01)
    assert pair.white * pair.walk == pytest.approx(B**2 / 2, rel=0.05)


@pytest.mark.parametrize("time", [3.0, 30.0])
def test_a_hump_is_covered_by_white_noise_and_random_walk(drawn: NoiseFit, time: float) -> None:
    """N/(sigma sqrt(2T)) + K/(sigma sqrt(2/T)) >= 1, with equality for the minimal pair."""
    sigma = 1e-3
    pair = filter_numbers([known(drawn, f"N=1e-9 + GM(sigma={sigma}, T={time})")], step_s=0.02)
    shares = pair.white / (sigma * math.sqrt(2 * time)) + pair.walk / (sigma * math.sqrt(2 / time))
    assert shares == pytest.approx(1.0, rel=0.05)


def test_the_pair_scales_with_the_model(drawn: NoiseFit) -> None:
    one, ten = (filter_numbers([known(drawn, f"N={n} + B={b}")]) for n, b in ((1e-3, 3e-4), (1e-2, 3e-3)))
    assert ten.white == pytest.approx(10 * one.white)
    assert ten.walk == pytest.approx(10 * one.walk)


def test_a_pair_for_several_axes_covers_each(drawn: NoiseFit) -> None:
    """It covers the largest density at each frequency; the root mean square is smaller."""
    texts = ("N=1e-3 + B=3e-4", "N=2e-3 + K=1e-5")
    fits = [known(drawn, text) for text in texts]
    pair, mean = filter_numbers(fits), filter_numbers(fits, joined="rms")
    f = np.geomspace(1e-4, 0.5, 200)
    for text in texts:
        covered = pair.white**2 + TERMS["K"].of(pair.walk).psd(f, 1.0)
        assert np.min(covered / NoiseModel.parse(text).psd(f, rate_hz=1.0)) > 0.98
    assert mean.white < pair.white


def test_a_bound_raises_the_pair_by_less_than_its_value(drawn: NoiseFit) -> None:
    """An undetected K raises the random walk by less than its 95 % bound."""
    surely = known(drawn, "N=1e-3")
    bounded = replace(surely, estimates=(*surely.estimates, Estimate.bounded("K", "K", 1e-4)))
    walk = filter_numbers([bounded]).walk
    assert filter_numbers([surely]).walk < 0.01 * walk
    assert 0.7e-4 < walk < 1e-4


def test_a_ramp_becomes_a_random_walk(drawn: NoiseFit) -> None:
    """K² is 1.5 horizon R²: its Allan variance K² t/3 is the ramp's R² t²/2 at the horizon."""
    pair = filter_numbers([known(drawn, "N=1e-6 + R=1e-6")], horizon_s=100.0)
    assert pair.walk**2 * 100 / 3 == pytest.approx((1e-6 * 100) ** 2 / 2, rel=0.05)


def test_no_number_is_zero(drawn: NoiseFit) -> None:
    """Programs reject zero, so absent noise is positive but negligible."""
    pair = filter_numbers([known(drawn, "N=1e-3")])
    assert 0 < pair.walk**2 * 300**3 / 3 < 1e-5 * pair.white**2 * 300


def test_a_bias_with_the_models_time_adds_no_noise(drawn: NoiseFit) -> None:
    """For N + GM, a filter's bias with this T is the model itself."""
    fit = known(drawn, "N=1e-3 + GM(sigma=1e-3, T=20)")
    long, own = correlation_times([fit])
    assert own == 20
    assert long == 3000
    pair = filter_numbers([fit], time_s=own)
    assert pair.sigma == pytest.approx(1e-3, rel=0.03)
    assert pair.excess < filter_numbers([fit], time_s=long).excess


def test_the_pair_of_a_slope_fit_covers_the_curve(drawn: NoiseFit) -> None:
    """Without a likelihood, it covers the upper limits of the Allan curve."""
    sloped = imucal.fit(drawn.curve, method="slope")
    pair = filter_numbers([sloped])
    curve = sloped.curve
    within = (curve.tau >= 0.99) & (curve.tau <= 303)
    high = curve.confidence_interval(0.95)[1][within]
    covered = np.sqrt(pair.white**2 / curve.tau + pair.walk**2 * curve.tau / 3)[within]
    assert pair.basis == "curve"
    assert np.min(covered / high) == pytest.approx(1.0, abs=0.01)


def test_the_pair_of_a_given_curve_covers_the_curve(drawn: NoiseFit) -> None:
    """It has no samples, but its limits are known."""
    table = replace(drawn.curve, computed="given")
    assert filter_numbers([replace(drawn, curve=table)]).basis == "curve"
    unknown = replace(table, edf=np.full(table.tau.size, np.nan))
    assert filter_numbers([replace(drawn, curve=unknown)]).basis == "spectrum"


@pytest.mark.parametrize(("horizon", "step"), [(1.0, 1.0), (10.0, 0.0), (math.inf, 1.0), (-1.0, 1.0)])
def test_invalid_horizons_and_steps_are_rejected(drawn: NoiseFit, horizon: float, step: float) -> None:
    with pytest.raises(ValueError, match="horizon longer than the step"):
        filter_numbers([drawn], horizon_s=horizon, step_s=step)


def test_a_fit_without_terms_and_bounds_is_rejected(drawn: NoiseFit) -> None:
    nothing = replace(known(drawn, "N=1e-3"), estimates=(Estimate.bounded("N", "N", math.inf),))
    with pytest.raises(DataError, match="found no term and no bound"):
        filter_numbers([nothing])
