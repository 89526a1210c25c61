"""Tests of confidence intervals of Allan variances: coverage, the generic fit and heavy tails."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import allan_curve
from imucal.allan.dct import bin_power, dct_bins, dct_ordinates, ramp_ordinates
from imucal.allan.intervals import (
    GenericModel,
    degrees_of_freedom,
    excess_kurtosis,
    fit_curve,
    fit_spectrum,
    gappy_degrees_of_freedom,
    less_for_heavy_tails,
    model_edf,
    spectral_edf,
)
from imucal.allan.variance import GappyVariances
from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries
from tests.benchmarks.coverage_allan import HELD_OUT, STANDARD, coverage

WHITE = GenericModel(variances=(0.0, 1.0, 0.0, 0.0))
REPLICATIONS = 250


def avar(variances: tuple[float, ...], m: FloatArray) -> FloatArray:
    """Return the Allan variance of power laws of these variances at averaging factors `m`."""
    return np.asarray(sum(v * law.avar(m) for law, v in zip(PowerLaw, variances, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize("name", STANDARD)
def test_intervals_have_the_nominal_coverage_at_every_octave(name: str) -> None:
    """The coverage of 95 % intervals in 250 series is at most four standard errors too low.

    The full study (2000 series each) is in docs/results/accuracy.md: 93.8 to 97.9 %.
    """
    _, share = coverage(STANDARD[name], REPLICATIONS, seed=1)
    assert share.min() > 0.95 - 4 * np.sqrt(0.95 * 0.05 / REPLICATIONS)
    # Octaves are correlated, so the mean over all of them has a standard error of about 1 %.
    assert 0.925 < share.mean() < 0.98


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Butterworth-4, 0.3 Nyquist", "resonance", "Laplace", "N + R"])
def test_intervals_cover_noise_beyond_power_laws(name: str) -> None:
    """The long-run coverage is at least 91 % for filtered, heavy-tailed and drifting noise."""
    _, share = coverage(HELD_OUT[name], 150, seed=2)
    assert share.min() > 0.91 - 3 * np.sqrt(0.91 * 0.09 / 150)


def test_intervals_have_the_nominal_coverage_at_68_percent() -> None:
    _, share = coverage(STANDARD["N + K"], 300, seed=3, level=0.68)
    assert share.mean() == pytest.approx(0.69, abs=0.04)


def test_degrees_of_freedom_of_white_noise_agree_with_its_model() -> None:
    """They scatter by 1 % at first, and by 10 % at m = 256, where the fitted model follows the spectrum."""
    samples = np.random.default_rng(5).standard_normal(65_536)
    m = 2 ** np.arange(15)
    edf = degrees_of_freedom(samples, m)
    exact = [model_edf(WHITE, k, 65_537 - 2 * k) for k in m.tolist()]
    npt.assert_allclose(edf[:6], exact[:6], rtol=0.05)
    npt.assert_allclose(edf, exact, rtol=0.3)


def test_the_spectral_form_is_exact_in_expectation() -> None:
    """Its mean over spectra of white noise agrees with the model's degrees of freedom to 4 %."""
    n, rng = 20_000, np.random.default_rng(15)
    bins = dct_bins(n)
    powers = [rng.chisquare(bins.count) for _ in range(50)]
    for m in (1, 5, 60):
        terms = np.array([n + 1.0 - 2 * m])
        got = [spectral_edf(power, bins, np.array([m]), terms)[0] for power in powers]
        assert np.mean(got) == pytest.approx(model_edf(WHITE, m, terms[0]), rel=0.04)


def test_heavy_tails_reduce_the_degrees_of_freedom() -> None:
    """Laplace noise has excess kurtosis 3: at m = 1 the variance of the value gains 3/n of its square."""
    rng = np.random.default_rng(6)
    normal, heavy = rng.standard_normal(100_000), rng.laplace(size=100_000)
    assert excess_kurtosis(normal) == pytest.approx(0.0, abs=4 * np.sqrt(24 / 100_000))
    assert excess_kurtosis(heavy) == pytest.approx(1.5, abs=0.15)
    before = degrees_of_freedom(normal, np.array([1]))[0]
    after = degrees_of_freedom(heavy, np.array([1]))[0]
    assert after == pytest.approx(1 / (1 / before + 3 / 2 / 100_000), rel=0.06)


def test_the_kurtosis_of_few_or_constant_samples_is_zero() -> None:
    """Two samples have only one difference, and a constant has no variance."""
    assert excess_kurtosis(np.array([1.0, 2.0])) == 0.0
    assert excess_kurtosis(np.ones(100)) == 0.0


@pytest.mark.parametrize("n", [2, 3, 4, 7, 64])
def test_short_series_have_degrees_of_freedom(n: int) -> None:
    """There is at least one degree of freedom and never NaN."""
    samples = np.random.default_rng(n).standard_normal(n)
    m = np.arange(1, n // 2 + 1)
    edf = degrees_of_freedom(samples, m)
    assert np.all(edf >= 1)
    assert np.all(np.isfinite(edf))


def test_a_constant_series_has_a_curve_of_zeros() -> None:
    """The degrees of freedom are finite, so later steps never get NaN."""
    curve = allan_curve(AxisSeries.from_samples(np.full(500, 9.81), rate_hz=1.0))
    npt.assert_allclose(curve.adev, 0.0, atol=1e-14)
    assert np.all(np.isfinite(curve.edf))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("Q=1", (1, 0, 0, 0)), ("N=2", (0, 4, 0, 0)), ("B=1", (0, 0, 1, 0)), ("K=1", (0, 0, 0, 1))],
)
def test_the_generic_fit_finds_a_single_law(text: str, expected: tuple[float, ...]) -> None:
    """The law has its true variance, and the other laws are negligible at every frequency."""
    n = 100_000
    samples = NoiseModel.parse(text).simulate(n, rate_hz=1.0, rng=np.random.default_rng(7))
    bins, ordinates = dct_bins(n), dct_ordinates(samples)
    model = fit_spectrum(ordinates, bin_power(ordinates, bins), bins)
    m = np.exp2(np.arange(10.0))
    npt.assert_allclose(avar(model.variances, m), avar(expected, m), rtol=0.08)


def test_the_generic_fit_finds_a_drift() -> None:
    """A drift of eight standard deviations is found, and white noise has none."""
    rng, n = np.random.default_rng(8), 20_000
    white = rng.standard_normal(n)
    slope = 8 * np.sqrt(12 / n**3)
    bins = dct_bins(n)
    found = []
    for samples in (white, white + slope * np.arange(n)):
        ordinates = dct_ordinates(samples)
        found.append(fit_spectrum(ordinates, bin_power(ordinates, bins), bins).drift)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(slope, rel=0.4)


def test_a_strong_drift_does_not_affect_the_noise() -> None:
    """The drift is found to its standard error, and the variances are those without a drift."""
    n, slope = 20_000, 1e-2
    white = np.random.default_rng(12).standard_normal(n)
    bins = dct_bins(n)
    plain, steep = (
        fit_spectrum(ordinates, bin_power(ordinates, bins), bins)
        for ordinates in (dct_ordinates(white), dct_ordinates(white + slope * np.arange(n)))
    )
    assert steep.drift == pytest.approx(slope, abs=4 * np.sqrt(12 / n**3))
    m = np.exp2(np.arange(10.0))
    npt.assert_allclose(avar(steep.variances, m), avar(plain.variances, m), rtol=0.02)


def test_the_generic_fit_recovers_an_exact_curve() -> None:
    m = np.exp2(np.arange(12.0))
    truth = avar((3.0, 1.0, 0.0, 1e-5), m)
    npt.assert_allclose(avar(fit_curve(m, truth, 1e4 / m).variances, m), truth, rtol=1e-6)


@pytest.mark.parametrize("m", [1, 24, 25, 26, 40])
def test_tails_count_while_there_are_enough_windows(m: int) -> None:
    """For n = 99 this is n - 2m + 1 >= 2m, or m <= 25; then Var gains kappa/n of the square."""
    samples = np.random.default_rng(13).laplace(size=99)
    steps = np.diff(samples)
    steps -= steps.mean()
    kappa = 2 * (np.mean(steps**4) / np.mean(steps**2) ** 2 - 3)
    assert kappa > 0.5
    expected = 10 / (1 + kappa * 10 / (2 * (100 - 2 * m))) if m <= 25 else 10.0
    found = less_for_heavy_tails(np.array([10.0]), samples, np.array([m]))[0]
    assert found == pytest.approx(expected)


def test_the_lightest_tails_are_uniform() -> None:
    """Two alternating values have an excess of -2, but -1.2 is used."""
    samples = np.cumsum(np.resize([1.0, -1.0], 400))
    found = less_for_heavy_tails(np.array([10.0]), samples, np.array([1]))[0]
    assert found == pytest.approx(10 / (1 - 1.2 * 10 / (2 * 399)))


def test_tails_of_a_record_with_gaps_use_adjacent_samples_only() -> None:
    """Normal samples with level steps at gaps have the same degrees of freedom as on one level."""
    rng = np.random.default_rng(14)
    keep = np.ones(2000, dtype=bool)
    keep[100::100] = False
    levels = np.where(np.arange(2000) // 100 % 2 == 0, 0.0, 20.0)
    noise = {"normal": rng.standard_normal(2000), "laplace": rng.laplace(size=2000)}
    values = GappyVariances(m=np.array([1]), avar=np.ones(1), terms=np.full(1, 1900.0), inflation=np.ones(1))
    edf = {}
    for name, samples in noise.items():
        for kind, extra in (("flat", 0.0), ("stepped", levels)):
            series = AxisSeries.from_samples(samples + extra, rate_hz=1.0).keeping(keep)
            edf[name, kind] = gappy_degrees_of_freedom(series, values)[0]
    for name in noise:
        assert edf[name, "stepped"] == pytest.approx(edf[name, "flat"], rel=1e-3)
    assert edf["laplace", "flat"] < 0.6 * edf["normal", "flat"]


def test_the_degrees_of_freedom_fall_with_the_square_of_the_inflation() -> None:
    """An inflation of 2 leaves a quarter of the degrees of freedom for samples with normal tails."""
    samples = np.random.default_rng(16).standard_normal(500)
    keep = np.ones(500, dtype=bool)
    keep[250] = False
    series = AxisSeries.from_samples(samples, rate_hz=1.0).keeping(keep)
    one = GappyVariances(
        m=np.array([200]), avar=np.ones(1), terms=np.full(1, 9000.0), inflation=np.array([1.0])
    )
    plain, inflated = (
        gappy_degrees_of_freedom(series, replace(one, inflation=np.array([by])))[0] for by in (1.0, 2.0)
    )
    assert inflated == pytest.approx(plain / 4)


def test_a_drift_in_coloured_noise_agrees_with_generalised_least_squares() -> None:
    """The weights are the inverse of the fitted spectrum."""
    n = 5000
    samples = NoiseModel.parse("N=1 + K=1e-2").simulate(n, rate_hz=1.0, rng=np.random.default_rng(17))
    bins, ordinates = dct_bins(n), dct_ordinates(samples + 0.02 * np.arange(n))
    model = fit_spectrum(ordinates, bin_power(ordinates, bins), bins)
    basis = np.array([law.dct_spectrum(n, bins.first, bins.count) for law in PowerLaw])[:, :20]
    assert np.all(bins.count[:20] == 1)
    spectrum, shape = model.variances @ basis, ramp_ordinates(n, 20)
    expected = np.sum(ordinates[:20] * shape / spectrum) / np.sum(shape**2 / spectrum)
    assert model.drift == pytest.approx(expected, rel=1e-3)
