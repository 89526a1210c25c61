"""Tests of the step from a maximum in scaled units to estimates in SI, with limits computed by hand."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from scipy.stats import norm, t

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate, Goodness
from imucal.fitting.spectral import estimates
from imucal.fitting.spectral.estimates import RAMP as RAMP_COLUMN
from imucal.fitting.spectral.estimates import (
    Problem,
    covariance_of,
    estimate,
    misfits_of,
    model_of,
)
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import models_of
from tests.fitting.fits import at_maximum, ordinates_of, simulated

TAU0 = 0.25
UNIT = 8.0
STRUCTURE = ("Q", "N", "GM", "GM", "K", "R")
#: Variances of Q, N, B and K and of two Gauss-Markov terms, and correlation times in samples.
THETA = np.log(np.array([4.0, 9.0, 1.0, 16.0, 25.0, 36.0, 40.0, 10.0]))
RAMP = 3.0


def problem(**widening: float) -> Problem:
    """Return a problem with known units."""
    return Problem(
        ordinates=replace(ordinates_of(simulated("N=1", 100, 1)), scale=UNIT),
        level=0.9,
        tau0=TAU0,
        widening=widening,
    )


def fit(theta: FloatArray = THETA, structure: tuple[str, ...] = STRUCTURE, beta: float = RAMP) -> Fits:
    """Return a maximum; the information of parameter i is (i + 1)²."""
    size = theta.size
    return at_maximum(
        theta[None],
        models=models_of([structure], ["R"]),
        objective=np.zeros(1),
        information=np.diag(np.arange(1.0, size + 1) ** 2)[None],
        beta=np.array([[beta]]),
        beta_covariance=np.array([[[0.25]]]),
    )


def found(
    monkeypatch: pytest.MonkeyPatch, below: float = 0.2, above: float = 0.4, *, lowest: float | None = None,
    beta: float = RAMP, **widening: float,
) -> dict[str, Estimate]:  # fmt: skip
    """Return the estimates, where all limits are `below` and `above` their parameter."""

    def limits(_: object, fits: Fits, columns: FloatArray, **options: object) -> object:
        del options
        rows = np.arange(columns.size)
        values = np.where(columns == -1, fits.beta[:, 0], fits.theta[rows, columns])
        return values - below if lowest is None else np.full(values.size, lowest), values + above

    monkeypatch.setattr(estimates, "profile_limits", limits)
    made = estimate(problem(**widening), fit(beta=beta))
    return {item.key: item for item in made}


def test_a_coefficient_is_the_root_of_its_variance(monkeypatch: pytest.MonkeyPatch) -> None:
    """The factors to SI are tau0, its square root, 1, and the inverse square root."""
    table = found(monkeypatch)
    assert list(table) == ["Q", "N", "GM1", "GM2", "K", "R"]
    deviations = {"Q": 2 * TAU0, "N": 3 * TAU0**0.5, "GM1": 6.0, "GM2": 5.0, "K": 4 / TAU0**0.5}
    for key, deviation in deviations.items():
        item = table[key]
        assert item.value == pytest.approx(UNIT * deviation)
        assert item.low == pytest.approx(UNIT * deviation * np.exp(-0.1))
        assert item.high == pytest.approx(UNIT * deviation * np.exp(0.2))
        assert (item.correlation_time is None) == (not key.startswith("GM"))


def test_a_correlation_time_is_in_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its limits are computed in the logarithm."""
    for key, samples in (("GM1", 10.0), ("GM2", 40.0)):
        time = found(monkeypatch)[key].correlation_time
        assert time is not None
        expected = samples * TAU0 * np.exp([0.0, -0.2, 0.4])
        npt.assert_allclose([time.value, time.low, time.high], expected)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_ramp_estimate_is_positive_and_the_model_keeps_its_sign(
    sign: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limits are for the absolute value, the lower first."""
    item = found(monkeypatch, 0.5, 1.0, beta=sign * RAMP)["R"]
    ends = (2.5, 4.0) if sign > 0 else (2.0, 3.5)
    expected = np.array([3.0, *ends]) * UNIT / TAU0
    assert [item.value, item.low, item.high] == pytest.approx(expected.tolist())
    made = fit(beta=sign * RAMP)
    model = model_of(problem(), made, (item,))
    assert [term.symbol for term in model.terms] == ["R"]
    assert model.terms[0].values == pytest.approx((sign * 3.0 * UNIT / TAU0,))


@pytest.mark.parametrize(
    ("beta", "below", "above", "high"),
    [(1.0, 3.0, 0.5, 2.0), (1.0, 1.5, 4.0, 5.0), (1.0, 1.0, 4.0, 5.0), (-1.0, 4.0, 1.0, 5.0)],
)
def test_a_ramp_whose_interval_includes_zero_is_bounded(
    beta: float, below: float, above: float, high: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bound is the larger absolute end; an end at zero includes zero."""
    item = found(monkeypatch, below, above, beta=beta)["R"]
    assert (item.status, item.value, item.low) == ("bounded", None, 0.0)
    assert item.high == pytest.approx(high * UNIT / TAU0)


def test_a_variance_that_may_be_zero_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound is the coefficient of the upper limit."""
    item = found(monkeypatch, lowest=-np.inf)["N"]
    assert (item.status, item.value, item.low) == ("bounded", None, 0.0)
    assert item.high == pytest.approx(UNIT * 3 * TAU0**0.5 * np.exp(0.2))


def test_an_interval_is_widened_in_logarithms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the term with a factor is widened, and its value stays the same."""
    table, plain = found(monkeypatch, N=2.0), found(monkeypatch)
    assert table["N"].value == plain["N"].value
    assert table["N"].low == pytest.approx(UNIT * 3 * TAU0**0.5 * np.exp(-0.2))
    assert table["N"].high == pytest.approx(UNIT * 3 * TAU0**0.5 * np.exp(0.4))
    assert table["K"] == plain["K"]
    bounded = found(monkeypatch, lowest=-np.inf, N=2.0)["N"]
    assert bounded.high == pytest.approx(UNIT * 3 * TAU0**0.5 * np.exp(0.4))


def test_limits_widen_with_fewer_ordinates(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Student's quantile has 2/variance degrees of freedom (at least 10); times and ramps use the normal."""
    seen: list[FloatArray] = []

    def limits(*_: object, reach: FloatArray, **options: object) -> tuple[FloatArray, FloatArray]:
        del options
        seen.append(reach)
        return np.zeros(reach.size), np.zeros(reach.size)

    monkeypatch.setattr(estimates, "profile_limits", limits)
    # The information of N, B, K and both sigmas is 4, 9, 16, 25 and 36, so 2, 18, 32, 50 and 72 degrees.
    problem().limits(fit(structure=("N", "B", "GM", "GM", "K", "R")), [1, 2, 3, 4, 5, 6, RAMP_COLUMN])
    freedom = [10.0, 18.0, 32.0, 50.0, 72.0]
    npt.assert_allclose(seen[0], np.append(t.ppf(0.95, freedom), [norm.ppf(0.95)] * 2), rtol=1e-9)


def test_misfit_factors_have_the_symbols_of_their_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two Gauss-Markov terms share the larger; factors are at least one; N, B and K are always included."""
    monkeypatch.setattr(estimates, "misfit_factors", lambda *_: np.array([1.5, 0.7, 2.0, 1.2, 1.1, 1.4]))
    bad, good = (Goodness(statistic=s, p_value=0.5, chi2_per_bin=1.0) for s in (3.0, 2.99))
    assert misfits_of(problem(), fit(), good) == {}
    assert misfits_of(problem(), fit(), bad) == {"Q": 1.5, "N": 1.0, "B": 2.0, "GM": 1.4, "K": 1.2}


def test_the_covariance_is_in_si(monkeypatch: pytest.MonkeyPatch) -> None:
    """The derivatives are half of a coefficient per log variance, and a time per logarithm."""
    table = found(monkeypatch)
    names, matrix = covariance_of(problem(N=2.0), fit(), tuple(table.values()))
    assert names == ("Q", "N", "K", "GM1.sigma", "GM1.T", "GM2.sigma", "GM2.T", "R")
    roots = {
        "Q": 0.5 * (UNIT * 2 * TAU0) / 1,
        "N": 2.0 * 0.5 * (UNIT * 3 * TAU0**0.5) / 2,
        "K": 0.5 * (UNIT * 4 / TAU0**0.5) / 4,
        "GM1.sigma": 0.5 * (UNIT * 6) / 6,
        "GM2.sigma": 0.5 * (UNIT * 5) / 5,
        "GM1.T": 10 * TAU0 / 8,
        "GM2.T": 40 * TAU0 / 7,
        "R": 0.5 * UNIT / TAU0,
    }
    npt.assert_allclose(matrix, np.diag([roots[name] ** 2 for name in names]), atol=1e-12)


def test_bounded_terms_are_neither_in_the_covariance_nor_in_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    table = found(monkeypatch)
    table["N"] = Estimate.bounded("N", "N", 1.0)
    table["R"] = Estimate.bounded("R", "R", 1.0)
    names, matrix = covariance_of(problem(), fit(), tuple(table.values()))
    assert "N" not in names
    assert "R" not in names
    assert matrix.shape == (6, 6)
    model = model_of(problem(), fit(), tuple(table.values()))
    assert [term.symbol for term in model.terms] == ["Q", "GM", "GM", "K"]


def test_correlated_parameters_stay_correlated() -> None:
    """The covariance is the inverse of the information, scaled by the derivative of each row and column."""
    made = fit(np.log(np.array([1.0, 4.0, 1.0, 16.0])), ("N", "K"))
    information = made.information.copy()
    information[0, 1, 3] = information[0, 3, 1] = 4.0
    made = replace(made, information=information)
    n = Estimate(key="N", symbol="N", status="estimated", value=2.0, low=1.0, high=3.0)
    k = Estimate(key="K", symbol="K", status="estimated", value=6.0, low=1.0, high=9.0)
    _, matrix = covariance_of(problem(), made, (n, k))
    # The information [[4, 4], [4, 16]] has the inverse [[16, -4], [-4, 4]] / 48; the derivatives are 1, 3.
    npt.assert_allclose(matrix, [[16 / 48, -12 / 48], [-12 / 48, 36 / 48]])


def test_gauss_markov_terms_are_numbered_by_correlation_time() -> None:
    """Variance and time stay together, power laws come first, and a single term has no number."""
    made = fit()
    assert made.columns() == [
        ("Q", 0), ("N", 1), ("K", 3), ("GM1.sigma", 5), ("GM1.T", 7), ("GM2.sigma", 4), ("GM2.T", 6),
    ]  # fmt: skip
    assert made.variances(["B"]) == {"Q": 0, "N": 1, "B": 2, "K": 3, "GM1": 5, "GM2": 4}
    alone = replace(made, models=made.models.without([4], ramp=True))
    assert alone.structure == ("Q", "N", "GM", "K")
    assert alone.columns()[3:] == [("GM.sigma", 5), ("GM.T", 7)]
