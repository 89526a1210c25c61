"""Tests of record lengths: closed forms, published bounds, plans and findings."""

import math

import numpy as np
import pytest

from imucal import AxisSeries, fit
from imucal.fitting import FitSettings
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.spectral import relative_deviations
from imucal.noise.model import NoiseModel
from imucal.planning import needed_time, plan, resolution_findings
from tests.fitting.moments.curves import simulated_curve
from tests.report.synthetic import consumer_report

DAY = 86400.0


def _series(samples: np.ndarray) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=10)


def _errors(text: str, seconds: float, rate_hz: float = 1.0) -> dict[str, float]:
    return relative_deviations(NoiseModel.parse(text), rate_hz=rate_hz, duration_s=seconds)


def test_white_noise_has_its_closed_form() -> None:
    """It is 1/√(2n), except for the degree of freedom of the mean."""
    assert _errors("N=1", 1e4)["N"] == pytest.approx(1 / math.sqrt(2 * 9999))


@pytest.mark.parametrize("ratio", [200, 1000, 10_000])
def test_a_random_walk_in_white_noise_has_its_closed_form(ratio: float) -> None:
    """It is √(2N/(K T)) for long records."""
    assert _errors("N=1 + K=1e-3", ratio * 1e3, 10)["K"] == pytest.approx(math.sqrt(2 / ratio), rel=0.01)


@pytest.mark.parametrize("ratio", [200, 1000, 10_000])
def test_flicker_in_white_noise_has_its_closed_form(ratio: float) -> None:
    """It is √(pi/2) N/(B √T) for long records."""
    found = _errors("N=1 + B=1e-2", ratio * 1e4, 10)["B"]
    assert found == pytest.approx(math.sqrt(math.pi / 2 / ratio), rel=0.01)


def test_a_ramp_has_its_closed_form() -> None:
    """√(12 N²/T³ + 1.2 K²/T) is right to 9 % with both terms and exact with N alone."""
    seconds = 1e5
    alone = _errors("N=1 + R=1e-6", seconds, 10)["R"] * 1e-6
    assert alone == pytest.approx(math.sqrt(12 / seconds**3), rel=1e-3)
    both = _errors("N=1 + K=1e-4 + R=1e-6", seconds, 10)["R"] * 1e-6
    assert both == pytest.approx(math.sqrt(12 / seconds**3 + 1.2e-8 / seconds), rel=0.09)


def test_weak_quantization_has_its_closed_form() -> None:
    """It is sigma²/(2 q² √n) for q² far below sigma²."""
    assert _errors("Q=1e-2 + N=1", 1e6)["Q"] == pytest.approx(1 / (2e-4 * 1e3), rel=0.01)


def test_a_gauss_markov_term_has_its_closed_form() -> None:
    """At a density ratio of 10: sd(T)/T = 1.88 √(2T/n), sd(sigma)/sigma = 0.63 √(2T/n)."""
    found = _errors(f"N=1 + GM(sigma={math.sqrt(0.1)}, T=50)", 1e6)
    assert found["GM.sigma"] == pytest.approx(0.63e-2, rel=0.01)
    assert found["GM.T"] == pytest.approx(1.88e-2, rel=0.01)


@pytest.mark.parametrize(
    ("text", "percent"),
    [
        ("N=1 + K=1e-3", {"N": 0.07, "K": 4.48}),
        ("Q=1.7320508 + N=1 + K=1e-3", {"Q": 0.10, "N": 0.20, "K": 4.5}),
        ("N=1 + B=0.0632456 + K=5.477e-4", {"N": 0.07, "B": 2.27, "K": 16.3}),
        ("N=1 + GM(sigma=0.1, T=500)", {"N": 0.07, "GM.sigma": 1.98, "GM.T": 5.90}),
        (
            "N=1 + GM(sigma=0.1, T=3000) + GM(sigma=0.2236, T=50) + K=3.162e-4",
            {"N": 0.07, "GM1.sigma": 0.85, "GM1.T": 2.8, "GM2.sigma": 6.1, "GM2.T": 19.2, "K": 25},
        ),
        ("N=1 + R=3e-8", {"N": 0.07, "R": 11.6}),
    ],
)
def test_deviations_agree_with_independent_bounds(text: str, percent: dict[str, float]) -> None:
    """An independent program computed these Cramér-Rao bounds at 1e6 samples, to the printed digits."""
    found = _errors(text, 1e6)
    assert found.keys() == percent.keys()
    for name, value in percent.items():
        assert 100 * found[name] == pytest.approx(value, rel=0.02, abs=0.006)


def test_rate_and_unit_do_not_matter() -> None:
    """Scaled noise has the same relative errors; K has them at every sufficient rate."""
    assert _errors("N=1e-5 + K=1e-8", 1e5) == pytest.approx(_errors("N=1 + K=1e-3", 1e5))
    slow, fast = (_errors("N=1 + K=1e-3", 1e5, rate)["K"] for rate in (10, 200))
    assert slow == pytest.approx(fast, rel=1e-3)


def test_absent_terms_and_short_records_have_infinite_errors() -> None:
    """No warning is raised."""
    assert _errors("N=1 + K=0", 100)["K"] == math.inf
    assert _errors("N=1 + K=1", 3) == {"N": math.inf, "K": math.inf}
    assert _errors("N=1 + GM(sigma=1, T=5) + GM(sigma=1, T=5.0000000001)", 1000)["N"] == math.inf


def test_a_plan_inverts_the_errors() -> None:
    """T = 2 (N/K)/precision², in seconds, and a record of that length reaches the precision.

    The factor 1/(1 - 4/pi²) allows for possible flicker noise: the square of the correlation between both
    terms' information, from the integrals of 1/(1+x²)², x²/(1+x²)² and x/(1+x²)².
    """
    longer = 1 / (1 - 4 / math.pi**2)
    found = plan(NoiseModel.parse("N=1e-3 + K=1e-6"), rate_hz=100, precision=0.1, duration_s=2e5 * longer)
    (axis,) = found.axes
    walk = next(need for need in axis.needs if need.name == "K")
    assert walk.needed_s == pytest.approx(2 * 1e3 / 0.01 * longer, rel=0.02)
    assert walk.reached == pytest.approx(0.1, rel=0.02)
    assert found.needed_s == walk.needed_s
    assert not walk.bounded


def test_a_higher_level_needs_a_longer_record() -> None:
    """Half-widths at 95 % are 1.96 standard errors: 3.84 times the time."""
    model = NoiseModel.parse("N=1e-3 + K=1e-6")
    one = plan(model, rate_hz=100).needed_s
    assert plan(model, rate_hz=100, level=0.95).needed_s == pytest.approx(3.8415 * one, rel=0.01)


def test_a_term_must_also_be_detectable() -> None:
    """With any precision, a length at which most records only bound K is not enough."""
    model = NoiseModel.parse("N=1e-4 + B=3e-5 + K=3e-6")
    coarse = plan(model, rate_hz=20, precision=0.9)
    (axis,) = plan(model, rate_hz=20, duration_s=coarse.needed_s).axes
    walk = next(need for need in axis.needs if need.name == "K")
    assert walk.detected == pytest.approx(0.8, abs=0.001)
    assert coarse.needed_s == pytest.approx(plan(model, rate_hz=20, precision=0.3).needed_s)
    (short,) = plan(model, rate_hz=20, duration_s=coarse.needed_s / 4).axes
    faint = next(need for need in short.needs if need.name == "K")
    assert faint.detected is not None
    assert faint.detected < 0.4


@pytest.mark.slow
def test_records_of_the_planned_length_detect_the_term() -> None:
    """Most records of the planned length estimate K as precisely as planned; a tenth as long, few do."""
    model = NoiseModel.parse("N=1e-4 + K=1e-5")
    needed_s = plan(model, rate_hz=10, precision=0.12).needed_s
    rng = np.random.default_rng(7301)
    for duration_s in (needed_s, needed_s / 10):
        fits = [fit(_series(model.simulate(round(10 * duration_s), rate_hz=10, rng=rng))) for _ in range(12)]
        widths = [(f["K"].high - f["K"].low) / 2 / 1.96 / 1e-5 for f in fits if f["K"].value]
        (axis,) = plan(model, rate_hz=10, duration_s=duration_s).axes
        share = next(need.detected for need in axis.needs if need.name == "K")
        assert share is not None
        # Two standard errors of twelve records.
        assert len(widths) == pytest.approx(12 * share, abs=2 * math.sqrt(12 * share * (1 - share)))
        if duration_s == needed_s:
            assert np.median(widths) == pytest.approx(0.12, rel=0.25)


def test_undetermined_terms_have_an_infinite_error() -> None:
    """The random walk is too weak for ten years."""
    found = plan(NoiseModel.parse("N=1 + K=1e-9"), rate_hz=100)
    assert found.needed_s == math.inf
    assert needed_time(found.needed_s) == "more than 10 years"


def test_a_plan_of_a_report_has_its_axes() -> None:
    """It uses the report's rate and length; bounded terms are planned at their bounds."""
    report = consumer_report()
    found = plan(report)
    assert [axis.axis for axis in found.axes] == [axis.name for axis in report.axes]
    for axis, source in zip(found.axes, report.axes, strict=True):
        assert axis.duration_s == source.duration_s
        assert axis.rate_hz == source.rate_hz
        assert {"N", "B", "K"} <= {need.name for need in axis.needs}
        for need in axis.needs:
            assert need.bounded == (source.fit[need.name.partition(".")[0]].value is None)
            assert need.reached is not None


def test_findings_contain_the_required_record_length() -> None:
    """They list the terms for which the record is too short, with both lengths."""
    fit = fit_gmwm(
        None, simulated_curve("N=1 + K=3e-3", 20_000, np.random.default_rng(51)), FitSettings(model="N + K")
    )
    findings = resolution_findings(fit, 20_000.0)
    walk = next(f for f in findings if f.text.startswith("K needs "))
    assert walk.code == "record-length"
    assert walk.level == "info"
    assert walk.text.endswith(" for ±10 %; this log has 5 h 33 min.")
    assert not any(f.text.startswith("N ") for f in findings)
    flicker = next(f for f in findings if f.text.startswith("B "))
    assert flicker.text.startswith("B was not detected in 5 h 33 min. If it equals its bound, ")


def test_a_long_record_has_no_finding() -> None:
    """N and K are known to 10 %."""
    fit = fit_gmwm(
        None, simulated_curve("N=1 + K=0.1", 50_000, np.random.default_rng(52)), FitSettings(model="N + K")
    )
    assert not [f for f in resolution_findings(fit, 50_000.0) if f.text[0] in "NK"]


def test_invalid_plans_are_rejected() -> None:
    """A model without a rate and a precision of zero are errors."""
    model = NoiseModel.parse("N=1")
    with pytest.raises(ValueError, match="a model has no sampling rate; give rate_hz"):
        plan(model)
    with pytest.raises(ValueError, match="got 0 and"):
        plan(model, rate_hz=100, precision=0)


def test_the_error_of_a_ramp_agrees_with_a_straight_line() -> None:
    """For white noise of variance N² rate it is sqrt(12 / (n³ - n)) per sample, and sqrt(1 / 2n) for N."""
    n, rate = 5000, 20.0
    found = relative_deviations(NoiseModel.parse("N=0.3 + R=0.02"), rate_hz=rate, duration_s=n / rate)
    expected = 0.3 * rate**0.5 * np.sqrt(12 / (n**3 - n)) * rate / 0.02
    assert found["R"] == pytest.approx(expected, rel=0.01)
    assert found["N"] == pytest.approx((2 * n) ** -0.5, rel=1e-3)


@pytest.mark.parametrize(("n", "finite"), [(3, False), (4, True)])
def test_a_record_needs_more_samples_than_parameters(n: int, *, finite: bool) -> None:
    """Two parameters and the mean need four samples."""
    found = relative_deviations(NoiseModel.parse("N=1 + K=1"), rate_hz=1.0, duration_s=float(n))
    assert all(np.isfinite(d) for d in found.values()) == finite


def test_possible_terms_increase_the_errors() -> None:
    """They have any size and are not in the result; next to a zero random walk, N does not change."""
    model = NoiseModel.parse("N=1 + K=1e-3")
    plain = relative_deviations(model, rate_hz=10, duration_s=1e6)
    uncertain = relative_deviations(model, rate_hz=10, duration_s=1e6, added=["B"])
    assert plain.keys() == uncertain.keys()
    assert uncertain["K"] == pytest.approx(plain["K"] / math.sqrt(1 - 4 / math.pi**2), rel=0.02)
    assert uncertain["N"] == pytest.approx(plain["N"], rel=0.01)
    white = NoiseModel.parse("N=1")
    alone, with_walk = (
        relative_deviations(white, rate_hz=1, duration_s=1e5, added=others)["N"] for others in ([], ["K"])
    )
    assert with_walk == pytest.approx(alone, rel=1e-3)
    assert with_walk > alone


def test_flicker_needs_more_evidence_than_a_random_walk() -> None:
    """At equal errors, more records detect the random walk."""
    shown = {}
    for text, name in (("N=1e-4 + B=3e-5", "B"), ("N=1e-4 + K=3e-6", "K")):
        model = NoiseModel.parse(text)
        needed_s = plan(model, rate_hz=20, precision=0.9).needed_s
        (axis,) = plan(model, rate_hz=20, duration_s=needed_s).axes
        need = next(need for need in axis.needs if need.name == name)
        assert need.detected == pytest.approx(0.8, abs=0.002)
        assert need.reached is not None
        shown[name] = need.reached
    assert shown["B"] < shown["K"]


@pytest.mark.parametrize("text", ["R=2e-10", "N=6.7e-30 + B=8.87e6 + K=7.7e-22", "K=1e-200 + R=1"])
def test_negligible_terms_have_no_information(text: str) -> None:
    """No size causes a division by zero."""
    found = relative_deviations(NoiseModel.parse(text), rate_hz=100.0, duration_s=1e4, added=["B", "K"])
    assert all(deviation >= 0 for deviation in found.values())
