"""Tests of the second opinion: a spectral fit compared with a fit of the curve."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from imucal.allan import allan_curve
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting import FitSettings
from imucal.fitting import fit as fit_samples
from imucal.fitting.cross_checks import _distance, fit_of_curve, second_opinion
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.moments.search import whitening
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.fitting.spectral import fit_mle
from imucal.noise.model import NoiseModel
from imucal.pipeline import characterize
from imucal.recording import AxisSeries, Recording, Source
from tests.fitting.moments.curves import simulated_curve
from tests.raising import raises
from tests.slow_cases import first_by_default


@pytest.fixture(scope="module", name="fit")
def fit_of_white_noise_and_walk() -> NoiseFit:
    """Return a fit of N + K with K known to 15 %."""
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


def test_fits_that_agree_have_no_finding(fit: NoiseFit) -> None:
    """Differences below one per cent have none either, however small the standard errors are."""
    assert second_opinion(replace(fit, method="mle"), fit) == ()
    assert second_opinion(_with(fit, _moved(fit["N"], 1.009), 1e-6), fit) == ()


def test_a_large_difference_is_a_finding(fit: NoiseFit) -> None:
    """The text contains both values and intervals."""
    (finding,) = second_opinion(_with(fit, _moved(fit["N"], 1.1), 0.9), fit)
    assert finding.level == "warning"
    assert finding.code == "second-opinion"
    mine, other = fit["N"].value, fit["N"].value
    assert mine is not None
    assert other is not None
    assert finding.text.startswith(f"N is {1.1 * mine:.4g} (")
    assert f") by mle and {other:.4g} (" in finding.text
    assert finding.text.endswith("by gmwm: the two disagree, so the model is wrong at some frequencies.")


def test_a_bound_is_contradicted_by_an_interval_above_it(fit: NoiseFit) -> None:
    """An interval that overlaps the bound does not contradict it."""
    high = fit["K"].low / 2
    bounded = Estimate(key="K", symbol="K", status="bounded", value=None, low=0.0, high=high)
    (finding,) = second_opinion(_with(fit, bounded), fit)
    assert finding.text.startswith(f"K is below {high:.3g} by mle and ")
    assert second_opinion(_with(fit, replace(bounded, high=fit["K"].low * 1.01)), fit) == ()


def test_terms_of_only_one_fit_are_ignored(fit: NoiseFit) -> None:
    extra = Estimate(key="Q", symbol="Q", status="estimated", value=5.0, low=4.0, high=6.0)
    assert second_opinion(replace(fit, estimates=(extra, *fit.estimates)), fit) == ()


@pytest.mark.slow
def test_the_true_model_rarely_has_a_finding() -> None:
    """At most 2 of 15 records of N + K have one (0.3 % per term are expected)."""
    model, rng = NoiseModel.parse("N=0.1 + K=1e-2"), np.random.default_rng(32)
    doubts = 0
    for _ in range(15):
        series = AxisSeries.from_samples(model.simulate(20_000, rate_hz=100.0, rng=rng), rate_hz=100.0)
        curve = allan_curve(series)
        mle = fit_mle(series, curve, FitSettings(model="N + K", max_gm=0))
        doubts += bool(second_opinion(mle, fit_gmwm(series, curve, FitSettings(model="N + K"))))
    assert doubts <= 2


def test_behind_a_filter_the_terms_of_short_times_are_not_compared(fit: NoiseFit) -> None:
    """The likelihood removes the filter and the curve does not: N differs, while K is compared."""
    seen = Finding(level="info", code="output-filter", text="An output filter shapes the spectrum.")
    moved = replace(_with(fit, _moved(fit["N"], 1.1), 0.9), findings=(seen,))
    assert second_opinion(moved, fit) == ()
    (finding,) = second_opinion(replace(_with(fit, _moved(fit["K"], 4.0), 0.9), findings=(seen,)), fit)
    assert finding.text.startswith("K is ")


@pytest.mark.parametrize(
    ("own", "other", "variance"), [(0.01, 0.05, 0.04), (0.04, 0.05, 0.0125), (1e-7, 1e-6, 1 / 90_000)]
)
def test_a_distance_is_in_units_of_the_variance_of_the_difference(
    fit: NoiseFit, own: float, other: float, variance: float
) -> None:
    """The variance is at least a quarter of the second's and (1/300)²; an unknown distance is 0."""
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
    # An interval three times as wide reduces the distance to a third.
    wider = replace(first, covariance=9 * first.covariance)
    assert _distance(wider, second, replace(moved, widening=3.0), fit["N"]) == pytest.approx(expected / 3)


def _opinion(samples: FloatArray, rate_hz: float) -> tuple[NoiseFit, tuple[Finding, ...]]:
    """Return the default fit of samples, and the findings of the second opinion."""
    series = AxisSeries.from_samples(samples, rate_hz=rate_hz)
    first = fit_mle(series, allan_curve(series), FitSettings())
    return first, second_opinion(first, fit_of_curve(series, first))


@pytest.mark.parametrize("name", first_by_default(["mean of 4", "held", "resonance"], 1))
def test_the_curve_is_corrected_for_the_filter(name: str) -> None:
    """Two records per filter; `tests/benchmarks/disturbances.py filters` has 24 of 1 000 000 samples each."""
    from scipy.signal import lfilter

    model, pole = NoiseModel.parse("N=1e-4 + B=3e-5 + K=3e-6"), 0.95 * np.exp(0.4j * np.pi)
    for seed in (33, 34):
        rng = np.random.default_rng(seed)
        if name == "held":
            samples = np.repeat(model.simulate(15_000, rate_hz=25.0, rng=rng), 4)
        else:
            samples = model.simulate(61_000, rate_hz=100.0, rng=rng)
            denominator = np.array([1.0, -2 * pole.real, abs(pole) ** 2])
            resonance = lfilter([denominator.sum()], denominator, samples - samples[0])
            mean = np.convolve(samples, np.full(4, 0.25), "valid")
            samples = (mean if name == "mean of 4" else resonance)[1000:]
        first, findings = _opinion(samples, 100.0)
        assert findings == ()
        assert first.noise_share is not None
        assert first.noise_share[-1] == pytest.approx(1.0, abs=0.05)


def test_the_noise_share_is_a_ratio_of_allan_variances() -> None:
    """The references are the autocovariance of means of four samples, and the amplitude of a line."""
    rng = np.random.default_rng(35)
    n = 60_000
    white = rng.standard_normal(n + 3)
    first, _ = _opinion(np.convolve(white, np.full(4, 0.25), "valid"), 1.0)
    assert first.noise_share is not None
    weights = np.full(4, 0.25)
    covariance = np.convolve(weights, weights[::-1])
    for m, share in zip(first.curve.m.tolist(), first.noise_share.tolist(), strict=True):
        if 4 <= m <= 64:
            lag = np.arange(-3, 4)
            window = np.concatenate([np.full(m, -1.0), np.ones(m)]) / m
            spread = np.convolve(window, window[::-1])
            middle = spread.size // 2
            smoothed = sum(c * spread[middle + k] for c, k in zip(covariance, lag, strict=True)) / 2
            assert share == pytest.approx(1 / m / smoothed, rel=0.2 / m + 2e-3)
    amplitude, omega = 0.3, 0.37
    first, _ = _opinion(white[:n] + amplitude * np.sin(omega * np.arange(n)), 1.0)
    assert first.noise_share is not None
    m = first.curve.m[:6].astype(np.float64)
    line = amplitude**2 * np.sin(omega * m / 2) ** 4 / (m * np.sin(omega / 2)) ** 2
    np.testing.assert_allclose(first.noise_share[:6], (1 / m) / (1 / m + line), rtol=0.03)


def test_removed_disturbances_are_not_in_the_second_curve() -> None:
    """With a cycle and a step, the curve's K would disagree."""
    t = np.arange(60_000) / 10
    noise = NoiseModel.parse("N=1e-4 + K=1e-6").simulate(t.size, rate_hz=10.0, rng=np.random.default_rng(36))
    first, findings = _opinion(noise + 3e-4 * np.sin(t / 150) + 5e-4 * (t > 2000), 10.0)
    assert {"cycle", "step"} <= {finding.code for finding in first.findings}
    assert findings == ()


@pytest.mark.parametrize("seed", [37, 38])
def test_a_tone_far_above_the_noise_does_not_prevent_a_fit(seed: int) -> None:
    """The tone is 5e-3 at rate/4, the white noise 1.5e-4, with 2732 samples at 40 Hz."""
    rng = np.random.default_rng(seed)
    samples = 1.5e-4 * rng.standard_normal(2732) + 5e-3 * np.sin(
        np.pi / 2 * np.arange(2732) + rng.uniform(0, 6)
    )
    series = AxisSeries.from_samples(samples, rate_hz=40.0)
    report = characterize(Recording(source=Source(path="made", format="made"), series=(series,)))
    (axis,) = report.axes
    assert axis.fit["N"].low < 1.5e-4 / np.sqrt(40) < axis.fit["N"].high
    assert {"line", "tone"} & {finding.code for finding in axis.findings}
    by_curve = fit_samples(series, model="N", method="gmwm")
    assert by_curve.goodness.statistic > 3 or by_curve.findings


def test_a_curve_dominated_by_lines_has_no_second_opinion() -> None:
    """The error states how few averaging times show the noise."""
    series = AxisSeries.from_samples(np.random.default_rng(39).standard_normal(3000), rate_hz=10.0)
    first = fit_mle(series, allan_curve(series), FitSettings())
    drowned = replace(first, noise_share=np.where(first.curve.m < 4, 1.0, 0.1))
    with raises(DataError, "found 2 averaging times", place="gyro_x"):
        fit_of_curve(series, drowned)


def test_an_impossible_covariance_raises_a_data_error() -> None:
    """The likelihood of a tone can give a negative or undefined variance."""
    for broken in (-1.0, np.nan):
        with pytest.raises(
            DataError,
            match="no noise has this covariance",
        ):
            whitening(np.diag([1.0, broken]))


@pytest.mark.parametrize("method", ["gmwm", "slope"])
@pytest.mark.parametrize("smoothing", [1.0, 0.1])
def test_a_fit_of_the_curve_behind_a_filter_has_a_warning(method: str, smoothing: float) -> None:
    """Smoothing by an exponential average bends the curve; without it there is no warning."""
    white = np.random.default_rng(53).standard_normal(40_000)
    samples = scipy.signal.lfilter([smoothing], [1, smoothing - 1], white)
    result = fit_samples(AxisSeries.from_samples(samples, rate_hz=100.0), method=method)
    found = [finding.level for finding in result.findings if finding.code == "filtered-curve"]
    assert found == (["warning"] if smoothing < 1 else [])
