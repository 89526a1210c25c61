"""Slow noise: mixtures, coverage with and without a report, with a wrong report."""

import numpy as np
import pytest
from scipy.stats import norm

from imucal.arrays import FloatArray
from imucal.calibration.accelerometer import fit_accelerometer
from imucal.calibration.mean_covariance import mean_covariance, white_model
from imucal.calibration.slow_noise import (
    AccelerometerEstimate,
    Mixture,
    estimate_accelerometer,
    walk_covariance,
)
from imucal.noise import NoiseModel
from tests.calibration.simulated import GRAVITY, RATE, Rests, accelerometer_rests, covered, within_binomial

CONSUMER = NoiseModel.parse("N=2e-3 + B=5e-4 + K=5e-5")
DRIFTY = NoiseModel.parse("N=1.5e-3 + B=1e-3 + K=3e-4")


def estimate(rests: Rests, base: FloatArray, *, checked: bool) -> AccelerometerEstimate:
    walk = walk_covariance(rests.spans, rate_hz=RATE, samples=rests.samples)
    return estimate_accelerometer(rests.means, base, walk, gravity=GRAVITY, checked=checked)


def covariance(rests: Rests, model: NoiseModel | None) -> FloatArray:
    """Return the covariance by a model, or by the white noise within the rests."""
    models = [model] * 3 if model else [white_model(s, RATE) for s in rests.deviations]
    return np.array([mean_covariance(m, rests.spans, rate_hz=RATE, samples=rests.samples) for m in models])


def share_inside(result: AccelerometerEstimate, rests: Rests) -> float:
    """Return the share of the intervals that contain the truth.

    Misalignments that slow noise hides have no interval and are not judged.
    """
    intervals = result.mixture.interval(np.eye(9)[:, result.fit.free])
    inside = covered(result.theta, intervals, rests.true)
    return float(np.mean(inside[result.fit.free]))


def hits(
    truth: NoiseModel, base: NoiseModel | None, draws: int, seed: int, *, count: int = 12, white: bool = False
) -> tuple[FloatArray, float]:
    """Return the share of each draw's intervals that cover, shape (draws, 1), and their relative width.

    The width is relative to that of the true model.
    """
    found, widths = [], []
    for k in range(draws):
        rests = accelerometer_rests(truth, count, 5.0, np.random.default_rng(seed + k))
        best = fit_accelerometer(rests.means, covariance(rests, truth), gravity=GRAVITY)
        if white:
            fit = fit_accelerometer(rests.means, covariance(rests, None), gravity=GRAVITY)
            half_widths = 1.96 * np.sqrt(np.diag(fit.covariance))
            inside = np.abs(fit.theta - rests.true) < half_widths
            found.append(float(np.mean(inside[fit.free])))
            continue
        result = estimate(rests, covariance(rests, base), checked=base is not None)
        interval = result.mixture.interval(np.eye(9)[:, result.fit.free])
        found.append(share_inside(result, rests))
        free = result.fit.free & best.free
        width = (interval[free, 1] - interval[free, 0]) / 3.92
        widths.append(np.median(width / np.sqrt(np.diag(best.covariance)[free])))
    return np.array(found)[:, None], float(np.median(widths)) if widths else 0.0


def test_one_normal_has_its_own_quantiles() -> None:
    """An interval is given relative to the mean."""
    mixture = Mixture.single(np.array([1.0, 2.0]), np.array([[4.0, 1.0], [1.0, 1.0]]))
    rows = np.array([[1.0, 0.0], [1.0, -1.0]])
    half = norm.ppf(0.975) * np.array([2.0, np.sqrt(3.0)])
    np.testing.assert_allclose(mixture.interval(rows), np.column_stack([-half, half]), rtol=1e-9)


def test_mixture_quantiles_contain_their_share_of_draws() -> None:
    """Two normals apart, 200 000 draws."""
    rng = np.random.default_rng(6400)
    mixture = Mixture(
        means=np.array([[0.0], [3.0]]),
        covariances=np.array([[[1.0]], [[0.25]]]),
        weights=np.array([0.7, 0.3]),
    )
    draws = np.where(rng.random(200_000) < 0.7, rng.normal(0, 1, 200_000), rng.normal(3, 0.5, 200_000))
    low, high = mixture.mean[0] + mixture.interval(np.eye(1))[0]
    assert np.mean(draws < low) == pytest.approx(0.025, abs=0.002)
    assert np.mean(draws > high) == pytest.approx(0.025, abs=0.002)
    assert mixture.covariance[0, 0] == pytest.approx(draws.var(), rel=0.01)


def test_coverage_with_the_true_model() -> None:
    """Consumer noise, 12 rests of 5 s."""
    found, width = hits(CONSUMER, CONSUMER, 40, 610_000)
    assert within_binomial(found, 0.93, 0.98)
    assert 0.95 < width < 1.3


def test_coverage_without_a_model_is_kept_where_white_noise_fails() -> None:
    """Drifty noise: white-noise intervals on the same draws cover far less."""
    found, width = hits(DRIFTY, None, 40, 620_000)
    assert within_binomial(found, 0.93, 1.0)
    assert width < 2.0
    assert hits(DRIFTY, None, 40, 620_000, white=True)[0].mean() < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("truth", [CONSUMER, DRIFTY, NoiseModel.parse("N=5e-3 + B=4e-3")])
@pytest.mark.parametrize("count", [9, 12, 20])
def test_coverage_in_every_cell(count: int, truth: NoiseModel) -> None:
    """A true report 93-98 %, none 93-100 %, a wrong one with 12 rests or more at least 90 %.

    With nine rests a wrong report can't be noticed, and a warning says so.
    """
    white, *slow = truth.terms
    halved = NoiseModel(terms=(white, *(type(term).of(term.value / 2) for term in slow)))  # type: ignore[attr-defined]
    reports = {"true": truth, "halved": halved, "white": NoiseModel(terms=(white,)), "none": None}
    ranges = {"true": (0.93, 0.98), "none": (0.93, 1.0), "halved": (0.90, 1.0), "white": (0.90, 1.0)}
    cells = ("true", "none") if count == 9 else tuple(reports)
    found: dict[str, list[float]] = {cell: [] for cell in cells}
    for seed in range(630_000, 630_200):
        rests = accelerometer_rests(truth, count, 5.0, np.random.default_rng(seed))
        for cell in cells:
            base = reports[cell]
            result = estimate(rests, covariance(rests, base), checked=base is not None)
            found[cell].append(share_inside(result, rests))
    for cell in cells:
        assert within_binomial(np.array(found[cell])[:, None], *ranges[cell]), cell


def test_an_untrusted_report_is_replaced() -> None:
    """A report without slow noise: chi² rejects it, and the excess explains the residuals."""
    rests = accelerometer_rests(DRIFTY, 20, 5.0, np.random.default_rng(6500))
    result = estimate(rests, covariance(rests, NoiseModel(terms=DRIFTY.terms[:1])), checked=True)
    assert result.p < 0.01
    assert result.excess.tau > 0
    assert result.fit.chi2 < 3 * result.dof < result.chi2


def test_nine_rests_cannot_be_checked() -> None:
    """No degree of freedom: the report is used as it is."""
    rests = accelerometer_rests(CONSUMER, 9, 5.0, np.random.default_rng(6600))
    result = estimate(rests, covariance(rests, CONSUMER), checked=True)
    assert np.isnan(result.p)
    assert result.excess.tau == 0
    assert len(result.mixture.weights) == 1
