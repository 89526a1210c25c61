"""Intervals after the choice: they hold though the chosen model lacks a term, and say what it stands for."""

import numpy as np
import pytest

from imucal.fitting.noise_fit import NoiseFit
from tests.fitting.fits import fitted, simulated

#: A consumer gyroscope for half an hour, at a tenth of its rate: B and K are weak beside one another.
WEAK = "N=1e-4 + B=3e-5 + K=3e-6"
N, RATE = 20_000, 10.0


@pytest.fixture(scope="module")
def fits() -> list[NoiseFit]:
    """Twenty-four records of one sensor, the model chosen for each."""
    return [fitted(simulated(WEAK, N, 100 + seed, rate_hz=RATE), rate_hz=RATE) for seed in range(24)]


@pytest.mark.parametrize(("symbol", "truth"), [("N", 1e-4), ("B", 3e-5), ("K", 3e-6)])
def test_intervals_hold_when_the_model_is_chosen(fits: list[NoiseFit], symbol: str, truth: float) -> None:
    """At 95 %, fewer than 20 of 24 hold in one of 170 such tests; those of the chosen model alone, 17."""
    assert len({str(fit.model) for fit in fits}) > 1
    held = sum(fit[symbol].low <= truth <= fit[symbol].high for fit in fits)
    assert held >= 20


def test_a_value_lies_inside_its_interval(fits: list[NoiseFit]) -> None:
    """Whatever near models say."""
    for fit in fits:
        for estimate in fit.estimates:
            assert estimate.value is None or estimate.low <= estimate.value <= estimate.high


def test_the_model_holds_every_term_that_is_shown(fits: list[NoiseFit]) -> None:
    """Also those that the choice left out, since a parameter costs it more than data need to show it."""
    left_out = 0
    for fit in fits:
        own = {term.symbol: abs(term.coefficient) for term in fit.model.terms}
        shown = {estimate.key for estimate in fit.estimates if estimate.value is not None}
        assert shown <= own.keys()
        assert all(fit[key].value == pytest.approx(own[key]) for key in shown)
        left_out += not shown <= set(fit.candidates[0].structure.split(" + "))
    assert left_out


def test_a_chosen_term_that_others_can_replace_is_bounded() -> None:
    """A slow Gauss-Markov term may stand for the walk; the model is drawn with it, the bound covers it."""
    text = "Q=1e-5 + N=1e-3 + GM(sigma=2e-3, T=3) + K=1e-4"
    fit = fitted(simulated(text, N, 3, rate_hz=RATE), rate_hz=RATE)
    assert fit["K"].value is None
    assert fit["K"].high > 1e-4


def test_what_one_thing_may_be_is_said() -> None:
    """To half an hour a Gauss-Markov term of 5 s beside a walk is flicker as well."""
    text = "N=1e-4 + GM(sigma=4e-5, T=5) + K=8e-6"
    fits = [fitted(simulated(text, N, seed, rate_hz=RATE), rate_hz=RATE) for seed in range(4)]
    said = [estimate.alternatives for fit in fits for estimate in fit.estimates if estimate.symbol == "B"]
    assert any("GM" in others for others in said)
    assert all(fit["N"].alternatives == () for fit in fits)


def test_white_noise_stands_for_nothing_else() -> None:
    """Nothing is missing, so nothing may stand in its place; N is as sure as with the model given."""
    samples = np.random.default_rng(5).normal(size=N)
    chosen, given = (fitted(samples, model, rate_hz=RATE) for model in ("auto", "N + B + K"))
    assert all(estimate.alternatives == () for estimate in chosen.estimates)
    assert chosen["N"].low == pytest.approx(given["N"].low, rel=1e-3)
    assert chosen["N"].high == pytest.approx(given["N"].high, rel=1e-3)


def test_a_given_model_is_taken_at_its_word() -> None:
    """Its intervals are those of the model alone."""
    samples = simulated(WEAK, N, 101, rate_hz=RATE)
    given, chosen = fitted(samples, "N + B", rate_hz=RATE), fitted(samples, rate_hz=RATE)
    assert given["B"].high - given["B"].low < chosen["B"].high - chosen["B"].low
