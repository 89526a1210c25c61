"""What a curve can't tell is said: with no spectrum, and with one that contradicts the model."""

import re

import numpy as np
import pytest
from scipy.fft import idct
from scipy.stats import chi2, norm

from imucal import AxisSeries, Finding, allan_curve, avar_from_psd, characterize, fit
from imucal.arrays import FloatArray
from imucal.fitting.cross_checks import _scores
from imucal.pipeline import Settings
from imucal.recording import Recording, Source
from tests.fitting.fits import simulated

RATE = 100.0


def flicker(f: FloatArray) -> FloatArray:
    """White noise of 1e-6 and flicker of 1e-6/f."""
    return np.asarray(1e-6 + 1e-6 / f)


def rippled(f: FloatArray) -> FloatArray:
    """Add Phi(f) = 2 Phi(2f): 0.8 of the flicker, once an octave."""
    return np.asarray(flicker(f) + 0.8e-6 / f * np.cos(2 * np.pi * np.log2(f)))


def _drawn(n: int, seed: int) -> AxisSeries:
    """Return samples of the rippled density, drawn ordinate by ordinate."""
    f = np.arange(1, n) / (2 * n) * RATE
    ordinates = np.sqrt(rippled(f) * RATE) * np.random.default_rng(seed).standard_normal(n - 1)
    samples: FloatArray = idct(np.concatenate([[0.0], ordinates]), norm="ortho")
    return AxisSeries.from_samples(samples, rate_hz=RATE)


def _said(findings: tuple[Finding, ...]) -> list[Finding]:
    return [finding for finding in findings if finding.code == "spectral-ambiguity"]


def test_the_two_densities_have_one_curve() -> None:
    """In continuous time to nine digits; sampled, from some m on, where the band's end is far."""
    m = np.array([1, 10, 500])
    one, other = (avar_from_psd(psd, m, 1 / RATE, sampled=False) for psd in (flicker, rippled))
    np.testing.assert_allclose(other, one, rtol=1e-9)
    m = 2 ** np.arange(3, 15)
    one, other = (avar_from_psd(psd, m, 1 / RATE) for psd in (flicker, rippled))
    np.testing.assert_allclose(other, one, rtol=0.02)


@pytest.mark.parametrize("method", ["gmwm", "slope"])
def test_a_curve_alone_is_reported_as_a_curve(method: str) -> None:
    """By info, once, with what to do."""
    curve = allan_curve(AxisSeries.from_samples(simulated("N=1 + K=0.01", 20_000, 71), rate_hz=1.0))
    (said,) = _said(fit(curve, method=method, model="N + K").findings)
    assert said.level == "info"
    assert "so the spectrum was not checked" in said.text


def test_a_ripple_that_the_curve_hides_is_found_in_the_spectrum() -> None:
    """The curve's fit is content, its numbers are those of flicker; the likelihood sees the misfit."""
    series = _drawn(2**18, 72)
    found = fit(series, method="gmwm", model="N + B")
    assert found.goodness.statistic < 3
    assert found["B"].value == pytest.approx(np.sqrt(2 * np.pi * 1e-6), rel=0.1)
    (said,) = _said(found.findings)
    assert said.level == "warning"
    assert said.text.startswith("N + B describes the Allan curve but not the spectrum: between ")
    assert any(finding.code == "model-misfit" for finding in fit(series, model="N + B").findings)


def test_a_characterised_log_is_reported() -> None:
    """With the method that was asked for; not by the second opinion of the default."""
    series = _drawn(2**18, 73)
    recording = Recording(source=Source(path="log", format="csv"), series=(series,))
    report = characterize(recording, Settings(method="gmwm", model="N + B"))
    (said,) = _said(report.all_findings)
    assert said.axis == "gyro_x"
    assert not _said(characterize(recording, Settings(model="N + B")).all_findings)


@pytest.mark.parametrize(
    "text",
    ["N=1", "N=1 + K=0.01", "N=1 + B=0.2 + K=0.003", "N=1 + GM(sigma=0.3, T=50)", "Q=1 + N=1 + R=1e-2"],
)
def test_what_has_the_spectrum_of_its_model_is_let_alone(text: str) -> None:
    """Six records of each model: nothing is said."""
    model = re.sub(r"(\w+)(=[^ ]+|\(.*\))", r"\1", text)
    for seed in range(740, 746):
        series = AxisSeries.from_samples(simulated(text, 8192, seed), rate_hz=1.0)
        assert _said(fit(series, method="gmwm", model=model).findings) == []


@pytest.mark.parametrize("count", [8, 40, 200])
def test_the_scores_of_chi_squared_means_are_standard_normal(count: int) -> None:
    """Wilson and Hilferty's cube root has an error below 0.05 between the quantiles of 0.02 and 0.98."""
    p = np.array([0.02, 0.2, 0.5, 0.8, 0.98])
    found = _scores(chi2.ppf(p, count) / count, np.full(5, float(count)))
    np.testing.assert_allclose(found, norm.ppf(p), atol=0.05)
