"""Tests of the finding spectral-ambiguity: the spectrum is not available or contradicts the model."""

import re

import numpy as np
import pytest
from scipy.fft import idct
from scipy.stats import chi2, norm

from imucal import AxisSeries, allan_curve, fit
from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.cross_checks import _scores
from imucal.noise.integrals import avar_from_psd
from imucal.pipeline import Settings, characterize
from imucal.recording import Recording, Source
from tests.fitting.fits import simulated

RATE = 100.0


def flicker(f: FloatArray) -> FloatArray:
    """Return the density of white noise of 1e-6 plus flicker noise of 1e-6/f."""
    return np.asarray(1e-6 + 1e-6 / f)


def rippled(f: FloatArray) -> FloatArray:
    """Return the flicker density with a ripple Phi(f) = 2 Phi(2f): 0.8 of the flicker, once per octave."""
    return np.asarray(flicker(f) + 0.8e-6 / f * np.cos(2 * np.pi * np.log2(f)))


def _drawn(n: int, seed: int) -> AxisSeries:
    """Return samples of the rippled density, drawn by ordinate."""
    f = np.arange(1, n) / (2 * n) * RATE
    ordinates = np.sqrt(rippled(f) * RATE) * np.random.default_rng(seed).standard_normal(n - 1)
    samples: FloatArray = idct(np.concatenate([[0.0], ordinates]), norm="ortho")
    return AxisSeries.from_samples(samples, rate_hz=RATE)


def _ambiguities(findings: tuple[Finding, ...]) -> list[Finding]:
    return [finding for finding in findings if finding.code == "spectral-ambiguity"]


def test_both_densities_have_the_same_allan_curve() -> None:
    """They agree to nine digits in continuous time, and to 2 % for sampled data far from Nyquist."""
    m = np.array([1, 10, 500])
    one, other = (avar_from_psd(psd, m, 1 / RATE, sampled=False) for psd in (flicker, rippled))
    np.testing.assert_allclose(other, one, rtol=1e-9)
    m = 2 ** np.arange(3, 15)
    one, other = (avar_from_psd(psd, m, 1 / RATE) for psd in (flicker, rippled))
    np.testing.assert_allclose(other, one, rtol=0.02)


@pytest.mark.parametrize("method", ["gmwm", "slope"])
def test_a_fit_without_a_spectrum_is_reported(method: str) -> None:
    """The finding has the level info and appears once."""
    curve = allan_curve(AxisSeries.from_samples(simulated("N=1 + K=0.01", 20_000, 71), rate_hz=1.0))
    (ambiguity,) = _ambiguities(fit(curve, method=method, model="N + K").findings)
    assert ambiguity.level == "info"
    assert "so the spectrum was not checked" in ambiguity.text


def test_a_ripple_that_the_curve_hides_is_found_in_the_spectrum() -> None:
    """The curve fits flicker noise without a misfit; only the spectral likelihood reports one."""
    series = _drawn(2**18, 72)
    found = fit(series, method="gmwm", model="N + B")
    assert found.goodness.statistic < 3
    assert found["B"].value == pytest.approx(np.sqrt(2 * np.pi * 1e-6), rel=0.1)
    (ambiguity,) = _ambiguities(found.findings)
    assert ambiguity.level == "warning"
    assert ambiguity.text.startswith("N + B describes the Allan curve but not the spectrum: between ")
    assert any(finding.code == "model-misfit" for finding in fit(series, model="N + B").findings)


def test_the_report_contains_the_finding() -> None:
    """Only the selected method adds the finding; the second opinion of the default method does not."""
    series = _drawn(2**18, 73)
    recording = Recording(source=Source(path="log", format="csv"), series=(series,))
    report = characterize(recording, Settings(method="gmwm", model="N + B"))
    (ambiguity,) = _ambiguities(report.all_findings)
    assert ambiguity.axis == "gyro_x"
    assert not _ambiguities(characterize(recording, Settings(model="N + B")).all_findings)


@pytest.mark.parametrize(
    "text",
    ["N=1", "N=1 + K=0.01", "N=1 + B=0.2 + K=0.003", "N=1 + GM(sigma=0.3, T=50)", "Q=1 + N=1 + R=1e-2"],
)
def test_a_spectrum_that_agrees_with_the_model_has_no_ambiguity(text: str) -> None:
    """Six records of each model have no finding."""
    model = re.sub(r"(\w+)(=[^ ]+|\(.*\))", r"\1", text)
    for seed in range(740, 746):
        series = AxisSeries.from_samples(simulated(text, 8192, seed), rate_hz=1.0)
        assert _ambiguities(fit(series, method="gmwm", model=model).findings) == []


@pytest.mark.parametrize("count", [8, 40, 200])
def test_the_scores_of_chi_squared_means_are_standard_normal(count: int) -> None:
    """Wilson and Hilferty's cube root has an error below 0.05 between the quantiles of 0.02 and 0.98."""
    p = np.array([0.02, 0.2, 0.5, 0.8, 0.98])
    found = _scores(chi2.ppf(p, count) / count, np.full(5, float(count)))
    np.testing.assert_allclose(found, norm.ppf(p), atol=0.05)
