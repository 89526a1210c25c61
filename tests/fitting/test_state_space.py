"""Tests of the exact likelihood: agreement with the dense Gaussian density, gaps and the optimum."""

import numpy as np
import pytest
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.noise.model import NoiseModel
from imucal.noise.term import PowerLawTerm
from imucal.noise.terms import GaussMarkov, RateRamp
from imucal.powerlaw import odd_harmonic
from imucal.recording import AxisSeries
from tests.fitting import state_space as module
from tests.fitting.state_space import BlockLaw, Blocks, StateSpace, filtered, fit_exact

N = 300


def log_likelihood(model: NoiseModel, series: AxisSeries) -> float:
    """Return the exact log-likelihood after subtraction of the model's ramp."""
    samples, seen = module.on_grid(series.finite(), "a likelihood")
    ramp = sum(term.coefficient for term in model.terms if term.symbol == "R")
    rest = NoiseModel(terms=tuple(term for term in model.terms if term.symbol != "R"))
    samples = samples - samples[seen].mean() - ramp * series.tau0 * np.arange(samples.size)
    return module.log_likelihood(rest, np.where(seen, samples, 0.0), seen, series.rate_hz)[0]


def _covariance(model: NoiseModel, rate_hz: float) -> FloatArray:
    """Return the covariance of N samples, up to a constant that the flat prior on the level absorbs."""
    t = np.arange(N, dtype=np.float64)
    lag = np.abs(np.subtract.outer(t, t))
    total = np.zeros((N, N))
    for term in model.terms:
        if isinstance(term, GaussMarkov):
            total += term.sigma**2 * np.exp(-lag / rate_hz / term.T)
        elif isinstance(term, PowerLawTerm):
            shape = {
                "N": np.eye(N),
                "Q": 2 * np.eye(N) - (lag == 1),
                "K": 1 + np.minimum.outer(t, t),
                "B": 40 - 2 / np.pi * odd_harmonic(lag),
            }[term.symbol]
            total += term.variance(1 / rate_hz) * shape
    return total


def dense(model: NoiseModel, samples: FloatArray, seen: NDArray[np.bool_], rate_hz: float) -> float:
    """Return the Gaussian log-density of the seen samples, with the level integrated out; O(n³)."""
    ramp = sum(term.value for term in model.terms if isinstance(term, RateRamp))
    rest = (samples - ramp * np.arange(N) / rate_hz)[seen]
    covariance = _covariance(model, rate_hz)[np.ix_(seen, seen)]
    inverse = np.linalg.inv(covariance)
    ones = np.ones(rest.size)
    level = float(ones @ inverse @ ones)
    square = float(rest @ inverse @ rest) - float(ones @ inverse @ rest) ** 2 / level
    log_det = float(np.linalg.slogdet(covariance)[1]) + np.log(level)
    return float(-0.5 * ((rest.size - 1) * np.log(2 * np.pi) + log_det + square))


@pytest.mark.parametrize("missing", [0.0, 0.2])
@pytest.mark.parametrize(
    ("text", "tolerance"),
    [
        ("N=1", 1e-9),
        ("N=1 + K=0.1", 1e-9),
        ("N=1 + K=1e-9", 1e-6),
        ("K=1 + N=1e-3", 1e-4),
        ("N=1 + GM(sigma=0.5, T=20)", 1e-9),
        ("Q=1 + N=0.5 + GM(sigma=0.5, T=20) + GM(sigma=0.3, T=2) + K=0.05 + R=0.01", 1e-8),
        # Without white noise, the added noise changes a sample's likelihood by at most 1e-6.
        ("Q=1 + K=0.01", 1e-3),
        ("GM(sigma=1, T=40)", 1e-3),
        ("K=1", 1e-3),
    ],
)
def test_the_likelihood_equals_the_dense_gaussian(text: str, tolerance: float, missing: float) -> None:
    """Every sum of terms agrees, wherever samples are missing."""
    rng = np.random.default_rng(17)
    model = NoiseModel.parse(text)
    samples = model.simulate(N, rate_hz=1.0, rng=rng)
    seen = rng.random(N) >= missing
    seen[[0, -1]] = True
    series = AxisSeries.from_samples(samples, rate_hz=1.0).keeping(seen)
    assert log_likelihood(model, series) == pytest.approx(dense(model, samples, seen, 1.0), abs=tolerance)


def test_flicker_nearly_equals_a_bank_of_gauss_markov_terms() -> None:
    """The log-likelihood of N + B differs by less than 0.1 from exact flicker."""
    model = NoiseModel.parse("N=1 + B=0.3")
    samples = model.simulate(N, rate_hz=10.0, rng=np.random.default_rng(18))
    series = AxisSeries.from_samples(samples, rate_hz=10.0)
    exact = dense(model, samples, np.ones(N, dtype=bool), 10.0)
    assert log_likelihood(model, series) == pytest.approx(exact, abs=0.1)


def test_the_division_into_blocks_is_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    model = NoiseModel.parse("Q=1 + N=0.5 + GM(sigma=0.5, T=20) + K=0.05")
    samples = model.simulate(1000, rate_hz=1.0, rng=np.random.default_rng(19))
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    whole = log_likelihood(model, series)
    monkeypatch.setattr(module, "_WHOLE", 64)
    assert log_likelihood(model, series) == pytest.approx(whole, abs=1e-8)


def test_offsets_have_no_effect_and_units_add_a_constant() -> None:
    """A scale factor c subtracts (n - 1) ln c."""
    model = NoiseModel.parse("N=1 + K=0.1")
    samples = model.simulate(N, rate_hz=1.0, rng=np.random.default_rng(20))
    base = log_likelihood(model, AxisSeries.from_samples(samples, rate_hz=1.0))
    assert log_likelihood(model, AxisSeries.from_samples(samples + 1e3, rate_hz=1.0)) == pytest.approx(base)
    small = NoiseModel.parse("N=1e-6 + K=1e-7")
    scaled = log_likelihood(small, AxisSeries.from_samples(samples * 1e-6, rate_hz=1.0))
    assert scaled == pytest.approx(base + (N - 1) * np.log(1e6))


def test_the_fit_is_a_maximum_of_the_likelihood() -> None:
    """A change of any coefficient by half a per cent lowers the likelihood; R is estimated too."""
    text = "N=1 + GM(sigma=0.4, T=30) + R=1e-3"
    model = NoiseModel.parse(text)
    samples = model.simulate(5000, rate_hz=1.0, rng=np.random.default_rng(21))
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    start = NoiseModel.parse("N=0.8 + GM(sigma=0.6, T=20) + R=0")
    best, value = fit_exact(series, start)
    assert value >= log_likelihood(model, series)
    assert log_likelihood(best, series) == pytest.approx(value, abs=1e-6)
    white, gm, ramp = best.terms
    assert isinstance(white, PowerLawTerm)
    assert isinstance(gm, GaussMarkov)
    assert isinstance(ramp, RateRamp)
    for factor in (0.995, 1.005):
        for terms in (
            (type(white)(value=white.value * factor), gm, ramp),
            (white, GaussMarkov(sigma=gm.sigma * factor, T=gm.T), ramp),
            (white, GaussMarkov(sigma=gm.sigma, T=gm.T * factor), ramp),
            (white, gm, RateRamp(value=ramp.value * factor)),
        ):
            assert log_likelihood(NoiseModel(terms=terms), series) <= value + 1e-6
    # Four standard errors: N 1 %, sigma 9 %, T 25 % at this length.
    assert white.value == pytest.approx(1, rel=0.05)
    assert gm.sigma == pytest.approx(0.4, rel=0.35)
    assert ramp.value == pytest.approx(1e-3, rel=0.15)


def test_the_cost_is_proportional_to_the_number_of_samples() -> None:
    """The filter takes one step for each block, and the matrices of a step do not depend on the record."""
    model = NoiseModel.parse("N=1 + K=1e-3")
    counts, shapes = [], set()
    for n in (5_120, 51_200):
        samples = model.simulate(n, rate_hz=1.0, rng=np.random.default_rng(22))
        states = StateSpace.of(model, rate_hz=1.0, n=n)
        blocks = Blocks.of(samples, np.ones(n, dtype=bool))
        steps = list(filtered(states, blocks, BlockLaw.of(states, blocks.length, 1 / blocks.count)))
        counts.append(len(steps))
        shapes |= {step.covariance.shape for step in steps}
    assert counts == [20, 200]
    assert len(shapes) == 1


def test_a_single_sample_is_rejected() -> None:
    """A likelihood of contrasts needs two samples."""
    series = AxisSeries.from_samples(np.array([1.0, np.nan]), rate_hz=1.0)
    with pytest.raises(DataError, match=r"^gyro_x: a likelihood needs at least 2 samples, got 1$"):
        fit_exact(series, NoiseModel.parse("N=1"))


def test_a_ramp_is_subtracted_at_the_sampling_rate() -> None:
    """A ramp of 3 per second at 50 Hz, in samples and model, does not change the likelihood."""
    samples = np.random.default_rng(19).standard_normal(N)
    plain, steep = (
        log_likelihood(
            NoiseModel.parse(text), AxisSeries.from_samples(samples + slope * np.arange(N) / 50, rate_hz=50.0)
        )
        for text, slope in (("N=0.1", 0.0), ("N=0.1 + R=3", 3.0))
    )
    assert steep == pytest.approx(plain, rel=1e-9)
