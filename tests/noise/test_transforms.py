"""Tests of the Allan variance of any psd and any autocovariance: closed forms, invariances and errors."""

import re
from functools import partial

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucal.arrays import FloatArray
from imucal.noise.integrals import avar_from_acvf, avar_from_psd
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import GaussMarkov
from tests.noise.test_terms import STOCHASTIC, TAU0, ids
from tests.slow_cases import first_by_default

#: Short and long, odd and even factors, up to values where a sum over frequencies would be too slow.
M = np.array([1, 2, 3, 7, 64, 1000, 12_345, 1_000_000])


def moving_average_avar(theta: float, variance: float, m: FloatArray) -> FloatArray:
    """Return (1 + theta²) s²/m² (m + (2m - 3) theta/(1 + theta²)), the example of lemma 4.2."""
    plain = 1 + theta**2
    return np.asarray(plain * variance / m**2 * (m + (2 * m - 3) * theta / plain))


@pytest.mark.parametrize("term", STOCHASTIC, ids=ids)
def test_the_integral_of_each_terms_psd_is_its_closed_form(term: NoiseTerm) -> None:
    """The tolerance is 1e-10 for every term, singular at 0 or not."""
    got = avar_from_psd(lambda f: term.psd(f, TAU0), M, TAU0)
    npt.assert_allclose(got, term.avar(M.astype(np.float64), TAU0), rtol=1e-10)


def test_the_integral_agrees_with_a_sum_over_many_frequencies() -> None:
    """The reference is the midpoint rule for a density without a closed form."""

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
def test_the_continuous_time_integral_agrees_with_ieee_952(slope: float, expected: object) -> None:
    """Annex C: N²/tau, 4 ln 2 for 1/f, K² tau/3, at every tau."""
    assert callable(expected)
    got = avar_from_psd(lambda f: f**slope, M, TAU0, sampled=False)
    npt.assert_allclose(got, expected(M * TAU0), rtol=1e-10)


@pytest.mark.parametrize("theta", first_by_default([-0.4, 1.0, 3.0, 0.0, 0.5, -1.0], 4))
def test_a_moving_average_has_its_closed_form(theta: float) -> None:
    """The inputs are the psd s² tau0 (1 + theta² + 2 theta cos w) and the autocovariance."""
    tau0, variance, m = 0.02, 2.5, np.array([1, 2, 3, 10, 999, 50_000])
    expected = moving_average_avar(theta, variance, m.astype(np.float64))
    by_psd = avar_from_psd(
        lambda f: variance * tau0 * (1 + theta**2 + 2 * theta * np.cos(2 * np.pi * f * tau0)), m, tau0
    )
    by_acvf = avar_from_acvf([variance * (1 + theta**2), variance * theta], m)
    # At theta = -1, all but 3/m² of m cancels, so the closed form has rounding errors too.
    npt.assert_allclose(by_psd, expected, rtol=1e-9)
    npt.assert_allclose(by_acvf, expected, rtol=1e-9)


@pytest.mark.parametrize("time", [0.5, 100.0, 1e7])
def test_the_autocovariance_of_gauss_markov_gives_its_closed_form(time: float) -> None:
    """Adjacent autocovariances of a slow term are nearly equal."""
    term, m = GaussMarkov(sigma=0.3, T=time), M[:-1]
    got = avar_from_acvf(lambda k: 0.09 * np.exp(-k / time), m)
    # r_0 - r_k is about 1e-7 of r_0 at T = 1e7, so nine digits remain in double precision.
    npt.assert_allclose(got, term.avar(m.astype(np.float64), 1.0), rtol=1e-10 if time < 1e6 else 1e-7)


def test_the_value_agrees_with_the_covariance_matrix_of_samples() -> None:
    """It is half the mean square of the difference between adjacent averages."""
    acvf, m = np.array([2.0, -0.7, 0.3, 0.1]), 5
    lag = np.abs(np.subtract.outer(np.arange(2 * m), np.arange(2 * m)))
    covariance = np.where(lag < 4, acvf[np.minimum(lag, 3)], 0.0)
    contrast = np.repeat([1 / m, -1 / m], m)
    assert avar_from_acvf(acvf, m) == pytest.approx(float(contrast @ covariance @ contrast) / 2)


def test_allan_variances_of_sums_of_psds_add_up() -> None:
    model = NoiseModel.parse("N=1e-3 + B=3e-4 + K=4e-5 + GM(sigma=2e-4, T=0.7) + Q=2e-5")
    m = np.array([1, 30, 4000])
    parts = [avar_from_psd(partial(term.psd, tau0=TAU0), m, TAU0) for term in model.terms]
    total = avar_from_psd(lambda f: model.psd(f, rate_hz=1 / TAU0), m, TAU0)
    npt.assert_allclose(total, np.sum(parts, axis=0), rtol=1e-10)


@settings(deadline=None, max_examples=8)
@given(gain=st.floats(1e-12, 1e12), period=st.floats(1e-6, 1e3), slope=st.floats(-2.8, 0.0))
def test_the_integral_scales_with_units(gain: float, period: float, slope: float) -> None:
    """The density c S has c times the Allan variance; S(f tau0) tau0 has the same at scaled times."""
    m = np.array([1, 9])
    base = avar_from_psd(lambda f: f**slope, m, 1.0)
    npt.assert_allclose(avar_from_psd(lambda f: gain * f**slope, m, 1.0), gain * base, rtol=1e-9)
    scaled = avar_from_psd(lambda f: (f * period) ** slope * period, m, period)
    npt.assert_allclose(scaled, base, rtol=1e-8)


def test_jumps_and_lines_are_integrated() -> None:
    """The density ends abruptly, or has a line with 1e-6 of the band's width at a given break."""
    # The reference below 0.1234 of the rate is a plain sum over lags of the autocovariance.
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


def test_points_are_interpolated_in_log_log() -> None:
    """A power law given by two points stays that power law, and a scalar m gives a scalar."""
    f = np.array([1e-9, 50.0])
    # The density is constant below the first point, so that point is at 1e-9 Hz.
    got = avar_from_psd((f, 1 / f), 10, 0.01)
    assert got.shape == ()
    assert got == pytest.approx(avar_from_psd(lambda f: 1 / f, 10, 0.01), rel=1e-12)


def test_shapes_are_kept() -> None:
    """Factors may have any shape, be unsorted, repeated or empty."""
    m = np.array([[4, 1], [1, 4]])
    for got in (avar_from_psd(lambda f: 1 + 0 * f, m, 1.0), avar_from_acvf([1.0], m)):
        npt.assert_allclose(got, 1 / m, rtol=1e-12)
    assert avar_from_psd(lambda f: 1 + 0 * f, [], 1.0).shape == (0,)
    assert avar_from_acvf([1.0], []).shape == (0,)


def test_two_densities_have_the_same_curve() -> None:
    """Phi(f) = 2 Phi(2f) integrates to zero over an octave: 1/f and (1/f)(1 + 0.8 cos(2 pi log2 f))."""
    plain = avar_from_psd(lambda f: 1 / f, M, TAU0, sampled=False)
    rippled = avar_from_psd(lambda f: (1 + 0.8 * np.cos(2 * np.pi * np.log2(f))) / f, M, TAU0, sampled=False)
    npt.assert_allclose(rippled, plain, rtol=1e-9)
    # A ripple with another period changes the curve, so the agreement is no numerical artefact.
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
def test_densities_without_an_allan_variance_are_rejected(
    psd: object, message: str, *, sampled: bool
) -> None:
    """They diverge, are negative or not finite; the error states the frequency."""
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_psd(psd, 1, 1.0, sampled=sampled)  # type: ignore[arg-type]


def test_a_noisy_density_is_rejected() -> None:
    """It must not be integrated to a random number."""
    rng = np.random.default_rng(3)
    with pytest.raises(ValueError, match=r"psd is too rough near .* Hz to be integrated; smooth it first"):
        avar_from_psd(lambda f: rng.random(f.size), 1, 1.0)


@pytest.mark.parametrize("m", [0, -1, 1.5, np.nan, np.inf])
def test_invalid_averaging_factors_are_rejected(m: float) -> None:
    """The error contains the factor, for both functions."""
    message = f"averaging factors must be whole numbers from 1, got {m:g}"
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_psd(lambda f: f, m, 1.0)
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_acvf([1.0], m)


@pytest.mark.parametrize("tau0", [0.0, -1.0, np.nan, np.inf])
def test_an_invalid_sampling_period_is_rejected(tau0: float) -> None:
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
def test_invalid_autocovariances_are_rejected(acvf: object, message: str) -> None:
    """The error contains the lag."""
    with pytest.raises(ValueError, match=re.escape(message)):
        avar_from_acvf(acvf, 4)  # type: ignore[arg-type]
