"""The facade: fit(series) by every method."""

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
    """The contract of a fit: N, B and K with limits, the curve, the level, the method's name."""
    result = fit(series(), method=method)
    assert result.method == method
    assert result.level == 0.95
    assert result.curve.n == N
    for key in ("N", "B", "K"):
        estimate = result[key]
        assert 0 <= estimate.low <= estimate.high
        assert (estimate.value is None) == (estimate.status == "bounded")
    assert result["N"].value == pytest.approx(1e-3, rel=0.05)


def test_passes_a_curve_on() -> None:
    """A curve that was computed already is not computed again."""
    data = series()
    curve = allan_curve(data, taus="decade")
    assert fit(data, curve=curve).curve is curve


def test_spikes_are_replaced_counted_and_gone_from_the_curve() -> None:
    """Spikes of a hundred standard deviations change N by less than 1 %, and are reported."""
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
    """The curve of the cleaned samples stands at the same times as the one that was given."""
    data = series()
    samples = data.samples.copy()
    samples[1234] += 1.0
    wild = AxisSeries.from_samples(samples, rate_hz=100.0)
    given = allan_curve(wild, taus="decade")
    np.testing.assert_array_equal(fit(wild, curve=given).curve.m, given.m)


def test_temperature_goes_with_the_samples_that_are_finite() -> None:
    """Samples that are not finite take their temperature with them."""
    data = series()
    samples = data.samples.copy()
    samples[100:105] = np.nan
    broken = AxisSeries.from_samples(samples, rate_hz=100.0)
    result = fit(broken, temperature=np.linspace(20, 30, N))
    assert result["N"].value == pytest.approx(1e-3, rel=0.05)


def test_a_line_is_named_and_left_out() -> None:
    """A tone of the size of the noise does not change N, and its frequency is in a sentence."""
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
def test_a_setting_that_is_not_known_is_refused(setting: dict[str, Any], message: str) -> None:
    """Where it is given: nothing is read or computed before."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        FitSettings(**setting)


def test_a_curve_alone_is_too_little_for_maximum_likelihood() -> None:
    """The message names the methods that can do with a curve."""
    with pytest.raises(ValueError, match=r"^maximum likelihood needs the samples, got an Allan curve; use "):
        fit(allan_curve(series()))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_in_its_listed_place(method: str) -> None:
    """A new method is a file and a line of the table; its folder has to offer the function."""
    folder, function = METHODS[method]
    offered = importlib.import_module(folder)
    assert function in offered.__all__, f"{method}: {folder}/__init__.py has to offer {function}"


def test_what_is_not_asked_for_is_decided_so() -> None:
    """The defaults of the facade and of the command line."""
    asked = FitSettings()
    assert (asked.model, asked.method, asked.level, asked.criterion) == ("auto", "mle", 0.95, "chance")
    assert (asked.weights, asked.max_gm, asked.clean) == ("full", 2, True)
