"""One fit against the other."""

from dataclasses import replace

import numpy as np
import pytest

from imucal.allan import allan_curve
from imucal.findings import Finding
from imucal.fitting import FitSettings, cross_checks
from imucal.fitting.cross_checks import _distance, second_opinion
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.fitting.spectral import fit_mle
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries
from tests.fitting.moments.curves import simulated_curve


@pytest.fixture(scope="module")
def fit() -> NoiseFit:
    """Return a fit of N + K, K to 15 %."""
    curve = simulated_curve("N=1 + K=3e-3", 50_000, np.random.default_rng(31))
    return fit_gmwm(None, curve, FitSettings(model="N + K"))


def _with(fit: NoiseFit, estimate: Estimate, spread: float = 1.0) -> NoiseFit:
    """Return the fit with one estimate replaced and its covariance scaled."""
    estimates = tuple(estimate if e.key == estimate.key else e for e in fit.estimates)
    return replace(fit, method="mle", estimates=estimates, covariance=fit.covariance * spread)


def _moved(estimate: Estimate, factor: float) -> Estimate:
    assert estimate.value is not None
    return replace(
        estimate, value=estimate.value * factor, low=estimate.low * factor, high=estimate.high * factor
    )


def test_fits_that_agree_say_nothing(fit: NoiseFit) -> None:
    """Nor do differences below one per cent, however sure both are."""
    assert second_opinion(replace(fit, method="mle"), fit) == ()
    assert second_opinion(_with(fit, _moved(fit["N"], 1.009), 1e-6), fit) == ()


def test_a_large_difference_is_a_finding(fit: NoiseFit) -> None:
    """Both values and intervals are in the text."""
    (finding,) = second_opinion(_with(fit, _moved(fit["N"], 1.1), 0.9), fit)
    assert finding.level == "warning"
    assert finding.code == "second-opinion"
    mine, other = fit["N"].value, fit["N"].value
    assert mine is not None
    assert other is not None
    assert finding.text.startswith(f"N is {1.1 * mine:.4g} (")
    assert f") by mle and {other:.4g} (" in finding.text
    assert finding.text.endswith("by gmwm: the two disagree, so the model does not hold at all frequencies.")


def test_a_bound_is_contradicted_by_an_interval_above_it(fit: NoiseFit) -> None:
    """A bound that the other's interval reaches is none."""
    high = fit["K"].low / 2
    bounded = Estimate(key="K", symbol="K", status="bounded", value=None, low=0.0, high=high)
    (finding,) = second_opinion(_with(fit, bounded), fit)
    assert finding.text.startswith(f"K is below {high:.3g} by mle and ")
    assert second_opinion(_with(fit, replace(bounded, high=fit["K"].low * 1.01)), fit) == ()


def test_terms_of_one_fit_only_are_passed_over(fit: NoiseFit) -> None:
    """A Q that only one fit has can't be compared."""
    extra = Estimate(key="Q", symbol="Q", status="estimated", value=5.0, low=4.0, high=6.0)
    assert second_opinion(replace(fit, estimates=(extra, *fit.estimates)), fit) == ()


def test_a_right_model_is_seldom_doubted() -> None:
    """Of 15 records of N + K, at most 2 have a finding (three in a thousand are expected a term)."""
    model, rng = NoiseModel.parse("N=0.1 + K=1e-2"), np.random.default_rng(32)
    doubts = 0
    for _ in range(15):
        series = AxisSeries.from_samples(model.simulate(20_000, rate_hz=100.0, rng=rng), rate_hz=100.0)
        curve = allan_curve(series)
        mle = fit_mle(series, curve, FitSettings(model="N + K", max_gm=0))
        doubts += bool(second_opinion(mle, fit_gmwm(series, curve, FitSettings(model="N + K"))))
    assert doubts <= 2


def test_behind_a_filter_the_terms_of_short_times_are_not_compared(fit: NoiseFit) -> None:
    """The likelihood took the filter out, the curve holds it: N differs, and K still counts."""
    seen = Finding(level="info", code="output-filter", text="An output filter shapes the spectrum.")
    moved = replace(_with(fit, _moved(fit["N"], 1.1), 0.9), findings=(seen,))
    assert second_opinion(moved, fit) == ()
    (finding,) = second_opinion(replace(_with(fit, _moved(fit["K"], 4.0), 0.9), findings=(seen,)), fit)
    assert finding.text.startswith("K is ")


@pytest.mark.parametrize(
    ("own", "other", "variance"), [(0.01, 0.05, 0.04), (0.04, 0.05, 0.0125), (1e-7, 1e-6, 1 / 90_000)]
)
def test_a_distance_is_in_units_of_the_difference_of_variances(
    fit: NoiseFit, own: float, other: float, variance: float
) -> None:
    """At least a quarter of the second's, and never below (1/300)²; 0 where one is not known."""
    value = fit["N"].value
    assert value is not None
    moved = _moved(fit["N"], 1.5)
    first = replace(_with(fit, moved), parameters=("N",), covariance=np.array([[own * (1.5 * value) ** 2]]))
    second = replace(fit, parameters=("N",), covariance=np.array([[other * value**2]]))
    expected = np.log(1.5) / np.sqrt(variance)
    assert _distance(first, second, moved, fit["N"]) == pytest.approx(expected)
    assert _distance(replace(first, parameters=("K",)), second, moved, fit["N"]) == 0.0
    unsure = replace(second, covariance=np.array([[np.inf]]))
    assert _distance(first, unsure, moved, fit["N"]) == 0.0
    # Three times as wide an interval, and its covariance: a third of the distance.
    wider = replace(first, covariance=9 * first.covariance)
    assert _distance(wider, second, replace(moved, widening=3.0), fit["N"]) == pytest.approx(expected / 3)


@pytest.mark.parametrize(
    ("distance", "level"), [({}, None), ({"N": 0.1, "K": 0.5}, "info"), ({"N": 0.51, "K": 0.1}, "warning")]
)
def test_a_maximum_half_a_standard_error_away_is_near(
    distance: dict[str, float], level: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The farthest parameter is named; a warning has advice; without parameters nothing is said."""
    monkeypatch.setattr(cross_checks, "distances", lambda *_: distance)
    series = AxisSeries.from_samples(np.arange(3.0), rate_hz=1.0)
    found = cross_checks.verify_findings(series, NoiseModel.parse("N=1"), (), np.zeros((0, 0)))
    if level is None:
        assert found == ()
        return
    (finding,) = found
    worst = "K" if level == "info" else "N"
    assert finding.level == level
    assert bool(finding.advice) == (level == "warning")
    assert finding.text == (
        "The exact state-space likelihood has its maximum "
        f"{distance[worst]:.2g} standard errors away at most ({worst})."
    )
