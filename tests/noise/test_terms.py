"""Tests of the contract of all terms: definitions, sums, integrals, simulation and text."""

from fractions import Fraction

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.variance import variances
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import (
    TERMS,
    AngleRandomWalk,
    BiasInstability,
    GaussMarkov,
    Quantization,
    RateRamp,
    RateRandomWalk,
)
from tests.noise.contract import missing

TAU0 = 0.005
KNOWN: list[NoiseTerm] = [
    Quantization(value=2e-5),
    AngleRandomWalk(value=1e-3),
    BiasInstability(value=3e-4),
    GaussMarkov(sigma=2e-4, T=0.7),
    GaussMarkov(sigma=2e-4, T=3600.0),
    RateRandomWalk(value=4e-5),
    RateRamp(value=-6e-6),
]
#: A term that is added to the table is tested too: a coefficient, and a time in s if it has one.
ADDED = [
    kind.of(2e-4, *[0.7] * (len(kind.parameters()) - 1))
    for kind in TERMS.values()
    if kind not in {type(known) for known in KNOWN}
]
MEMBERS = KNOWN + ADDED
STOCHASTIC = [term for term in MEMBERS if not isinstance(term, RateRamp)]


def ids(term: NoiseTerm) -> str:
    return term.text()


def test_the_table_contains_every_class_once() -> None:
    """The power laws are in the order of increasing slope, each under its own symbol."""
    assert [symbol for symbol in TERMS if symbol in "QNBKR"] == ["Q", "N", "B", "K", "R"]
    assert {kind.symbol: kind for kind in TERMS.values()} == TERMS
    assert {type(member) for member in MEMBERS} == set(TERMS.values())


@pytest.mark.parametrize("term", MEMBERS, ids=ids)
def test_the_text_of_a_term_is_parsed_back(term: NoiseTerm) -> None:
    assert NoiseModel.parse(term.text()).terms == (term,)
    assert TERMS[term.symbol] is type(term)
    assert len(term.names) == len(term.units) == 2


@pytest.mark.parametrize("term", MEMBERS, ids=ids)
def test_avar_follows_from_the_sum_variance(term: NoiseTerm) -> None:
    """avar(m) = (4 V(m) - V(2m)) / (2 m²)."""
    m = np.array([1.0, 2.0, 3.0, 20.0, 150.0])
    V = term.sum_variance
    expected = (4 * V(m, TAU0) - V(2 * m, TAU0)) / (2 * m**2)
    npt.assert_allclose(term.avar(m, TAU0), expected, rtol=1e-12)


@pytest.mark.parametrize("term", MEMBERS, ids=ids)
def test_avar_follows_from_the_structure_function(term: NoiseTerm) -> None:
    """Lemma 4.2 holds without a finite variance: (sum (2m-k) D - 4 sum (m-k) D) / (2 m²)."""
    for m in (1, 2, 5, 60):
        k = np.arange(1.0, 2 * m)
        D = term.structure(k, TAU0)
        weight = (2 * m - k) - 4 * np.maximum(m - k, 0)
        assert float(weight @ D) / (2 * m**2) == pytest.approx(
            term.avar(np.array([float(m)]), TAU0)[0], rel=1e-9
        )


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
@pytest.mark.parametrize("m", [1, 3, 25])
def test_avar_is_the_integral_of_the_psd(term: NoiseTerm, m: int) -> None:
    """Lemma 4.1: the two-sided psd in U²/Hz times the response of the Allan variance."""
    # Frequencies are denser where the psd of a slow process is steep.
    edges = np.concatenate([[0.0], np.geomspace(1e-9, 0.5 / TAU0, 200_001)])
    f = (edges[1:] + edges[:-1]) / 2
    response = 2 * np.sin(np.pi * f * m * TAU0) ** 4 / (m * np.sin(np.pi * f * TAU0)) ** 2
    got = 2 * float(np.sum(response * term.psd(f, TAU0) * np.diff(edges)))
    assert got == pytest.approx(term.avar(np.array([float(m)]), TAU0)[0], rel=1e-6)


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
def test_simulated_samples_have_the_avar(term: NoiseTerm) -> None:
    """The mean of 60 series is within four standard errors at short and long averages."""
    rng, m = np.random.default_rng(3), np.array([1, 4, 64, 500])
    drawn = np.array([variances(term.simulate(4000, TAU0, rng), m) for _ in range(60)])
    error = drawn.std(axis=0) / np.sqrt(60)
    assert np.all(np.abs(drawn.mean(axis=0) - term.avar(m.astype(np.float64), TAU0)) < 4 * error)


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
def test_simulated_samples_have_the_structure_function(term: NoiseTerm) -> None:
    """Mean square differences of 300 short series agree at several lags."""
    rng = np.random.default_rng(4)
    drawn = np.array([term.simulate(300, TAU0, rng) for _ in range(300)])
    for k in (1, 2, 7, 40):
        squares = np.mean((drawn[:, k:] - drawn[:, :-k]) ** 2, axis=1)
        expected = term.structure(np.array([float(k)]), TAU0)[0]
        assert abs(squares.mean() - expected) < 4 * squares.std() / np.sqrt(300)


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
def test_the_generator_determines_the_simulation(term: NoiseTerm) -> None:
    """Equal seeds give equal samples, and n = 0 gives none."""
    first = term.simulate(100, TAU0, np.random.default_rng(1))
    npt.assert_array_equal(first, term.simulate(100, TAU0, np.random.default_rng(1)))
    assert term.simulate(0, TAU0, np.random.default_rng(1)).shape == (0,)
    assert term.simulate(1, TAU0, np.random.default_rng(1)).shape == (1,)


def test_a_ramp_is_deterministic() -> None:
    """It is R t for every seed, with the Allan variance R² tau² / 2 and no spectrum."""
    ramp = RateRamp(value=-6e-6)
    npt.assert_allclose(ramp.simulate(4, 0.5, np.random.default_rng(0)), -6e-6 * np.arange(4) / 2)
    npt.assert_allclose(ramp.avar(np.array([10.0]), 0.5), (6e-6 * 5) ** 2 / 2)
    npt.assert_array_equal(ramp.psd(np.array([0.0, 1.0]), 0.5), 0.0)


@pytest.mark.parametrize(
    ("term", "tau", "expected"),
    [
        (AngleRandomWalk(value=1e-3), 1.0, 1e-3),
        (RateRandomWalk(value=4e-5), 3.0, 4e-5),
        (Quantization(value=2e-5), 2.0, 3**0.5 * 1e-5),
        (BiasInstability(value=3e-4), 500.0, 0.6643 * 3e-4),
        (RateRamp(value=6e-6), 2**0.5, 6e-6),
    ],
    ids=lambda value: getattr(value, "symbol", None),
)
def test_coefficients_are_defined_at_the_times_of_ieee_952(
    term: NoiseTerm, tau: float, expected: float
) -> None:
    """IEEE Std 952-1997, Annex C: N at 1 s, K at 3 s, B at 0.664 B, for a high sampling rate."""
    m = np.array([np.round(tau / 1e-4)])
    assert np.sqrt(term.avar(m, 1e-4)[0]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("term", [term for term in STOCHASTIC if term in KNOWN], ids=ids)
def test_the_continuous_limit_agrees_with_ieee_952(term: NoiseTerm) -> None:
    """At low frequency, with w = 2 pi f: N², K²/w², B²/w, tau0 Q² w², 2 sigma² T/(1 + (w T)²)."""
    f = np.array([0.01, 0.1])
    w = 2 * np.pi * f
    match term:
        case GaussMarkov():
            expected = 2 * term.sigma**2 * term.T / (1 + (w * term.T) ** 2)
        case _:
            slope = {"Q": 1e-4 * w**2, "N": np.ones(2), "B": 1 / w, "K": 1 / w**2}[term.symbol]
            expected = term.coefficient**2 * slope
    npt.assert_allclose(term.psd(f, 1e-4), expected, rtol=1e-4)


def _exact_gauss_markov(m: int, phi: Fraction) -> Fraction:
    """Return the sum over autocovariances, in exact fractions."""
    total = sum((2 * m - k - 4 * max(m - k, 0)) * 2 * (1 - phi**k) for k in range(1, 2 * m))
    return Fraction(total) / (2 * m * m)


def markov_avar(m: int, a: float) -> float:
    """Return the Allan variance of a Gauss-Markov process of variance 1 with the rate a per sample."""
    return float(GaussMarkov(sigma=1.0, T=1 / a).avar(np.array([float(m)]), 1.0)[0])


@pytest.mark.parametrize("a", [1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("m", [1, 2, 5, 40])
def test_gauss_markov_is_stable_as_phi_tends_to_one(a: float, m: int) -> None:
    """The relative error is below 1e-11 from correlation times of one sample to 1e10."""
    # phi = 1 - x is exact as a fraction; -log1p(-x) is its a, rounded once.
    x = Fraction(a)
    exact = float(_exact_gauss_markov(m, 1 - x)) if a < 1 else None
    got = markov_avar(m, -float(np.log1p(-a)) if a < 1 else a)
    if exact is None:
        phi = np.exp(-a)
        k = np.arange(1.0, 2 * m)
        exact = float((2 * m - k - 4 * np.maximum(m - k, 0)) @ (2 * (1 - phi**k))) / (2 * m * m)
    assert got == pytest.approx(exact, rel=1e-11)


def test_gauss_markov_is_more_stable_than_the_textbook_form() -> None:
    """At phi = 1 - 1e-6 and m = 1 the value is 1 - phi; cancellation makes the textbook form useless."""
    a = -np.log1p(-1e-6)
    assert markov_avar(1, a) == pytest.approx(1e-6, rel=1e-11)


@pytest.mark.parametrize("time", [0.5, 10.0, 1e4, 1e8])
def test_a_gauss_markov_sum_has_the_variance_of_its_autocovariances(time: float) -> None:
    """V(n) is the double sum of exp(-|i-j|/T), except for a multiple of n²."""
    n = np.arange(1.0, 40.0)
    direct = np.array(
        [np.exp(-np.abs(np.subtract.outer(np.arange(k), np.arange(k))) / time).sum() for k in n]
    )
    rest = direct - GaussMarkov(sigma=1.0, T=time).sum_variance(n, 1.0)
    npt.assert_allclose(rest, rest[-1] * (n / n[-1]) ** 2, rtol=1e-9, atol=1e-9 * np.abs(direct).max())


def test_a_slow_gauss_markov_is_a_random_walk() -> None:
    """For T much longer than tau, sigma² (2/T) drives a random walk of K² = 2 sigma² / T."""
    slow, walk = GaussMarkov(sigma=1.0, T=1e9), RateRandomWalk(value=(2 / 1e9) ** 0.5)
    m = np.array([1.0, 10.0, 1000.0])
    npt.assert_allclose(slow.avar(m, 1.0), walk.avar(m, 1.0), rtol=1e-5)


def test_a_fast_gauss_markov_is_white_noise() -> None:
    """For T much shorter than tau0, samples are independent."""
    fast = GaussMarkov(sigma=2.0, T=1e-3)
    npt.assert_allclose(fast.avar(np.array([1.0, 7.0]), 1.0), [4.0, 4 / 7])
    assert fast.phi(1.0) == 0.0
    assert fast.q(1.0) == pytest.approx(2.0)


def test_a_moving_average_has_its_published_avar() -> None:
    """MA(1): sigma² (m (1 + theta)² - 3 theta) / m², as a sum of quantization and white noise.

    With theta < 0, y = e[t] + theta e[t-1] has the autocovariance of these two terms.
    """
    theta = -0.4
    model = NoiseModel(terms=(Quantization(value=(-theta) ** 0.5), AngleRandomWalk(value=abs(1 + theta))))
    m = np.array([1.0, 2.0, 9.0, 100.0])
    expected = (m * (1 + theta) ** 2 - 3 * theta) / m**2
    npt.assert_allclose(model.avar(m, rate_hz=1.0), expected, rtol=1e-12)
    f = np.array([0.01, 0.2, 0.49])
    psd = 1 + theta**2 + 2 * theta * np.cos(2 * np.pi * f)
    npt.assert_allclose(model.psd(f, rate_hz=1.0), psd, rtol=1e-12)


def test_two_spectra_may_share_one_allan_variance() -> None:
    """Greenhall (1998): 1/f and (1/f)(1 + 0.8 cos(2 pi log2 f)) have the same curve.

    The Mellin transform of sin⁴ has the factor 1 - 4 * 2^s, which vanishes at s = -2 + 2 pi i / ln 2, so one
    ripple per octave integrates to zero at every tau. Only the spectra differ.
    """
    # The integral is over log f, from 1e-8 to 1e6, with the continuous response; f cancels 1/f.
    x = np.linspace(np.log2(1e-8), np.log2(1e6), 2_800_001)
    f = np.exp2(x)
    step = np.log(2) * (x[1] - x[0])
    ripple = np.cos(2 * np.pi * x)
    for m in (1, 3, 10):
        response = 2 * np.sin(np.pi * m * f) ** 4 / (np.pi * m * f) ** 2
        plain = float(response.sum()) * step
        assert plain == pytest.approx(2 * np.log(2), rel=1e-5)
        assert plain + 0.8 * float(response @ ripple) * step == pytest.approx(plain, rel=1e-5)


@pytest.mark.parametrize("value", [-1e-3, float("nan"), float("inf")])
@pytest.mark.parametrize("kind", [Quantization, AngleRandomWalk, BiasInstability, RateRandomWalk])
def test_an_invalid_coefficient_is_rejected(kind: type[AngleRandomWalk], value: float) -> None:
    """A deviation is finite and not negative."""
    with pytest.raises(ValueError, match=f"{kind.symbol} must be finite and not negative, got {value}"):
        kind(value=value)


def test_invalid_gauss_markov_terms_and_ramps_are_rejected() -> None:
    """Sigma must not be negative, T must be positive and R finite."""
    with pytest.raises(ValueError, match="GM sigma must be finite and not negative, got -1"):
        GaussMarkov(sigma=-1.0, T=1.0)
    with pytest.raises(ValueError, match="GM T must be positive and finite, got 0"):
        GaussMarkov(sigma=1.0, T=0.0)
    with pytest.raises(ValueError, match="R must be finite, got inf"):
        RateRamp(value=float("inf"))


@pytest.mark.parametrize("symbol", TERMS)
def test_every_term_is_complete(symbol: str) -> None:
    """Each term has all required parts and is in the schema and the docs."""
    assert missing(symbol) == []
