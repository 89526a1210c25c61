"""Tests of the filter in the consistency benchmark, compared with a filter that runs step by step."""

import re
from pathlib import Path

import numpy as np
import pytest

from imucal import NoiseModel
from imucal.arrays import FloatArray
from tests.benchmarks.aided_filter import Aiding, nees
from tests.benchmarks.consistency import RULES, covered, known_fit, observed

PAGE = Path(__file__).parents[2] / "docs" / "results" / "consistency.md"


def run_filter(
    pair: tuple[float, float], increments: FloatArray, angles: FloatArray, aiding: Aiding
) -> tuple[FloatArray, float]:
    """Return the errors of a Kalman filter, shape (r,), and its predicted variance.

    `increments` has shape (r, updates + coast) and `angles` (r, updates + 1); the true angle is 0.
    """
    N, K = pair
    step = np.array([[1.0, -1.0], [0.0, 1.0]])
    noise = np.array([[N**2 + K**2 / 3, -(K**2) / 2], [-(K**2) / 2, K**2]])
    state = np.stack([angles[:, 0], np.zeros(len(angles))])
    covariance = np.diag([aiding.sd**2, (1e4 * N) ** 2])
    for k, increment in enumerate(increments.T):
        state = step @ state + np.stack([increment, np.zeros_like(increment)])
        covariance = step @ covariance @ step.T + noise
        if k < aiding.updates:
            gain = covariance[:, :1] / (covariance[0, 0] + aiding.sd**2)
            state = state + gain * (angles[:, k + 1] - state[0])
            covariance = covariance - gain @ covariance[:1]
    return state[0], float(covariance[0, 0])


@pytest.mark.parametrize(("text", "coast"), [("N=1e-3 + B=6e-4", 60), ("N=1e-3 + K=1e-4", 10)])
def test_the_nees_agrees_with_a_running_filter(text: str, coast: int) -> None:
    """The tolerance of 5 % is 2.2 standard errors of the variance of 4000 coasts."""
    model, pair, aiding, rate, runs = NoiseModel.parse(text), (1.1e-3, 6e-5), Aiding(2e-3, 40), 2, 4000
    rng = np.random.default_rng(4301)
    seconds = aiding.updates + coast
    # Each part of one long draw begins with a different bias.
    drawn = model.simulate(runs * seconds * rate, rate_hz=rate, rng=rng)
    increments = drawn.reshape(runs, seconds, rate).mean(axis=2)
    angles = aiding.sd * rng.standard_normal((runs, aiding.updates + 1))
    error, stated = run_filter(pair, increments, angles, aiding)
    exact = nees(np.array([pair]), model, rate_hz=rate, aiding=aiding, coasts_s=[coast])
    assert np.mean(error**2) / stated == pytest.approx(exact[0, 0], rel=0.05)


def test_a_filter_with_the_true_model_has_a_nees_of_one() -> None:
    """The model is white noise plus a random walk, at any time and for any aiding."""
    model, pair = NoiseModel.parse("N=1e-3 + K=5e-5"), np.array([[1e-3, 5e-5]])
    for aiding in (Aiding(), Aiding(1e-1, 200)):
        # The sampled random walk differs from the filter's by 1 in (20 s)².
        np.testing.assert_allclose(nees(pair, model, rate_hz=20.0, aiding=aiding), 1.0, rtol=1e-3)


def test_the_nees_does_not_depend_on_the_scale_of_all_noise() -> None:
    """The filter's numbers, the noise and the noise of the angle are multiplied by ten."""
    model, pair = NoiseModel.parse("N=1e-3 + B=3e-4"), np.array([[1.2e-3, 4e-5]])
    tenfold = NoiseModel.parse("N=1e-2 + B=3e-3")
    one = nees(pair, model, rate_hz=10.0, aiding=Aiding(2e-3, 100))
    np.testing.assert_allclose(
        nees(10 * pair, tenfold, rate_hz=10.0, aiding=Aiding(2e-2, 100)), one, rtol=1e-6
    )


def test_covering_numbers_never_underestimate_the_error() -> None:
    """The angle may be better or worse than the gyroscope."""
    text = "N=1e-3 + B=1e-3 + GM(sigma=1e-3, T=30)"
    pair = np.array([covered(known_fit(text))])
    for sd in (1e-4, 1e-1):
        found = nees(pair, NoiseModel.parse(text), rate_hz=20.0, aiding=Aiding(sd, 300))
        assert found.max() < 1.001


def test_observed_ratios_of_the_true_model_are_one() -> None:
    """The samples are drawn from the filter's own model."""
    import imucal

    model = NoiseModel.parse("N=1e-3 + K=2e-5")
    samples = model.simulate(400_000, rate_hz=4.0, rng=np.random.default_rng(4302))
    series = imucal.AxisSeries.from_samples(samples, rate_hz=4.0, sensor="gyroscope", axis="x")
    # 830 independent minutes in pairs have a standard error of 5 %.
    assert observed((1e-3, 2e-5), series) == pytest.approx((1.0, 1.0), abs=0.15)


def test_the_page_has_a_row_for_every_rule() -> None:
    """The rows are in three tables of single axes, and the page contains the command."""
    page = PAGE.read_text(encoding="utf-8").replace("**", "")
    for rule in RULES:
        assert len(re.findall(rf"^\| {re.escape(rule)} \|", page, re.MULTILINE)) == 3
    assert "python -m tests.benchmarks.consistency" in page
