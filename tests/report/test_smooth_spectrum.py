"""The drawn spectrum: merged at low frequencies, unbiased on slopes, with correct coverage."""

from dataclasses import replace

import numpy as np
import pytest

from imucal.allan.dct import Spectrum
from imucal.noise.model import NoiseModel
from imucal.report.result import AxisReport
from imucal.report.smooth_spectrum import smooth_spectrum
from tests.report.synthetic import consumer_report

RATE = 200.0


def axis_with(text: str, count: np.ndarray, rng: np.random.Generator | None) -> AxisReport:
    """Return an axis whose spectrum is chi-squared around a model, or equals the model."""
    axis = consumer_report().axes[0]
    model = NoiseModel.parse(text)
    frequency = np.cumsum(count) * RATE / (4 * np.sum(count))
    scatter = np.ones(count.size) if rng is None else rng.chisquare(count) / count
    psd = model.psd(frequency, rate_hz=RATE) * scatter
    return replace(
        axis,
        spectrum=Spectrum(frequency=frequency, psd=psd, count=count),
        fit=replace(axis.fit, model=model, rate_hz=RATE),
    )


COUNT = np.concatenate([np.ones(40), np.full(20, 5.0), np.full(30, 40.0)])


def test_smoothing_a_model_of_any_slope_gives_the_model() -> None:
    """Merging ordinates of a steep density must not introduce a bias."""
    for text in ("N=1e-4", "N=1e-6 + K=1e-4", "Q=1e-4"):
        axis = axis_with(text, COUNT, None)
        smooth = smooth_spectrum(axis)
        truth = np.sqrt(axis.fit.model.psd(smooth.frequency, rate_hz=RATE))
        np.testing.assert_allclose(smooth.root, truth, rtol=1e-12)
        assert np.all(np.diff(smooth.frequency) > 0)


def test_every_point_averages_several_ordinates() -> None:
    """The first point has six ordinates, others at least twelve; wide bins do not change.

    The remaining ordinates join the last point.
    """
    smooth = smooth_spectrum(axis_with("N=1e-4", COUNT, None))
    # Of 40 single ordinates: 6, then twice 12, then 10 with the first bin of five. The other 19 bins are
    # merged in threes.
    assert smooth.frequency.size == 1 + 2 + 1 + 6 + 30
    few = smooth_spectrum(axis_with("N=1e-4", np.ones(8), None))
    assert few.frequency.size == 1
    assert smooth_spectrum(axis_with("N=1e-4", np.ones(1), None)).frequency.size == 1


@pytest.mark.parametrize("text", ["N=1e-4", "N=1e-6 + K=1e-4"])
def test_the_limits_contain_the_truth(text: str) -> None:
    """The coverage is 95 % of points, over 60 records."""
    inside, total = 0, 0
    for seed in range(60):
        axis = axis_with(text, COUNT, np.random.default_rng([seed, 71]))
        smooth = smooth_spectrum(axis)
        truth = np.sqrt(axis.fit.model.psd(smooth.frequency, rate_hz=RATE))
        inside += int(np.count_nonzero((smooth.low <= truth) & (truth <= smooth.high)))
        total += truth.size
    # Four standard errors of a proportion.
    assert inside / total == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / total))


def test_without_a_model_the_density_itself_is_averaged() -> None:
    """Without samples the result is empty."""
    axis = axis_with("N=1e-4", np.ones(12), None)
    bare = replace(axis, fit=replace(axis.fit, model=NoiseModel(terms=())))
    np.testing.assert_allclose(smooth_spectrum(bare).root, 1e-4)
    empty = Spectrum(frequency=np.zeros(0), psd=np.zeros(0), count=np.zeros(0))
    assert smooth_spectrum(replace(axis, spectrum=empty)).root.size == 0
