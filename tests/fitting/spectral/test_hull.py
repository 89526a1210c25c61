"""Intervals after the choice: they hold though the chosen model lacks a term, and say what it stands for."""

import re

import numpy as np
import pytest

from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral.disturbances import band_search
from tests.fitting.fits import fitted, simulated

#: A consumer gyroscope for half an hour, at a tenth of its rate: B and K are weak beside one another.
WEAK = "N=1e-4 + B=3e-5 + K=3e-6"
N, RATE = 20_000, 10.0


@pytest.fixture(scope="module")
def fits() -> list[NoiseFit]:
    """Twenty-four records of one sensor, the model chosen for each."""
    return [fitted(simulated(WEAK, N, 100 + seed, rate_hz=RATE), rate_hz=RATE) for seed in range(24)]


@pytest.mark.slow
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
        # A walk that a slow Gauss-Markov term begins with is there already.
        assert shown - own.keys() <= {"K"}
        assert "GM" in own or shown <= own.keys()
        shown &= own.keys()
        assert all(fit[key].value == pytest.approx(own[key]) for key in shown)
        left_out += not shown <= set(fit.candidates[0].structure.split(" + "))
    assert left_out


@pytest.fixture(scope="module")
def walks() -> list[NoiseFit]:
    """Twenty-four records in which K is weak: a likelihood ratio finds it in nearly each."""
    return [fitted(simulated("N=1 + K=0.01", 10_000, 200 + seed)) for seed in range(24)]


@pytest.mark.slow
def test_a_weak_walk_is_shown(walks: list[NoiseFit]) -> None:
    """In 20 of 24 at least (97 of 100 in `tests/benchmarks/coverage_auto.py`), and held by its interval."""
    assert sum(fit["K"].value is not None for fit in walks) >= 20
    assert sum(fit["K"].low <= 0.01 <= fit["K"].high for fit in walks) >= 20


@pytest.mark.slow
def test_whether_a_walk_is_shown_is_no_matter_of_the_rate(walks: list[NoiseFit]) -> None:
    """Means of ten samples hold the same walk: a parameter has the same price there."""
    means = (simulated("N=1 + K=0.01", 10_000, 200 + seed).reshape(-1, 10).mean(axis=1) for seed in range(24))
    slow = [fitted(samples, rate_hz=0.1) for samples in means]
    alike = sum((a["K"].value is None) == (b["K"].value is None) for a, b in zip(walks, slow, strict=True))
    assert alike >= 20


@pytest.mark.slow
def test_a_slow_gauss_markov_term_describes_the_walk() -> None:
    """Of T = D / 7 it begins as the walk sigma sqrt(2/T), and for how long is said."""
    sigma, time = 2e-4, 300.0
    found = [
        fitted(simulated(f"N=3e-5 + GM(sigma={sigma}, T={time})", N, seed, rate_hz=RATE), rate_hz=RATE)["K"]
        for seed in range(12)
    ]
    shown = [k for k in found if k.value is not None]
    assert len(shown) >= 10
    assert sum(k.low <= sigma * np.sqrt(2 / time) <= k.high for k in shown) >= len(shown) - 2
    rivals = [k for k in shown if "GM" in k.alternatives]
    assert len(rivals) >= 6
    assert all(0 < k.horizon_s < N / RATE for k in rivals)
    assert sum(k.horizon_s < time for k in rivals) >= len(rivals) - 2


def test_n_in_front_of_a_filter_has_a_rival() -> None:
    """A Gauss-Markov term of 15 samples that hides N has the spectrum of white noise behind a filter."""
    plateau = 1e-3 * np.sqrt(2 * 1.5)
    for seed in range(3):
        fit = fitted(simulated("N=1e-5 + GM(sigma=1e-3, T=1.5)", N, seed, rate_hz=RATE), rate_hz=RATE)
        n = fit["N"]
        assert n.value is not None
        assert n.low < plateau < n.high
        assert "GM" in n.alternatives
        (found,) = (finding for finding in fit.findings if finding.code == "output-filter")
        assert found.level == "warning"
        time = re.search(r"Gauss-Markov term of T = (\S+) s", found.text)
        assert time
        assert float(time[1]) == pytest.approx(1.5, rel=0.15)


def test_n_is_always_a_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a Gauss-Markov term hides N and no filter explains it, N is the floor below every near model."""
    monkeypatch.setattr(band_search, "_MASKING", 2.0)
    for seed in range(3):
        fit = fitted(simulated("N=1e-5 + GM(sigma=1e-3, T=1.5)", N, seed, rate_hz=RATE), rate_hz=RATE)
        n = fit["N"]
        # The psd at half the rate, 5 Hz.
        floor = np.sqrt(fit.model.psd(np.array([RATE / 2]), rate_hz=RATE)[0])
        assert n.value is not None
        assert n.value == pytest.approx(floor, rel=0.05)
        assert 0 < n.low < n.value < n.high
        assert "GM" in n.alternatives
        assert n.drawn is None


def test_a_bounded_term_of_the_model_reports_the_drawn_value(fits: list[NoiseFit]) -> None:
    """Its interval reaches zero, and yet the model without it would be less likely."""
    bounded = [e for fit in fits for e in fit.estimates if e.value is None]
    drawn = [e.drawn for e in bounded if e.drawn is not None]
    assert drawn
    assert all(0 < (e.drawn or 0.0) <= e.high for e in bounded if e.drawn is not None)
    shown = [e for fit in fits for e in fit.estimates if e.value is not None and e.key != "K"]
    assert all(e.drawn == e.value for e in shown)


def test_accepted_types_are_listed() -> None:
    """To half an hour a Gauss-Markov term of 5 s beside a walk is flicker as well."""
    text = "N=1e-4 + GM(sigma=4e-5, T=5) + K=8e-6"
    fits = [fitted(simulated(text, N, seed, rate_hz=RATE), rate_hz=RATE) for seed in range(4)]
    said = [estimate.alternatives for fit in fits for estimate in fit.estimates if estimate.symbol == "B"]
    assert any("GM" in others for others in said)
    assert all(fit["N"].alternatives == () for fit in fits)


def test_white_noise_has_no_alternative() -> None:
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
