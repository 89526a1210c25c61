"""How long to record: closed-form limits, published bounds, inversion, and the sentence of a report."""

import math

import numpy as np
import pytest

from imucal import AxisSeries, fit
from imucal.fitting import FitSettings
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.spectral import relative_deviations
from imucal.noise.model import NoiseModel
from imucal.planning import describe_time, plan, resolution_findings
from tests.fitting.moments.curves import simulated_curve
from tests.report.synthetic import consumer_report

DAY = 86400.0


def _series(samples: np.ndarray) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=10)


def _errors(text: str, seconds: float, rate_hz: float = 1.0) -> dict[str, float]:
    return relative_deviations(NoiseModel.parse(text), rate_hz=rate_hz, duration_s=seconds)


def test_white_noise_alone() -> None:
    """1/√(2n), but for the one degree of freedom that the mean takes."""
    assert _errors("N=1", 1e4)["N"] == pytest.approx(1 / math.sqrt(2 * 9999))


@pytest.mark.parametrize("ratio", [200, 1000, 10_000])
def test_a_walk_in_white_noise(ratio: float) -> None:
    """√(2N/(K T)), the limit of long records."""
    assert _errors("N=1 + K=1e-3", ratio * 1e3, 10)["K"] == pytest.approx(math.sqrt(2 / ratio), rel=0.01)


@pytest.mark.parametrize("ratio", [200, 1000, 10_000])
def test_flicker_in_white_noise(ratio: float) -> None:
    """√(pi/2) N/(B √T), the limit of long records."""
    found = _errors("N=1 + B=1e-2", ratio * 1e4, 10)["B"]
    assert found == pytest.approx(math.sqrt(math.pi / 2 / ratio), rel=0.01)


def test_a_ramp() -> None:
    """√(12 N²/T³ + 1.2 K²/T) within 9 % where both matter, exact where N alone does."""
    seconds = 1e5
    alone = _errors("N=1 + R=1e-6", seconds, 10)["R"] * 1e-6
    assert alone == pytest.approx(math.sqrt(12 / seconds**3), rel=1e-3)
    both = _errors("N=1 + K=1e-4 + R=1e-6", seconds, 10)["R"] * 1e-6
    assert both == pytest.approx(math.sqrt(12 / seconds**3 + 1.2e-8 / seconds), rel=0.09)


def test_faint_quantization() -> None:
    """sigma²/(2 q² √n) for q² far below sigma²."""
    assert _errors("Q=1e-2 + N=1", 1e6)["Q"] == pytest.approx(1 / (2e-4 * 1e3), rel=0.01)


def test_a_gauss_markov_term() -> None:
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
def test_the_bounds_of_the_study(text: str, percent: dict[str, float]) -> None:
    """Cramér-Rao bounds at 1e6 samples that an independent program computed, to the printed digits."""
    found = _errors(text, 1e6)
    assert found.keys() == percent.keys()
    for name, value in percent.items():
        assert 100 * found[name] == pytest.approx(value, rel=0.02, abs=0.006)


def test_the_rate_and_the_unit_don_t_matter_where_they_can_t() -> None:
    """Rescaled noise has the same relative errors; K has them at any rate that is high enough."""
    assert _errors("N=1e-5 + K=1e-8", 1e5) == pytest.approx(_errors("N=1 + K=1e-3", 1e5))
    slow, fast = (_errors("N=1 + K=1e-3", 1e5, rate)["K"] for rate in (10, 200))
    assert slow == pytest.approx(fast, rel=1e-3)


def test_absent_terms_and_short_records_give_no_information() -> None:
    """Infinite, without a warning."""
    assert _errors("N=1 + K=0", 100)["K"] == math.inf
    assert _errors("N=1 + K=1", 3) == {"N": math.inf, "K": math.inf}
    assert _errors("N=1 + GM(sigma=1, T=5) + GM(sigma=1, T=5.0000000001)", 1000)["N"] == math.inf


def test_a_plan_inverts_the_errors() -> None:
    """T = 2 (N/K)/precision², in seconds, and a record of that length reaches it.

    Times 1/(1 - 4/pi²) where it has to be found out that there is no flicker: the square of the
    correlation of both terms' information, of the integrals of 1/(1+x²)², x²/(1+x²)² and x/(1+x²)².
    """
    longer = 1 / (1 - 4 / math.pi**2)
    found = plan(NoiseModel.parse("N=1e-3 + K=1e-6"), rate_hz=100, precision=0.1, duration_s=2e5 * longer)
    (axis,) = found.axes
    walk = next(need for need in axis.needs if need.name == "K")
    assert walk.needed_s == pytest.approx(2 * 1e3 / 0.01 * longer, rel=0.02)
    assert walk.reached == pytest.approx(0.1, rel=0.02)
    assert found.needed_s == walk.needed_s
    assert not walk.bounded


def test_a_level_asks_for_more() -> None:
    """Half-widths at 95 % are 1.96 standard errors: 3.84 times the time."""
    model = NoiseModel.parse("N=1e-3 + K=1e-6")
    one = plan(model, rate_hz=100).needed_s
    assert plan(model, rate_hz=100, level=0.95).needed_s == pytest.approx(3.8415 * one, rel=0.01)


def test_a_term_must_also_be_shown() -> None:
    """However coarse the wanted precision: a length at which most records only bound K is not enough."""
    model = NoiseModel.parse("N=1e-4 + B=3e-5 + K=3e-6")
    coarse = plan(model, rate_hz=20, precision=0.9)
    (axis,) = plan(model, rate_hz=20, duration_s=coarse.needed_s).axes
    walk = next(need for need in axis.needs if need.name == "K")
    assert walk.shown == pytest.approx(0.8, abs=0.001)
    assert coarse.needed_s == pytest.approx(plan(model, rate_hz=20, precision=0.3).needed_s)
    (short,) = plan(model, rate_hz=20, duration_s=coarse.needed_s / 4).axes
    faint = next(need for need in short.needs if need.name == "K")
    assert faint.shown is not None
    assert faint.shown < 0.4


@pytest.mark.slow
def test_what_is_planned_is_found() -> None:
    """Records of the planned length show K about as precisely as planned, most of them; of a tenth few do."""
    model = NoiseModel.parse("N=1e-4 + K=1e-5")
    needed_s = plan(model, rate_hz=10, precision=0.12).needed_s
    rng = np.random.default_rng(7301)
    for duration_s in (needed_s, needed_s / 10):
        fits = [fit(_series(model.simulate(round(10 * duration_s), rate_hz=10, rng=rng))) for _ in range(12)]
        widths = [(f["K"].high - f["K"].low) / 2 / 1.96 / 1e-5 for f in fits if f["K"].value]
        (axis,) = plan(model, rate_hz=10, duration_s=duration_s).axes
        share = next(need.shown for need in axis.needs if need.name == "K")
        assert share is not None
        # Two standard errors of twelve records.
        assert len(widths) == pytest.approx(12 * share, abs=2 * math.sqrt(12 * share * (1 - share)))
        if duration_s == needed_s:
            assert np.median(widths) == pytest.approx(0.12, rel=0.25)


def test_undetermined_terms_have_an_infinite_error() -> None:
    """A walk too faint for ten years."""
    found = plan(NoiseModel.parse("N=1 + K=1e-9"), rate_hz=100)
    assert found.needed_s == math.inf
    assert describe_time(found.needed_s) == "more than 10 years"


def test_a_plan_of_a_report_has_its_axes() -> None:
    """With the report's own rate and length; bounded terms stand at their bounds."""
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


def test_the_sentence_of_a_report() -> None:
    """Terms that the record is too short for are named, with both lengths."""
    fit = fit_gmwm(
        None, simulated_curve("N=1 + K=3e-3", 20_000, np.random.default_rng(51)), FitSettings(model="N + K")
    )
    findings = resolution_findings(fit, 20_000.0)
    walk = next(f for f in findings if f.text.startswith("K needs "))
    assert walk.code == "record-length"
    assert walk.level == "info"
    assert walk.text.endswith(" h for ±10 %; this log has 5.6 h.")
    assert not any(f.text.startswith("N ") for f in findings)
    flicker = next(f for f in findings if f.text.startswith("B "))
    assert flicker.text.startswith("B was not detected in 5.6 h. If it equals its bound, ")


def test_a_long_record_needs_no_sentence() -> None:
    """Everything to ten per cent: nothing to say about N and K."""
    fit = fit_gmwm(
        None, simulated_curve("N=1 + K=0.1", 50_000, np.random.default_rng(52)), FitSettings(model="N + K")
    )
    assert not [f for f in resolution_findings(fit, 50_000.0) if f.text[0] in "NK"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.7, "0.70 s"),
        (45, "45 s"),
        (600, "10 min"),
        (6.2 * 3600, "6.2 h"),
        (30 * 3600, "30 h"),
        (4 * DAY, "4.0 days"),
    ],
)
def test_times_have_two_digits(seconds: float, text: str) -> None:
    """In the unit people would use."""
    assert describe_time(seconds) == text


def test_refuses_what_can_t_be_planned() -> None:
    """A model without a rate, and a precision of nothing."""
    model = NoiseModel.parse("N=1")
    with pytest.raises(ValueError, match="a model has no sampling rate; give rate_hz"):
        plan(model)
    with pytest.raises(ValueError, match="precision must be positive and level between 0 and 1, got 0 and"):
        plan(model, rate_hz=100, precision=0)


def test_the_deviation_of_a_ramp_is_that_of_a_straight_line() -> None:
    """In white noise of variance N² rate, sqrt(12 / (n³ - n)) a sample; of N itself sqrt(1 / 2n)."""
    n, rate = 5000, 20.0
    found = relative_deviations(NoiseModel.parse("N=0.3 + R=0.02"), rate_hz=rate, duration_s=n / rate)
    expected = 0.3 * rate**0.5 * np.sqrt(12 / (n**3 - n)) * rate / 0.02
    assert found["R"] == pytest.approx(expected, rel=0.01)
    assert found["N"] == pytest.approx((2 * n) ** -0.5, rel=1e-3)


@pytest.mark.parametrize(("n", "told"), [(3, False), (4, True)])
def test_a_record_has_more_samples_than_parameters(n: int, *, told: bool) -> None:
    """Two parameters and the mean need four; with fewer nothing is told."""
    found = relative_deviations(NoiseModel.parse("N=1 + K=1"), rate_hz=1.0, duration_s=float(n))
    assert all(np.isfinite(d) for d in found.values()) == told


def test_what_may_be_there_makes_the_others_less_sure() -> None:
    """Of any size, and not a term of the answer; beside a walk of zero N is as sure as ever."""
    model = NoiseModel.parse("N=1 + K=1e-3")
    plain = relative_deviations(model, rate_hz=10, duration_s=1e6)
    unsure = relative_deviations(model, rate_hz=10, duration_s=1e6, added=["B"])
    assert plain.keys() == unsure.keys()
    assert unsure["K"] == pytest.approx(plain["K"] / math.sqrt(1 - 4 / math.pi**2), rel=0.02)
    assert unsure["N"] == pytest.approx(plain["N"], rel=0.01)
    white = NoiseModel.parse("N=1")
    alone, beside = (
        relative_deviations(white, rate_hz=1, duration_s=1e5, added=others)["N"] for others in ([], ["K"])
    )
    assert beside == pytest.approx(alone, rel=1e-3)
    assert beside > alone


def test_flicker_needs_more_evidence_than_a_walk() -> None:
    """Of records that tell both to the same error more show the walk."""
    shown = {}
    for text, name in (("N=1e-4 + B=3e-5", "B"), ("N=1e-4 + K=3e-6", "K")):
        model = NoiseModel.parse(text)
        needed_s = plan(model, rate_hz=20, precision=0.9).needed_s
        (axis,) = plan(model, rate_hz=20, duration_s=needed_s).axes
        need = next(need for need in axis.needs if need.name == name)
        assert need.shown == pytest.approx(0.8, abs=0.002)
        assert need.reached is not None
        shown[name] = need.reached
    assert shown["B"] < shown["K"]


@pytest.mark.parametrize("text", ["R=2e-10", "N=6.7e-30 + B=8.87e6 + K=7.7e-22", "K=1e-200 + R=1"])
def test_noise_below_other_noise_gives_no_information(text: str) -> None:
    """No division by zero, whatever the sizes: what is not seen is not told."""
    found = relative_deviations(NoiseModel.parse(text), rate_hz=100.0, duration_s=1e4, added=["B", "K"])
    assert all(deviation >= 0 for deviation in found.values())
