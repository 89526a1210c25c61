"""The Allan variance of any psd and any autocovariance: closed forms, laws, refusals."""

import re
from functools import partial

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucal import avar_from_acvf, avar_from_psd
from imucal.arrays import FloatArray
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import GaussMarkov
from tests.noise.test_terms import STOCHASTIC, TAU0, ids
from tests.slow_cases import first_by_default

#: Short and long, odd and even, up to what no sum over frequencies could afford.
M = np.array([1, 2, 3, 7, 64, 1000, 12_345, 1_000_000])


def moving_average_avar(theta: float, variance: float, m: FloatArray) -> FloatArray:
    """(1 + theta²) s²/m² (m + (2m - 3) theta/(1 + theta²)): the chapter's example of lemma 4.2."""
    plain = 1 + theta**2
    return np.asarray(plain * variance / m**2 * (m + (2 * m - 3) * theta / plain))


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
def test_the_integral_of_each_terms_psd_is_its_closed_form(term: NoiseTerm) -> None:
    """For every term, singular at 0 or not, to 1e-10."""
    got = avar_from_psd(lambda f: term.psd(f, TAU0), M, TAU0)
    npt.assert_allclose(got, term.avar(M.astype(np.float64), TAU0), rtol=1e-10)


def test_it_is_the_sum_over_many_frequencies() -> None:
    """A slow witness: the midpoint rule, of a density that nobody has a closed form for."""

    def density(f: FloatArray) -> FloatArray:
        return np.asarray(1 + np.sin(7 * f) ** 2 / f + np.exp(-((f - 3) ** 2) / 0.02))

    f = (np.arange(2_000_000) + 0.5) / 2_000_000 * 50.0
    for m in (1, 5, 40):
        kernel = 2 * np.sin(np.pi * f * m / 100) ** 4 / (m * np.sin(np.pi * f / 100)) ** 2
        slow = 2 * float(np.mean(kernel * density(f))) * 50.0
        assert avar_from_psd(density, m, 0.01) == pytest.approx(slow, rel=1e-7)


@pytest.mark.parametrize(
    ("slope", "expected"),
    [
        (0.0, lambda tau: 1 / tau),
        (-1.0, lambda tau: 4 * np.log(2) + 0 * tau),
        (-2.0, lambda tau: (2 * np.pi) ** 2 * tau / 3),
    ],
)
def test_in_continuous_time_it_is_that_of_ieee_952(slope: float, expected: object) -> None:
    """N²/tau, 4 ln 2 times the density's 1/f, K² tau/3 (Annex C), at every tau."""
    assert callable(expected)
    got = avar_from_psd(lambda f: f**slope, M, TAU0, sampled=False)
    npt.assert_allclose(got, expected(M * TAU0), rtol=1e-10)


@pytest.mark.parametrize("theta", first_by_default([-0.4, 1.0, 3.0, 0.0, 0.5, -1.0], 4))
def test_a_moving_average_has_the_chapters_closed_form(theta: float) -> None:
    """By its psd s² tau0 (1 + theta² + 2 theta cos w) and by its autocovariance."""
    tau0, variance, m = 0.02, 2.5, np.array([1, 2, 3, 10, 999, 50_000])
    expected = moving_average_avar(theta, variance, m.astype(np.float64))
    by_psd = avar_from_psd(
        lambda f: variance * tau0 * (1 + theta**2 + 2 * theta * np.cos(2 * np.pi * f * tau0)), m, tau0
    )
    by_acvf = avar_from_acvf([variance * (1 + theta**2), variance * theta], m)
    # Where theta = -1 all but 3/m² of m cancels, and the closed form rounds as well.
    npt.assert_allclose(by_psd, expected, rtol=1e-9)
    npt.assert_allclose(by_acvf, expected, rtol=1e-9)


@pytest.mark.parametrize("time", [0.5, 100.0, 1e7])
def test_the_autocovariance_of_gauss_markov_gives_its_closed_form(time: float) -> None:
    """Also of a slow one, of which neighbouring autocovariances are nearly equal."""
    term, m = GaussMarkov(sigma=0.3, T=time), M[:-1]
    got = avar_from_acvf(lambda k: 0.09 * np.exp(-k / time), m)
    # Of r_0 - r_k, about 1e-7 of r_0 at T = 1e7, nine digits are left in double precision.
    npt.assert_allclose(got, term.avar(m.astype(np.float64), 1.0), rtol=1e-10 if time < 1e6 else 1e-7)


def test_it_is_what_averages_of_samples_scatter_by() -> None:
    """Half the mean square of (average - next average), from the full covariance matrix."""
    acvf, m = np.array([2.0, -0.7, 0.3, 0.1]), 5
    lag = np.abs(np.subtract.outer(np.arange(2 * m), np.arange(2 * m)))
    covariance = np.where(lag < 4, acvf[np.minimum(lag, 3)], 0.0)
    contrast = np.repeat([1 / m, -1 / m], m)
    assert avar_from_acvf(acvf, m) == pytest.approx(float(contrast @ covariance @ contrast) / 2)


def test_what_adds_up_in_one_adds_up_in_the_other() -> None:
    """Independent noises: the Allan variance of a sum of psds is the sum of theirs (additivity)."""
    model = NoiseModel.parse("N=1e-3 + B=3e-4 + K=4e-5 + GM(sigma=2e-4, T=0.7) + Q=2e-5")
    m = np.array([1, 30, 4000])
    parts = [avar_from_psd(partial(term.psd, tau0=TAU0), m, TAU0) for term in model.terms]
    whole = avar_from_psd(lambda f: model.psd(f, rate_hz=1 / TAU0), m, TAU0)
    npt.assert_allclose(whole, np.sum(parts, axis=0), rtol=1e-10)


@settings(deadline=None, max_examples=8)
@given(gain=st.floats(1e-12, 1e12), period=st.floats(1e-6, 1e3), slope=st.floats(-2.8, 0.0))
def test_units_change_what_they_must(gain: float, period: float, slope: float) -> None:
    """C S has c times the Allan variance; with times scaled by tau0, S(f tau0) tau0 has the same."""
    m = np.array([1, 9])
    base = avar_from_psd(lambda f: f**slope, m, 1.0)
    npt.assert_allclose(avar_from_psd(lambda f: gain * f**slope, m, 1.0), gain * base, rtol=1e-9)
    scaled = avar_from_psd(lambda f: (f * period) ** slope * period, m, period)
    npt.assert_allclose(scaled, base, rtol=1e-8)


def test_jumps_and_lines_are_found() -> None:
    """A density that ends at once, and a line a millionth as wide as the band, pointed at."""
    # Below 0.1 of the rate, 1: 2/m² times the sum of Dirichlet's terms, by the plain sum over k.
    edge, m = 0.1234, 3
    lag = np.arange(400_000.0)
    acvf = 2 * edge * np.sinc(2 * edge * lag)
    assert avar_from_psd(lambda f: 1.0 * (f < edge), m, 1.0) == pytest.approx(
        float(avar_from_acvf(acvf, m)), rel=1e-8
    )
    centre, width = 0.1, 1e-7

    def line(f: FloatArray) -> FloatArray:
        return np.asarray(width / (2 * np.pi * ((f - centre) ** 2 + width**2)))

    sine = 2 * np.sin(np.pi * centre * m) ** 4 / (m * np.sin(np.pi * centre)) ** 2
    assert avar_from_psd(line, m, 1.0, breaks=[centre]) == pytest.approx(sine, rel=1e-4)


def test_points_are_joined_by_straight_lines() -> None:
    """On logarithmic axes: a power law by two points is that power law; a scalar m gives a scalar."""
    f = np.array([1e-9, 50.0])
    # Below the first point the density stays as it is, which takes 1e-9 Hz away.
    got = avar_from_psd((f, 1 / f), 10, 0.01)
    assert got.shape == ()
    assert got == pytest.approx(avar_from_psd(lambda f: 1 / f, 10, 0.01), rel=1e-12)


def test_shapes_are_kept() -> None:
    """Of any shape, repeated and unsorted; nothing gives nothing."""
    m = np.array([[4, 1], [1, 4]])
    for got in (avar_from_psd(lambda f: 1 + 0 * f, m, 1.0), avar_from_acvf([1.0], m)):
        npt.assert_allclose(got, 1 / m, rtol=1e-12)
    assert avar_from_psd(lambda f: 1 + 0 * f, [], 1.0).shape == (0,)
    assert avar_from_acvf([1.0], []).shape == (0,)


def test_two_densities_share_one_curve() -> None:
    """Phi(f) = 2 Phi(2f) with nothing over an octave: 1/f and (1/f)(1 + 0.8 cos(2 pi log2 f))."""
    plain = avar_from_psd(lambda f: 1 / f, M, TAU0, sampled=False)
    rippled = avar_from_psd(lambda f: (1 + 0.8 * np.cos(2 * np.pi * np.log2(f))) / f, M, TAU0, sampled=False)
    npt.assert_allclose(rippled, plain, rtol=1e-9)
    # A ripple of another period shows: the agreement is not that of a blunt integral.
    other = avar_from_psd(lambda f: (1 + 0.8 * np.cos(3 * np.pi * np.log2(f))) / f, M, TAU0, sampled=False)
    assert np.max(np.abs(other / plain - 1)) > 1e-3


@pytest.mark.parametrize(
    ("psd", "sampled", "message"),
    [
        (lambda f: f**-3.0, True, "the psd grows like 1/f^3 or faster towards a frequency of 0"),
        (lambda f: np.exp(1 / f), True, "the psd grows like 1/f^3 or faster towards a frequency of 0"),
        (lambda f: f**1.0, False, "the psd grows like f or faster towards a frequency of infinity"),
        (lambda f: f - 0.3, True, "psd must be 0 or more everywhere, got -0.253125 at 0.046875 Hz"),
        (lambda f: np.sqrt(f * np.nan), True, "psd must be 0 or more everywhere, got nan at"),
        (lambda f: np.where(f > 0.2, np.inf, 1.0), True, "psd must be finite, got inf at 0.2"),
        (lambda _: 1.0, True, "psd must return shape (1,) for frequencies of that shape, got ()"),
        (([1.0, 1.0], [1.0, 1.0]), True, "frequencies of a psd must be positive, finite and increasing"),
        (([1.0], [1.0, 1.0]), True, "a psd of arrays must be two of one shape (k,), got (1,) and (2,)"),
        (([1.0, 2.0], [1.0, 0.0]), True, "psd given by points must be positive and finite, got 0 at 2 Hz"),
    ],
)
def test_refuses_what_has_no_allan_variance(psd: object, message: str, *, sampled: bool) -> None:
    """Divergent, negative or broken densities, by a sentence that says where."""
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_psd(psd, 1, 1.0, sampled=sampled)  # type: ignore[arg-type]


def test_refuses_a_density_without_end_of_detail() -> None:
    """Noise for a density is not integrated to a random number."""
    rng = np.random.default_rng(3)
    with pytest.raises(ValueError, match=r"psd is too rough near .* Hz to be integrated; smooth it first"):
        avar_from_psd(lambda f: rng.random(f.size), 1, 1.0)


@pytest.mark.parametrize("m", [0, -1, 1.5, np.nan, np.inf])
def test_refuses_factors_that_count_nothing(m: float) -> None:
    """Both functions, with the factor in the message."""
    message = f"averaging factors must be whole numbers from 1, got {m:g}"
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_psd(lambda f: f, m, 1.0)
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_acvf([1.0], m)


@pytest.mark.parametrize("tau0", [0.0, -1.0, np.nan, np.inf])
def test_refuses_an_impossible_period(tau0: float) -> None:
    """Before the density is asked."""
    with pytest.raises(ValueError, match="tau0 must be positive and finite, got"):
        avar_from_psd(lambda f: f, 1, tau0)


@pytest.mark.parametrize(
    ("acvf", "message"),
    [
        ([1.0, 1.5], "acvf is not an autocovariance: 1.5 at lag 1, but the variance is 1"),
        ([-1.0], "acvf is not an autocovariance: -1 at lag 0, but the variance is -1"),
        ([1.0, -0.9], "acvf is not an autocovariance: the Allan variance at m = 4 would be -0.0312"),
        ([1.0, np.inf], "acvf must be finite, got inf at lag 1; a random walk has none: use its psd"),
        ([[1.0]], "acvf must have shape (k,) with at least lag 0, got (1, 1)"),
        ([], "acvf must have shape (k,) with at least lag 0, got (0,)"),
        (lambda _: 1.0, "acvf must return shape (8,) for lags of that shape, got ()"),
    ],
)
def test_refuses_what_is_no_autocovariance(acvf: object, message: str) -> None:
    """By a sentence with the lag."""
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_acvf(acvf, 4)  # type: ignore[arg-type]
