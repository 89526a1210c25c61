"""Tests of fits of terms and regressors that imucal does not contain: a class in a table is enough."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import imucal
from imucal.arrays import FloatArray
from imucal.fitting import METHODS, NoiseFit
from imucal.fitting.regressors import SHAPES, Ramp, Regressor
from imucal.fitting.spectral.blocks import bins_of, make_blocks
from imucal.fitting.spectral.given_model import fit_bins
from imucal.noise.model import NoiseModel
from imucal.noise.term import Description, NoiseTerm, Stroke
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.recording import AxisSeries

pytestmark = pytest.mark.usefixtures("new_terms")

RATE_HZ = 100.0


@dataclass(frozen=True, kw_only=True)
class SquaredExponential(NoiseTerm):
    """A smooth bias: autocovariance sigma² exp(-(t/T)²)."""

    symbol = "SE"
    names = ("squared exponential", "squared exponential")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "mg")
    divisors: ClassVar[dict[str, float]] = {"": 1.0}
    fitted_by = frozenset({"mle", "gmwm"})
    stroke = Stroke("#333333", "#cccccc", (2, 2))
    description = Description("a hump", "a bias that forgets without corners", "Gaussian process")
    sigma: float
    T: float

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        fall: FloatArray = -2 * np.expm1(-((np.asarray(k, dtype=np.float64) * tau0 / self.T) ** 2))
        return self.sigma**2 * fall

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        aliases = np.asarray(f)[..., np.newaxis] + np.arange(-2, 3) / tau0
        density = np.exp(-((np.pi * aliases * self.T) ** 2)).sum(axis=-1)
        return np.asarray(self.sigma**2 * self.T * np.sqrt(np.pi) * density)

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        reach = int(np.ceil(4 * self.T / tau0))
        kernel = np.exp(-2 * (np.arange(-reach, reach + 1) * tau0 / self.T) ** 2)
        drawn = np.convolve(rng.standard_normal(n + 2 * reach), kernel, "valid")
        return np.asarray(self.sigma * drawn / np.linalg.norm(kernel))


@dataclass(frozen=True, kw_only=True)
class Smoothed(NoiseTerm):
    """White noise filtered by y[t] = (x[t] + x[t-1]) / 2: a coefficient without a time."""

    symbol = "P"
    names = ("smoothed white noise", "smoothed white noise")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "mg")
    fitted_by = frozenset({"mle", "gmwm"})
    stroke = Stroke("#333333", "#cccccc", (2, 2))
    description = Description("slope −1/2", "white noise of means of two", "MA(1)")
    value: float

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:  # noqa: ARG002 - samples, not seconds
        k = np.abs(np.asarray(k, dtype=np.float64))
        return self.value**2 * np.where(k == 0, 0.0, np.where(k == 1, 0.5, 1.0))

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        return self.value**2 * tau0 * np.cos(np.pi * np.asarray(f) * tau0) ** 2

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:  # noqa: ARG002
        drawn = rng.standard_normal(n + 1)
        return np.asarray(self.value * (drawn[1:] + drawn[:-1]) / 2)


@pytest.fixture
def new_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the terms to the table of terms."""
    for term in (SquaredExponential, Smoothed):
        monkeypatch.setitem(TERMS, term.symbol, term)


def fit_of(truth: str, model: str, method: str = "mle", *, n: int = 100_000, seed: int = 3) -> NoiseFit:
    """Return the fit of samples of `truth`."""
    drawn = NoiseModel.parse(truth).simulate(n, rate_hz=RATE_HZ, rng=np.random.default_rng(seed))
    return imucal.fit(AxisSeries.from_samples(drawn, rate_hz=RATE_HZ), model=model, method=method)


def covers(found: NoiseFit, key: str, sigma: float, time: float) -> bool:
    """Whether both intervals of a term cover the truth and the coefficient is known to a factor of 2."""
    estimate = found[key]
    time_interval = estimate.correlation_time
    assert time_interval is not None
    assert estimate.high < 2 * estimate.low
    return estimate.low <= sigma <= estimate.high and time_interval.low <= time <= time_interval.high


@pytest.mark.parametrize("method", ["mle", "gmwm"])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_coefficient_and_time_of_a_new_term_are_recovered(method: str, seed: int) -> None:
    """The 95 % intervals cover the truth, and the covariance contains both parameters."""
    found = fit_of("N=1e-3 + SE(sigma=5e-3, T=2.0)", "N + SE", method, seed=seed)
    assert str(found.model) == "N + SE"
    assert covers(found, "SE", 5e-3, 2.0)
    assert found["N"].low <= 1e-3 <= found["N"].high
    assert {"SE.sigma", "SE.T"} <= set(found.parameters)
    assert found.goodness.statistic < 3


@pytest.mark.parametrize("method", ["mle", "gmwm"])
def test_a_new_term_is_fitted_next_to_a_gauss_markov_term(method: str) -> None:
    """Each has its own time; the spectrum of a Gauss-Markov term falls much more slowly."""
    text = "N=1e-3 + GM(sigma=5e-3, T=0.2) + SE(sigma=1e-2, T=4.0)"
    found = fit_of(text, "N + GM + SE", method, seed=5)
    assert covers(found, "GM", 5e-3, 0.2)
    assert covers(found, "SE", 1e-2, 4.0)


def test_a_new_term_can_be_selected() -> None:
    """``auto`` tries every term that the method fits, and the new term fits its own samples best."""
    drawn = NoiseModel.parse("N=1e-3 + SE(sigma=5e-3, T=2.0)")
    samples = drawn.simulate(30_000, rate_hz=RATE_HZ, rng=np.random.default_rng(3))
    found = imucal.fit(AxisSeries.from_samples(samples, rate_hz=RATE_HZ), max_gm=0)
    assert "SE" in str(found.model)


def test_a_new_term_without_a_time_is_fitted() -> None:
    found = fit_of("N=1e-3 + P=1e-2", "N + P")
    assert found["P"].low <= 1e-2 <= found["P"].high
    assert found["P"].correlation_time is None
    assert found.parameters[-1] == "P"


@pytest.mark.parametrize("method", [name for name in METHODS if name != "slope"])
def test_a_term_with_other_parameters_is_rejected(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is raised before any calculation."""
    monkeypatch.setattr(SquaredExponential, "parameters", classmethod(lambda _: ("sigma", "period")))
    with pytest.raises(ValueError, match="SE") as refusal:
        fit_of("N=1e-3", "N + SE", method)
    assert str(refusal.value) == (
        f"method '{method}' can't fit SE (squared exponential): it has sigma, period, "
        "expected a coefficient and at most a time T; leave SE out"
    )


def test_the_slope_method_rejects_a_term_without_a_slope(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is raised even if the class lists the method."""
    monkeypatch.setattr(SquaredExponential, "fitted_by", frozenset({"slope"}))
    with pytest.raises(ValueError, match=r"^method 'slope' can't fit SE .*: its curve has no single slope"):
        fit_of("N=1e-3", "N + SE", "slope")


def test_a_term_without_density_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spectrum does not determine it if, for example, all its power is at one frequency."""
    monkeypatch.setattr(SquaredExponential, "psd", lambda _self, f, _tau0: np.zeros_like(f))
    with pytest.raises(ValueError, match=r"^method 'mle' can't fit SE .* its psd is 0.*; leave SE out$"):
        fit_of("N=1e-3", "N + SE")


def test_the_fast_gauss_markov_shape_agrees_with_the_generic_one() -> None:
    """Fits compute many times at once; the generic form uses the term's class."""
    k = np.arange(1, 200)
    lam, length = 4 * np.sin(np.pi * k / 400) ** 2, np.full(k.size, 200.0)
    sign = np.where(k > 100, 0.0, np.where(k % 2 == 0, 1.0, -1.0))
    logs = np.log([[3.0], [50.0], [4000.0]])
    quick = GaussMarkov.dct_shapes(logs, lam, length, sign)
    plain = super(GaussMarkov, GaussMarkov).dct_shapes(logs, lam, length, sign)
    np.testing.assert_allclose(plain, quick, rtol=1e-9)


@dataclass(frozen=True, kw_only=True)
class Kink(Regressor):
    """Zero before a place, a rise of 1 per sample from it on; without a closed form of its ordinates."""

    description = "a kink"
    place: int

    @property
    def name(self) -> str:
        return f"kink:{self.place}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return np.maximum(places - self.place, 0.0)


def test_a_new_regressor_needs_only_a_name_and_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The likelihood removes it, also from stored bins; without it the drift would be a random walk."""
    monkeypatch.setitem(SHAPES, "kink", lambda number: Kink(place=int(number)))
    n, kink, slope = 30_000, Kink(place=12_000), 1e-6
    drawn = NoiseModel.parse("N=1e-3").simulate(n, rate_hz=RATE_HZ, rng=np.random.default_rng(7))
    samples = drawn + slope * kink.samples(np.arange(n, dtype=np.float64))
    series = AxisSeries.from_samples(samples, rate_hz=RATE_HZ)
    blocks = make_blocks(series)
    fits = []
    for regressors in ((Ramp(), kink), (Ramp(),)):
        bins = bins_of(blocks.binned(regressors), blocks, tau0=series.tau0, widening=1.0)
        fits.append(fit_bins(bins, ("N", "K"), level=0.95))
    removed, left = fits
    assert removed.problem.ordinates.regressors == (Ramp(), kink)
    assert removed.whole.beta[0, 1] * blocks.scale == pytest.approx(slope, rel=0.02)
    found = {estimate.key: estimate for estimate in removed.estimates}
    assert found["N"].low <= 1e-3 <= found["N"].high
    assert found["K"].value is None
    assert next(estimate for estimate in left.estimates if estimate.key == "K").value is not None
