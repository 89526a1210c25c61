"""Tests of the self-check: a warning if one half of a record does not predict the other."""

from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.arrays import FloatArray
from imucal.prediction import half_predictions, self_check
from imucal.recording import AxisSeries

RATE = 20.0
#: Halves of 1300 s are as long as the check at 100 s requires.
N = int(2600 * RATE)
TRUTH = "N=1e-3 + B=3e-4 + K=3e-5"


def noise(text: str, seed: int, n: int = N) -> FloatArray:
    """Return simulated samples."""
    return imucal.NoiseModel.parse(text).simulate(n, rate_hz=RATE, rng=np.random.default_rng(seed))


def series_of(samples: FloatArray) -> AxisSeries:
    """Return an axis of samples."""
    return AxisSeries.from_samples(samples, rate_hz=RATE)


def test_noise_of_the_fitted_kind_is_predicted() -> None:
    """Scores are standard normal: the mean square of 6 scores of 8 records is 1 within chance."""
    scores = []
    for seed in range(8):
        series = series_of(noise(TRUTH, seed))
        fit = imucal.fit(series, model="N + B + K")
        found = half_predictions(series, fit)
        assert [(one.half, one.time_s) for one in found] == [(h, t) for h in (1, 2) for t in (10, 30, 100)]
        scores += [one.score for one in found]
        assert self_check(series, fit) == ()
    # The three scores of a half are nearly equal, so there are about 16 degrees of freedom.
    assert 0.4 < np.mean(np.square(scores)) < 1.9


def test_the_observed_value_is_the_allan_deviation_of_the_half() -> None:
    """The prediction at 10 s also agrees with the fit, to 5 %."""
    series = series_of(noise(TRUTH, 21))
    fit = imucal.fit(series, model="N + B + K")
    for one in half_predictions(series, fit):
        half = series.samples[: N // 2] if one.half == 1 else series.samples[N // 2 :]
        curve = imucal.allan_curve(series_of(half), taus=[one.time_s])
        # One is a sum over the spectrum of the half, the other over its start points.
        assert one.observed == pytest.approx(float(curve.adev[0]), rel=0.05)
        model = np.sqrt(fit.model.avar(np.array([one.time_s * RATE]), rate_hz=RATE))
        if one.time_s == 10:
            assert one.predicted == pytest.approx(float(model[0]), rel=0.05)


def test_a_half_with_different_noise_is_reported() -> None:
    """The flicker noise is four times as large in the second half; the verdict becomes "check"."""
    samples = noise("N=1e-3 + B=3e-4", 31)
    samples[N // 2 :] = noise("N=1e-3 + B=1.2e-3", 32)[: N - N // 2]
    series = series_of(samples)
    fit = imucal.fit(series)
    (finding,) = self_check(series, fit)
    assert (finding.code, finding.level, finding.axis) == ("predicts-badly", "warning", "gyro_x")
    worst = max(half_predictions(series, fit), key=lambda one: abs(one.score))
    assert (worst.score > 0) == (worst.half == 2)
    names = ("first", "second")
    assert finding.text == (
        f"The {names[2 - worst.half]} half of the record predicts the {names[worst.half - 1]} badly: at "
        f"{worst.time_s:g} s its Allan deviation is {worst.observed:.3g} rad/s, where {worst.predicted:.3g} "
        f"rad/s is predicted (score {worst.score:+.1f})."
    )
    recording = imucal.Recording(source=imucal.recording.Source(path="a.csv", format="csv"), series=(series,))
    report = imucal.characterize(recording)
    assert "predicts-badly" in {found.code for found in report.axes[0].findings}
    assert report.verdict.grade == "check"
    assert "halves that don't predict each other" in report.verdict.sentence


def test_scale_and_offset_do_not_change_the_scores() -> None:
    samples = noise(TRUTH, 41)
    scores = []
    for changed in (samples, 1e3 * samples + 5.0):
        series = series_of(changed)
        found = half_predictions(series, imucal.fit(series, model="N + B + K"))
        scores.append([one.score for one in found])
    np.testing.assert_allclose(scores[1], scores[0], atol=1e-3)


def test_a_short_record_has_no_finding() -> None:
    """A half must be twelve times as long as the averaging time."""
    series = series_of(noise("N=1e-3", 51, n=int(230 * RATE)))
    assert half_predictions(series, imucal.fit(series)) == ()
    longer = series_of(noise("N=1e-3", 51, n=int(250 * RATE)))
    assert {one.time_s for one in half_predictions(longer, imucal.fit(longer))} == {10.0}


def test_lost_samples_and_a_ramp_are_not_reported() -> None:
    """A tenth of the samples and five minutes are missing, and the model contains the drift."""
    rng = np.random.default_rng(61)
    samples = noise("N=1e-3 + B=3e-4", 62) + 3e-6 * np.arange(N) / RATE
    keep = rng.random(N) > 0.1
    keep[int(700 * RATE) : int(1000 * RATE)] = False
    series = series_of(samples).keeping(keep)
    fit = imucal.fit(series, model="N + B + R")
    found = half_predictions(series, fit)
    assert {one.time_s for one in found} == {10.0, 30.0}
    assert max(abs(one.score) for one in found) < 3


def test_a_strong_line_is_excluded() -> None:
    """The fit and its prediction both exclude it."""
    samples = noise("N=1e-3 + B=3e-4", 71)
    samples += 5e-3 * np.sin(2 * np.pi * 0.5 * np.arange(N) / RATE)
    series = series_of(samples)
    fit = imucal.fit(series, model="N + B")
    assert fit.goodness.lines
    assert self_check(series, replace(fit)) == ()
