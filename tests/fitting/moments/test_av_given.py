"""A given model of laws alone is fitted without the rough covariance; the result is the same."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import allan_curve
from imucal.arrays import FloatArray
from imucal.fitting.moments import search
from imucal.fitting.moments.points import AvarPoints, avar_points, spread_of
from imucal.fitting.moments.search import Solution, best_band, described, dictionary, ranked, whitening
from imucal.fitting.settings import FitSettings
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries


@pytest.mark.parametrize(("model", "asked"), [("N + B + K", False), ("N + B", True), ("N + GM", True)])
def test_a_given_model_gives_the_same_without_the_rough_fit(
    model: str, *, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Variances agree to 1e-3 of their standard errors; what does not describe the curve, or has GM, asks."""
    truth = NoiseModel.parse("N=1 + B=0.06 + K=2e-2")
    samples = truth.simulate(60_000, rate_hz=1.0, rng=np.random.default_rng(4410))
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    points, settings = avar_points(series, allan_curve(series)), FitSettings(model=model, method="gmwm")
    eta3, calls = np.diag(1 / points.avar), list[FloatArray]()

    def counted(points: AvarPoints, weight: FloatArray) -> Solution:
        calls.append(weight)
        return dictionary(points, weight)

    monkeypatch.setattr(search, "dictionary", counted)
    _, fit = best_band(points, eta3, settings)
    assert bool(calls) == asked
    start = dictionary(points, eta3)
    weight = whitening(spread_of(points, start.terms).at(start.variances))
    rough = described(points, ranked(points, weight, settings))
    assert fit.misfit == pytest.approx(rough.misfit, abs=1e-3)
    npt.assert_allclose(fit.solution.variances, rough.solution.variances, rtol=1e-4, atol=1e-9)
