"""A given model of laws alone is fitted without the rough covariance; the result is the same."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import allan_curve
from imucal.fitting.moments.points import avar_points
from imucal.fitting.moments.search import ModelSearch, Weight, _described
from imucal.fitting.settings import FitSettings
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries


@pytest.mark.parametrize(("model", "asked"), [("N + B + K", False), ("N + B", True), ("N + GM", True)])
def test_a_given_model_gives_the_same_without_the_rough_fit(model: str, *, asked: bool) -> None:
    """Variances agree to 1e-3 of their standard errors; what does not describe the curve, or has GM, asks."""
    truth = NoiseModel.parse("N=1 + B=0.06 + K=2e-2")
    samples = truth.simulate(60_000, rate_hz=1.0, rng=np.random.default_rng(4410))
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    points = avar_points(series, allan_curve(series))
    search = ModelSearch(points, Weight.of_deviations(points.avar), FitSettings(model=model, method="gmwm"))
    fit = search.whole()
    assert ("_rough" in vars(search)) == asked
    ranking, weight, _ = search.ranking(points)
    rough = _described(points, ranking, weight)
    assert fit.misfit == pytest.approx(rough.misfit, abs=1e-3)
    npt.assert_allclose(fit.solution.variances, rough.solution.variances, rtol=1e-4, atol=1e-9)
