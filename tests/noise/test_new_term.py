"""Tests that a new term needs only a class and a line in the table, and is rejected where unsupported."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.testing as npt
import pytest
from click.testing import CliRunner

import imucal
from imucal.arrays import FloatArray
from imucal.checking.limits import quantity_units
from imucal.cli import imucal as command
from imucal.fitting import METHODS
from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.precision import relative_deviations
from imucal.noise.model import NoiseModel, parse_structure
from imucal.noise.term import Description, NoiseTerm, Stroke
from imucal.noise.terms import TERMS, term_keys
from imucal.planning import plan
from imucal.recording import AxisSeries, Sensor
from imucal.report.figure_curves import estimate_text
from imucal.report.numbers import sheet_units
from imucal.report.page import glossary_section
from tests.noise.contract import missing
from tests.report.synthetic import consumer_report

pytestmark = pytest.mark.usefixtures("new_terms")


@dataclass(frozen=True, kw_only=True)
class Sinusoid(NoiseTerm):
    """A sine of amplitude A and period P in s, of random phase: a thermostat, a motor."""

    symbol = "S"
    names = ("sinusoid", "sinusoid")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "ug")
    divisors: ClassVar[dict[str, float]] = {"": 1.0}
    stroke = Stroke("#555555", "#aaaaaa", (1, 1))
    description = Description(
        "lobes at odd halves of its period", "a cycle of the surroundings", "line, tone"
    )
    amplitude: float
    period: float

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        turned: FloatArray = np.asarray(k, dtype=np.float64) * 2 * np.pi * tau0 / self.period
        return self.amplitude**2 * (1 - np.cos(turned))

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:  # noqa: ARG002 - all its power is at one frequency
        return np.zeros_like(np.asarray(f, dtype=np.float64))

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        phase = rng.uniform(0, 2 * np.pi)
        turned: FloatArray = 2 * np.pi * tau0 / self.period * np.arange(n, dtype=np.float64) + phase
        return self.amplitude * np.sin(turned)


@dataclass(frozen=True, kw_only=True)
class SecondOrder(NoiseTerm):
    """Second-order Gauss-Markov: autocovariance sigma² (1 + k/T) exp(-k/T)."""

    symbol = "SGM"
    names = ("second-order Gauss-Markov", "second-order Gauss-Markov")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "ug")
    stroke = Stroke("#222222", "#dddddd", (4, 1))
    description = Description("a hump", "a bias that forgets smoothly", "AR2")
    repeatable = True
    sigma: float
    T: float

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        a = np.abs(np.asarray(k)) * tau0 / self.T
        shape: FloatArray = 2 * (1 - (1 + a) * np.exp(-a))
        return self.sigma**2 * shape

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        lags = np.arange(1, round(40 * self.T / tau0))[:, np.newaxis]
        a = lags * tau0 / self.T
        wave = np.cos(2 * np.pi * np.asarray(f) * lags * tau0)
        total: FloatArray = 1 + 2 * np.sum((1 + a) * np.exp(-a) * wave, axis=0)
        return self.sigma**2 * tau0 * total

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * tau0 / self.T
        root = np.linalg.cholesky((1 + lags) * np.exp(-lags) + 1e-10 * np.eye(n))
        drawn: FloatArray = root @ rng.normal(size=n)
        return self.sigma * drawn


NEW = {"S": "S(amplitude=0.5, period=4.0)", "SGM": "SGM(sigma=0.3, T=0.5)"}


@pytest.fixture
def new_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the terms to the table."""
    for term in (Sinusoid, SecondOrder):
        monkeypatch.setitem(TERMS, term.symbol, term)


@pytest.mark.parametrize("text", NEW.values())
def test_a_new_term_is_parsed_and_written(text: str) -> None:
    """The fields of the dataclass are the syntax."""
    model = NoiseModel.parse(f"N=1e-3 + {text}")
    assert model.terms[1].text() == text
    assert NoiseModel.parse(model.text()) == model
    assert str(model) == f"N + {model.terms[1].symbol}"
    assert parse_structure(f"{model.terms[1].symbol} + N") == ("N", model.terms[1].symbol)


def test_a_model_may_only_repeat_terms_that_allow_it() -> None:
    """There is one sinusoid, but several numbered second-order terms."""
    with pytest.raises(ValueError, match="S appears more than once; only GM and SGM may"):
        parse_structure("2*S")
    assert term_keys(parse_structure("2*SGM + N")) == ("N", "SGM1", "SGM2")
    assert SecondOrder.parameter_names("SGM2") == ("SGM2.sigma", "SGM2.T")


@pytest.mark.parametrize(("symbol", "text"), NEW.items())
def test_the_curve_of_a_new_term_follows_from_its_structure_function(symbol: str, text: str) -> None:
    """The mean of many simulated curves agrees with the Allan variance of the base class."""
    model = NoiseModel.parse(text)
    m = np.array([1, 3, 20, 60])
    expected = model.avar(m.astype(np.float64), rate_hz=10.0)
    rng = np.random.default_rng(8)
    found = [
        imucal.allan_curve(
            AxisSeries.from_samples(model.simulate(600, rate_hz=10.0, rng=rng), rate_hz=10.0),
            taus=(m / 10).tolist(),
        ).avar
        for _ in range(60)
    ]
    # The slowest point has about five independent values per record, so 60 records give 12 %.
    npt.assert_allclose(np.mean(found, axis=0), expected, rtol=0.4 if symbol == "SGM" else 0.05)


def test_the_sinusoid_has_its_published_allan_variance() -> None:
    """A² sin⁴(pi f m) / (m sin(pi f))², f in cycles per sample."""
    m = np.array([1.0, 5.0, 33.0])
    found = NoiseModel.parse("S(amplitude=2.0, period=4.0)").avar(m, rate_hz=10.0)
    npt.assert_allclose(found, 4 * np.sin(np.pi * m / 40) ** 4 / (m * np.sin(np.pi / 40)) ** 2, rtol=1e-9)


@pytest.mark.parametrize("symbol", NEW)
@pytest.mark.parametrize("method", METHODS)
def test_each_method_rejects_an_unsupported_term(symbol: str, method: str) -> None:
    """The error contains advice, and no other model is fitted instead."""
    series = AxisSeries.from_samples(np.random.default_rng(1).normal(size=4096), rate_hz=100.0)
    with pytest.raises(ValueError, match=f"^method '{method}' can't fit {symbol} \\(.*; leave {symbol} out"):
        imucal.fit(series, model=f"N + {symbol}", method=method)


def test_auto_does_not_try_an_unsupported_term() -> None:
    series = AxisSeries.from_samples(np.random.default_rng(2).normal(size=4096), rate_hz=100.0)
    for method in METHODS:
        assert str(imucal.fit(series, method=method).model) == "N"


def test_the_command_line_simulates_and_rejects_an_unsupported_term(tmp_path: Path) -> None:
    """`simulate` writes its log; `fit` exits as for any invalid option."""
    log = tmp_path / "cycle.csv"
    simulated = CliRunner().invoke(
        command, ["simulate", f"N=1e-3 + {NEW['S']}", "--duration", "20s", "-o", str(log)]
    )
    assert simulated.exit_code == 0, simulated.output
    rejected = CliRunner().invoke(command, ["fit", str(log), "--model", "N + S", "--no-report"])
    assert rejected.exit_code == 2, rejected.output
    assert "method 'mle' can't fit S (sinusoid)" in " ".join(rejected.output.split())


def test_planning_predicts_the_precision_of_a_new_term() -> None:
    """Four times the record halves the error; a term without density is never detected."""
    model = NoiseModel.parse(f"N=0.1 + {NEW['SGM']}")
    short, long = (relative_deviations(model, rate_hz=10.0, duration_s=s) for s in (2e3, 8e3))
    for name in ("SGM.sigma", "SGM.T"):
        assert long[name] == pytest.approx(short[name] / 2, rel=0.02)
    names = [need.name for need in plan(model, rate_hz=10.0).axes[0].needs]
    assert names == ["N", "SGM.sigma", "SGM.T"]
    lost = relative_deviations(NoiseModel.parse(f"N=0.1 + {NEW['S']}"), rate_hz=10.0, duration_s=2e3)
    assert np.isinf(lost["S.amplitude"])
    assert np.isfinite(lost["N"])


def test_a_new_term_is_separated_from_other_noise() -> None:
    """95 % of the biases are within 1.96 standard errors; a term without density is rejected."""
    model, rng = NoiseModel.parse("N=0.01 + SGM(sigma=0.3, T=0.5)"), np.random.default_rng(9)
    inside = []
    for _ in range(20):
        noise, bias = (term.simulate(600, 0.1, rng) for term in model.terms)
        found = imucal.decompose(AxisSeries.from_samples(noise + bias, rate_hz=10.0), model)
        assert [part.key for part in found.components] == ["level", "SGM"]
        inside.append(np.mean(np.abs(found.bias.value - bias) < 1.96 * found.bias.error))
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.std(inside) / np.sqrt(20) + 0.005)
    series, line = AxisSeries.from_samples(noise, rate_hz=10.0), NoiseModel.parse(f"N=1 + {NEW['S']}")
    message = r"^gyro_x: S \(sinusoid\) has no spectral density, so it can't be separated; leave it out$"
    with pytest.raises(ValueError, match=message):
        imucal.decompose(series, line)


def test_units_page_and_pictures_use_the_class() -> None:
    assert quantity_units("S", Sensor.GYROSCOPE)["deg/h"] == pytest.approx(np.pi / 180 / 3600)
    page = str(glossary_section())
    assert "a cycle of the surroundings" in page
    assert "second-order Gauss-Markov" in page
    estimate = Estimate(key="S", symbol="S", status="estimated", value=1e-5, low=0.9e-5, high=1.1e-5)
    assert estimate_text(
        estimate, Sensor.GYROSCOPE, sheet_units([axis.fit for axis in consumer_report().axes[:3]])
    ).startswith("S 2.06")


def test_an_incomplete_term_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The new terms are neither in the docs nor in the schema; missing units are reported too."""
    sentences = missing("S")
    assert any("README.md has no row for S" in sentence for sentence in sentences), sentences
    assert any("report-4.schema.json does not list S" in sentence for sentence in sentences), sentences
    monkeypatch.delattr(Sinusoid, "units")
    assert any(sentence.startswith("Sinusoid lacks `units`") for sentence in missing("S"))
