"""Tests of variances of integrals: closed forms, simulated coasts and limits."""

import math
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.prediction.propagation import (
    ANGLE,
    POSITION,
    TILT,
    Caution,
    Quantity,
    coasting_variance,
    lower_limit,
    modelled,
    upper_limit,
)
from tests.slow_cases import first_by_default

TIMES = np.array([1.0, 10.0, 60.0, 300.0])
REST = 60.0


@pytest.fixture(scope="module")
def fit() -> NoiseFit:
    """Return a fit of a record with flicker noise and a bounded random walk."""
    model = NoiseModel.parse("N=1e-3 + B=3e-4")
    samples = model.simulate(20_000, rate_hz=10.0, rng=np.random.default_rng(4101))
    return imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=10.0, sensor="gyroscope", axis="x"))


def test_white_noise_has_a_closed_form() -> None:
    """An angle after t, with the bias from a rest of W, has the variance N² (t + t²/W)."""
    found = coasting_variance(TERMS["N"].of(2.0), TIMES, rest_s=REST, rate_hz=100.0)
    np.testing.assert_allclose(found, 4 * (TIMES + TIMES**2 / REST), rtol=1e-3)


def test_a_random_walk_has_a_closed_form() -> None:
    """K² t² (t + W) / 3: the walk after the rest, and the lag of the rest's mean behind its end."""
    found = coasting_variance(TERMS["K"].of(2.0), TIMES, rest_s=REST, rate_hz=100.0)
    np.testing.assert_allclose(found, 4 * TIMES**2 * (TIMES + REST) / 3, rtol=1e-3)


def test_a_ramp_has_a_closed_form() -> None:
    """(R t (t + W) / 2)²: the bias has changed by half of the rest and of the coast."""
    found = coasting_variance(TERMS["R"].of(2.0), TIMES, rest_s=REST, rate_hz=100.0)
    np.testing.assert_allclose(found, (TIMES * (TIMES + REST)) ** 2, rtol=1e-3)


@pytest.mark.parametrize("time", [5.0, 60.0])
def test_rest_and_coast_of_one_length_are_an_allan_variance(time: float) -> None:
    """With t = W it is the difference of two means, 2 t² AVAR(t), of flicker and Gauss-Markov noise."""
    m = np.array([time * 100])
    for term in (TERMS["B"].of(1.0), GaussMarkov(sigma=1.0, T=20.0)):
        found = coasting_variance(term, np.array([time]), rest_s=time, rate_hz=100.0)
        np.testing.assert_allclose(found, 2 * time**2 * term.avar(m, 0.01), rtol=1e-9)


@pytest.mark.parametrize("integrals", first_by_default([TILT, ANGLE, POSITION], 1))
def test_simulated_coasts_have_the_predicted_variance(integrals: int) -> None:
    """Samples minus the mean of the rest are integrated once, twice or three times; they agree to 3 %."""
    model = NoiseModel.parse("N=1e-3 + B=1e-3 + K=1e-4 + GM(sigma=1e-3, T=8)")
    rate, rest, coast, count = 20.0, 200, 400, 6000
    rng = np.random.default_rng([4102, integrals])
    # Coasts of one long draw are correlated, but thousands of them are sufficient.
    errors = []
    for _ in range(count // 30):
        parts = model.simulate(30 * (rest + coast), rate_hz=rate, rng=rng).reshape(30, -1)
        moved = parts[:, rest:] - parts[:, :rest].mean(axis=1, keepdims=True)
        for _ in range(integrals):
            moved = np.cumsum(moved, axis=1) / rate
        errors.append(moved[:, -1])
    found = sum(
        coasting_variance(
            term, np.array([coast / rate]), rest_s=rest / rate, rate_hz=rate, integrals=integrals
        )[0]
        for term in model.terms
    )
    drawn = np.sqrt(np.mean(np.square(np.concatenate(errors))))
    assert math.sqrt(found) == pytest.approx(drawn, rel=0.03)


def only(symbol: str) -> Quantity:
    """Return a quantity that depends on one kind of term: the square of its coefficient."""
    return lambda term: np.array([term.coefficient**2 if term.symbol == symbol else 0.0])


def test_limits_of_one_term_agree_with_its_interval(fit: NoiseFit) -> None:
    """If a quantity depends on one term, it has the term's interval; a bound adds its square."""
    white = fit["N"]
    assert white.value is not None
    assert modelled(fit, only("N"))[0] == pytest.approx(white.value**2)
    assert upper_limit(fit, only("N"))[0] == pytest.approx(white.high**2)
    assert lower_limit(fit, only("N"))[0] == pytest.approx(white.low**2)
    walk = fit["K"]
    assert walk.value is None
    assert upper_limit(fit, only("K"))[0] == pytest.approx(walk.high**2)
    assert upper_limit(fit, only("K"), Caution.at(0.8, 0.95))[0] == pytest.approx(
        walk.high**2 * 1.2816 / 1.96, rel=1e-3
    )
    assert lower_limit(fit, only("K"))[0] == 0


def test_a_bounded_term_of_the_model_contributes_its_value(fit: NoiseFit) -> None:
    """The model is more likely with the term, although its limits are 0 and the bound."""
    flicker = fit["B"]
    assert flicker.value is not None
    bounded = Estimate.bounded("B", "B", flicker.high)
    estimates = tuple(bounded if e.key == "B" else e for e in fit.estimates)
    doubtful = replace(fit, estimates=estimates, parameters=(), covariance=np.zeros((0, 0)))
    assert modelled(doubtful, only("B"))[0] == pytest.approx(flicker.value**2)
    assert upper_limit(doubtful, only("B"))[0] == pytest.approx(flicker.high**2)
    assert lower_limit(doubtful, only("B"))[0] == pytest.approx(0)
    without = replace(doubtful, model=NoiseModel(terms=fit.model.terms[:1]))
    assert modelled(without, only("B"))[0] == 0


def test_limits_scale_and_contain_the_value(fit: NoiseFit) -> None:
    """A quantity in other units has scaled limits."""

    def angle(term: NoiseTerm) -> FloatArray:
        return coasting_variance(term, TIMES, rest_s=REST, rate_hz=fit.rate_hz)

    low, value, high = lower_limit(fit, angle), modelled(fit, angle), upper_limit(fit, angle)
    assert np.all((low < value) & (value < high))
    np.testing.assert_allclose(upper_limit(fit, lambda term: 9 * angle(term)), 9 * high)


@pytest.mark.parametrize(("times", "rest"), [([0.0], 1.0), ([1.0], 0.0), ([-1.0], 1.0)])
def test_times_must_be_positive(times: list[float], rest: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        coasting_variance(TERMS["N"].of(1.0), np.array(times), rest_s=rest, rate_hz=100.0)


def test_a_random_walk_and_its_gauss_markov_term_count_once(fit: NoiseFit) -> None:
    """A slow term starts as K, so K does not change the value and only adds the excess of its limit."""
    term = GaussMarkov(sigma=1e-3, T=2000.0)
    walk = 1e-3 * math.sqrt(2 / 2000.0)
    terms = [
        Estimate(key="N", symbol="N", status="estimated", value=1e-3, low=1e-3, high=1e-3),
        Estimate(
            key="GM",
            symbol="GM",
            status="estimated",
            value=1e-3,
            low=1e-3,
            high=1e-3,
            correlation_time=Interval(value=2000.0, low=2000.0, high=2000.0),
        ),
    ]
    k = Estimate(key="K", symbol="K", status="estimated", value=walk, low=walk / 2, high=2 * walk)
    model = NoiseModel(terms=(TERMS["N"].of(1e-3), term))
    known = replace(fit, model=model, parameters=(), covariance=np.zeros((0, 0)), estimates=tuple(terms))
    named = replace(known, estimates=(*terms, k))

    def angle(term: NoiseTerm) -> FloatArray:
        return coasting_variance(term, TIMES, rest_s=REST, rate_hz=10.0)

    assert [e.in_model for e in named.estimates] == [1e-3, 1e-3, None]
    expected = sum(angle(term) for term in model.terms)
    np.testing.assert_allclose(modelled(named, angle), expected)
    np.testing.assert_allclose(lower_limit(named, angle), lower_limit(known, angle))
    limit = np.maximum(angle(TERMS["K"].of(2 * walk)), expected)
    np.testing.assert_allclose(upper_limit(named, angle), limit)
