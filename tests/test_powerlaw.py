"""Tests of the four power laws: definitions, sums and expected DCT-II ordinates."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.powerlaw import PowerLaw, odd_harmonic

LAWS = list(PowerLaw)
#: Generalised variance of one sample, r(0); zero if there is none.
VARIANCES = {PowerLaw.QUANTIZATION: 2.0, PowerLaw.WHITE: 1.0, PowerLaw.FLICKER: 0.0, PowerLaw.WALK: 0.0}


def test_odd_harmonics_are_their_sum() -> None:
    """O_n = 1 + 1/3 + … + 1/(2n-1)."""
    expected = [0.0, *np.cumsum(1 / np.arange(1.0, 60.0, 2))]
    npt.assert_allclose(odd_harmonic(np.arange(31.0)), expected, rtol=1e-14)


@pytest.mark.parametrize("law", LAWS)
def test_sum_variance_follows_from_the_structure_function(law: PowerLaw) -> None:
    """V(n) = n² r(0) - sum (n - k) D(k)."""
    for n in (1, 2, 3, 10, 57):
        k = np.arange(1.0, n)
        expected = n**2 * VARIANCES[law] - float((n - k) @ law.structure(k))
        assert law.sum_variance(np.array([float(n)]))[0] == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_avar_has_its_closed_forms() -> None:
    """3/m², 1/m and (2m² + 1)/(6m); the floor of flicker noise is 2 ln 2 / pi."""
    m = np.array([1.0, 2.0, 3.0, 17.0, 500.0, 1e7])
    npt.assert_allclose(PowerLaw.QUANTIZATION.avar(m), 3 / m**2, rtol=1e-13)
    npt.assert_allclose(PowerLaw.WHITE.avar(m), 1 / m, rtol=1e-13)
    npt.assert_allclose(PowerLaw.WALK.avar(m), (2 * m**2 + 1) / (6 * m), rtol=1e-13)
    npt.assert_allclose(PowerLaw.FLICKER.avar(m)[-1], 2 * np.log(2) / np.pi, rtol=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("m", [1, 2, 7, 40])
def test_avar_is_the_integral_of_the_psd(law: PowerLaw, m: int) -> None:
    """Lemma 4.1: the mean over all frequencies of the psd times 2 sin⁴(m w/2) / (m sin(w/2))²."""
    omega = np.pi * (np.arange(400_000) + 0.5) / 400_000
    response = 2 * np.sin(m * omega / 2) ** 4 / (m * np.sin(omega / 2)) ** 2
    # Flicker's integrand has a kink at 0, which costs the midpoint rule (pi m / 400,000)².
    assert np.mean(response * law.psd(omega)) == pytest.approx(law.avar(np.array([float(m)]))[0], rel=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_functions_of_lag_are_even(law: PowerLaw) -> None:
    """D and V do not depend on the direction of time, and are 0 at 0."""
    k = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
    npt.assert_array_equal(law.structure(k), law.structure(-k))
    npt.assert_array_equal(law.sum_variance(k), law.sum_variance(-k))
    assert law.structure(k)[2] == 0
    assert law.sum_variance(k)[2] == 0


def test_flicker_approaches_its_floor() -> None:
    """The ratio to 2 ln 2 / pi is 1.4427, 1.154, 1.050, 1.0154 and 1.0013 at first."""
    ratio = PowerLaw.FLICKER.avar(np.array([1.0, 2.0, 4.0, 8.0, 32.0, 1e5])) / (2 * np.log(2) / np.pi)
    npt.assert_allclose(ratio, [1.4427, 1.154, 1.050, 1.0154, 1.0013, 1.0], atol=5e-4)


def test_a_sampled_random_walk_approaches_its_limit() -> None:
    """The limit m/3 is 0.667, 0.889, 0.970 and 0.992 of the variance at first."""
    m = np.array([1.0, 2.0, 4.0, 8.0])
    npt.assert_allclose(m / 3 / PowerLaw.WALK.avar(m), [0.667, 0.889, 0.970, 0.992], atol=5e-4)


def _from_structure(law: PowerLaw, n: int) -> FloatArray:
    """Return E[X_k²] summed over all pairs of samples; a constant has no effect, so -D/2 replaces r."""
    t = np.arange(n)
    covariance = -law.structure((t[:, None] - t).astype(np.float64)) / 2
    transform = np.sqrt(2 / n) * np.cos(np.pi * np.outer(np.arange(1, n), t + 0.5) / n)
    squares: FloatArray = np.einsum("kt,tk->k", transform @ covariance, transform.T)
    return squares


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("n", [2, 3, 40, 301])
def test_expected_ordinates_agree_with_the_double_sum(law: PowerLaw, n: int) -> None:
    """They are exact for white noise, random walk and quantization, and right to 0.05/n² for flicker."""
    single = np.arange(1, n)
    got = law.dct_spectrum(n, single, np.ones_like(single))
    tolerance = 0.05 / n**2 if law is PowerLaw.FLICKER else 1e-9
    npt.assert_allclose(got, _from_structure(law, n), rtol=tolerance)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("n", [5000, 300_000])
def test_means_over_bins_are_the_mean_of_their_ordinates(law: PowerLaw, n: int) -> None:
    """Wide bins are integrated with a relative error below 3e-8."""
    bins, single = dct_bins(n), np.arange(1, n)
    each = law.dct_spectrum(n, single, np.ones_like(single))
    expected = np.add.reduceat(each, bins.first - 1) / bins.count
    npt.assert_allclose(law.dct_spectrum(n, bins.first, bins.count), expected, rtol=3e-8)


def test_the_first_ordinates_of_flicker_are_below_its_spectrum() -> None:
    """They are 0.7737, 0.9028 and 0.9311 of 1/(2 sin(w/2))."""
    n, k = 10_000, np.array([1, 2, 3])
    share = PowerLaw.FLICKER.dct_spectrum(n, k, np.ones(3, np.int64)) * 2 * np.sin(np.pi * k / (2 * n))
    npt.assert_allclose(share, [0.7737, 0.9028, 0.9311], atol=5e-5)


@pytest.mark.parametrize(("law", "text"), list(zip(LAWS, ("Q=1", "N=1", "B=1", "K=1"), strict=True)))
def test_simulated_ordinates_have_the_expected_squares(law: PowerLaw, text: str) -> None:
    """Eighths of the spectrum of 500 series of 256 samples agree within four standard errors."""
    rng, n = np.random.default_rng(12), 256
    model = NoiseModel.parse(text)
    squares = np.array([dct_ordinates(model.simulate(n, rate_hz=1.0, rng=rng)) ** 2 for _ in range(500)])
    single = np.arange(1, n)
    ratio = squares.mean(axis=0) / law.dct_spectrum(n, single, np.ones_like(single))
    for part in np.array_split(ratio, 8):
        assert part.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / (500 * part.size)))
