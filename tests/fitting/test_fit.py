"""Tests of the facade: fit(series) with every method."""

import importlib
import re
from typing import Any

import numpy as np
import pytest

from imucal.allan import allan_curve
from imucal.fitting import METHODS, FitSettings, fit
from imucal.recording import AxisSeries
from tests.fitting.fits import simulated

TEXT = "N=1e-3 + K=4e-4"
N = 40_000


def series(seed: int = 1) -> AxisSeries:
    return AxisSeries.from_samples(simulated(TEXT, N, seed, rate_hz=100.0), rate_hz=100.0)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_reports_n_b_and_k(method: str) -> None:
    """A fit contains N, B and K with limits, the curve, the level and the name of the method."""
    result = fit(series(), method=method)
    assert result.method == method
    assert result.level == 0.95
    assert result.curve.n == N
    for key in ("N", "B", "K"):
        estimate = result[key]
        assert 0 <= estimate.low <= estimate.high
        assert (estimate.value is None) == (estimate.status == "bounded")
    assert result["N"].value == pytest.approx(1e-3, rel=0.05)


def test_a_given_curve_is_not_computed_again() -> None:
    data = series()
    curve = allan_curve(data, taus="decade")
    assert fit(data, curve=curve).curve is curve


def test_spikes_are_replaced_and_reported() -> None:
    """Spikes of a hundred standard deviations hardly change N and are not in the curve."""
    data = series()
    samples = data.samples.copy()
    places = np.random.default_rng(2).choice(N, 40, replace=False)
    samples[places] += 1.0
    wild = AxisSeries.from_samples(samples, rate_hz=100.0)
    clean, dirty = fit(wild, model="N + K"), fit(wild, model="N + K", clean=False)
    assert clean["N"].value == pytest.approx(1e-3, rel=0.02)
    assert (dirty["N"].value or 0) > 1.5e-3
    assert clean.findings[0].code == "spikes"
    assert clean.curve.avar[0] < 0.5 * dirty.curve.avar[0]


def test_a_cleaned_series_keeps_the_averaging_times_of_its_curve() -> None:
    data = series()
    samples = data.samples.copy()
    samples[1234] += 1.0
    wild = AxisSeries.from_samples(samples, rate_hz=100.0)
    given = allan_curve(wild, taus="decade")
    np.testing.assert_array_equal(fit(wild, curve=given).curve.m, given.m)


def test_the_temperature_of_non_finite_samples_is_dropped() -> None:
    data = series()
    samples = data.samples.copy()
    samples[100:105] = np.nan
    broken = AxisSeries.from_samples(samples, rate_hz=100.0)
    result = fit(broken, temperature=np.linspace(20, 30, N))
    assert result["N"].value == pytest.approx(1e-3, rel=0.05)


def test_a_line_is_reported_and_excluded() -> None:
    """A tone as large as the noise does not change N."""
    data = series()
    tone = 5e-3 * np.sin(2 * np.pi * 12.34 * np.arange(N) / 100)
    result = fit(AxisSeries.from_samples(data.samples + tone, rate_hz=100.0), model="N + K")
    assert result["N"].value == pytest.approx(1e-3, rel=0.02)
    assert result.goodness.lines[0].frequency_hz == pytest.approx(12.34, abs=0.01)
    text = next(f.text for f in result.findings if f.code == "line")
    assert text.startswith("Line at 12.34 Hz (amplitude 0.005")


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"method": "ols"}, "method 'ols' is not one of mle, gmwm, slope"),
        ({"criterion": "dic"}, "criterion 'dic' is not one of chance, bic, hq, aic"),
        ({"weights": "none"}, "weights 'none' is not one of full, eta3"),
        ({"level": 1.0}, "level must be between 0 and 1, got 1.0"),
        ({"max_gm": 3}, "max_gm must be 0, 1 or 2, got 3"),
        ({"segments": 0}, "segments must be from 1 (not compared) to 64, got 0"),
        ({"segments": 65}, "segments must be from 1 (not compared) to 64, got 65"),
    ],
)
def test_unknown_settings_are_rejected(setting: dict[str, Any], message: str) -> None:
    """The error is raised before any calculation."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        FitSettings(**setting)


def test_maximum_likelihood_rejects_a_curve() -> None:
    """The error lists the methods that accept a curve."""
    with pytest.raises(ValueError, match=r"^maximum likelihood needs the samples, got an Allan curve; use "):
        fit(allan_curve(series()))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_importable_from_its_folder(method: str) -> None:
    """A new method needs a file, a line in the table, and an export in its folder."""
    folder, function = METHODS[method]
    offered = importlib.import_module(folder)
    assert function in offered.__all__, f"{method}: {folder}/__init__.py has to offer {function}"


def test_the_default_settings() -> None:
    """The facade and the command line share these defaults."""
    defaults = FitSettings()
    assert (defaults.model, defaults.method, defaults.level, defaults.criterion) == (
        "auto",
        "mle",
        0.95,
        "chance",
    )
    assert (defaults.weights, defaults.max_gm, defaults.clean) == ("full", 2, True)
