"""Verdicts of a check: decided by the interval, for each axis; missing data never pass."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.checking import CheckResult, check, parse_limits
from imucal.checking.verdict import judge, measure
from imucal.comparison import ratio as ratio_of
from imucal.errors import LimitsError, ReadError
from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.report.json_file import to_document
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.report.typed_json import dumps
from tests.report.synthetic import axis_report, consumer_report, small_report


def _check(text: str, report: Report | None = None, baseline: Report | None = None) -> CheckResult:
    return check(report or consumer_report(), parse_limits(text), baseline=baseline)


def _verdicts(result: CheckResult) -> dict[str, str]:
    return {f"{row.where} {row.rule}": row.verdict for row in result.rows if row.subject != "findings"}


@pytest.mark.parametrize(
    ("low", "high", "side", "verdict"),
    [
        (0.8, 0.9, "max", "pass"),
        (0.8, 1.0, "max", "pass"),
        (0.9, 1.1, "max", "undecided"),
        (1.0, 1.1, "max", "undecided"),
        (1.1, 1.2, "max", "fail"),
        (1.1, 1.2, "min", "pass"),
        (0.9, 1.1, "min", "undecided"),
        (0.8, 0.9, "min", "fail"),
    ],
)
def test_the_interval_decides(low: float, high: float, side: str, verdict: str) -> None:
    """An interval within the limit passes, one beyond it fails, and one that contains it is undecided.

    The estimate itself does not matter.
    """
    for value in (low, high):
        measured = Quantity(value=value, low=low, high=high)
        row = judge("gyro_x", "N", measured, side=side, limit=1.0)  # type: ignore[arg-type]
        assert row.verdict == verdict


@pytest.mark.parametrize(("limit", "verdict"), [(1.0, "pass"), (0.5, "undecided")])
def test_a_bound_never_fails_a_maximum(limit: float, verdict: str) -> None:
    """An undetected term is between 0 and its bound, so the row passes or is undecided."""
    measured = Quantity(value=None, low=0.0, high=0.9)
    assert judge("gyro_x", "K", measured, side="max", limit=limit).verdict == verdict


def test_the_level_gives_the_error_rates_at_the_limit() -> None:
    """With 95 % intervals a sensor exactly at its limit fails in 2.5 % and passes in 2.5 % of records."""
    replications, deviation = 20_000, 0.1
    estimates = np.exp(deviation * np.random.default_rng(6).standard_normal(replications))
    wide = math.exp(1.96 * deviation)
    verdicts = [
        judge("x", "N", Quantity(value=e, low=e / wide, high=e * wide), side="max", limit=1.0).verdict
        for e in estimates.tolist()
    ]
    # Four standard errors of a proportion of 0.025.
    error = 4 * math.sqrt(0.025 * 0.975 / replications)
    assert verdicts.count("fail") / replications == pytest.approx(0.025, abs=error)
    assert verdicts.count("pass") / replications == pytest.approx(0.025, abs=error)


def test_the_interval_of_a_ratio_has_its_coverage() -> None:
    """95 % of ratios of two estimates with asymmetric 95 % intervals of unequal width cover the truth."""
    replications = 20_000
    rng = np.random.default_rng(66)
    covered = 0
    draws = np.exp(rng.standard_normal((replications, 2)) * [0.3, 0.05])
    for a, b in draws.tolist():
        now = Quantity(value=a, low=a / math.exp(1.96 * 0.3), high=a * math.exp(1.96 * 0.3))
        before = Quantity(value=b, low=b / math.exp(1.96 * 0.05), high=b * math.exp(1.96 * 0.05))
        ratio = ratio_of(now, before)
        covered += ratio.low <= 1 <= ratio.high
    # Four standard errors of a proportion of 0.95.
    assert covered / replications == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / replications))


@pytest.mark.parametrize(
    ("now", "before", "low", "high"),
    [
        (Quantity(value=None, low=0, high=2), Quantity(value=4, low=2, high=8), 0, 1),
        (Quantity(value=4, low=2, high=8), Quantity(value=None, low=0, high=4), 0.5, math.inf),
        (Quantity(value=None, low=0, high=2), Quantity(value=None, low=0, high=4), 0, math.inf),
        (Quantity(value=4, low=0, high=8), Quantity(value=4, low=4, high=4), 0, 2),
    ],
)
def test_the_ratio_of_a_bound_is_an_interval(
    now: Quantity, before: Quantity, low: float, high: float
) -> None:
    """A bound stands for any value from 0 to its upper limit."""
    ratio = ratio_of(now, before)
    assert [ratio.low, ratio.high] == pytest.approx([low, high])


def test_the_limit_of_a_sensor_applies_to_each_axis() -> None:
    """The limit of an axis applies in addition. Units are those of the file."""
    result = _check(
        '[gyroscope]\nN = { max = 0.43, unit = "deg/sqrt(h)" }\n[gyro_z]\nN = { min = 0.43, unit = "°/√h" }\n'
    )
    assert _verdicts(result) == {
        "gyro_x N <= 0.43 deg/sqrt(h)": "pass",
        "gyro_y N <= 0.43 deg/sqrt(h)": "fail",
        "gyro_z N <= 0.43 deg/sqrt(h)": "pass",
        "gyro_z N >= 0.43 deg/sqrt(h)": "fail",
    }
    assert result.verdict == "fail"
    assert not result.passed


def test_sentences_contain_the_value_and_the_limit() -> None:
    """There is one sentence per verdict; a bound is reported as a bound."""
    texts = [row.text for row in _check("[gyroscope]\nK = { max = 5e-7 }").rows]
    assert texts[:3] == [
        "gyro_x: K is 1.1e-06 [9.509e-07, 1.272e-06] rad/s/sqrt(s); above the largest allowed, 5e-07",
        "gyro_y: K is not detected, but <= 4.1e-07 rad/s/sqrt(s); not above the largest allowed, 5e-07",
        "gyro_z: K is 3e-07 [2.593e-07, 3.47e-07] rad/s/sqrt(s); not above the largest allowed, 5e-07",
    ]


def test_each_gauss_markov_term_is_judged() -> None:
    """gyro_z has two such terms. An axis without one is undecided, and the text explains that."""
    result = _check("[gyroscope]\nGM = { max = 5e-5 }")
    assert _verdicts(result) == {
        "gyro_x GM <= 5e-05 rad/s": "undecided",
        "gyro_y GM <= 5e-05 rad/s": "undecided",
        "gyro_z GM1 <= 5e-05 rad/s": "pass",
        "gyro_z GM2 <= 5e-05 rad/s": "fail",
    }
    assert result.rows[0].text.startswith("gyro_x: the model has no GM and no bound for it;")


def test_rate_duration_gaps_and_missing_samples_can_be_limited() -> None:
    """A sensor has one row if its axes agree."""
    result = _check(
        '[log]\nrate = { min = 199, max = 201 }\nduration = { min = 4, unit = "h" }\n'
        'gaps = { max = 0 }\nmissing = { max = 2, unit = "%" }'
    )
    verdicts = _verdicts(result)
    assert verdicts["gyro rate >= 199 Hz"] == verdicts["gyro rate <= 201 Hz"] == "pass"
    assert verdicts["accel duration >= 4 h"] == "fail"
    assert verdicts["gyro gaps <= 0"] == "fail"
    assert verdicts["gyro missing <= 2 %"] == "pass"


def test_mean_standard_deviation_and_minimum_can_be_limited() -> None:
    """The minimum has the interval of the curve; mean and std have none."""
    axis = consumer_report().axes[0]
    ((_, minimum),) = measure(axis, "minimum")
    assert minimum.value == axis.fit.curve.minimum[0]
    assert minimum.low < minimum.value < minimum.high
    assert measure(axis, "mean") == (("mean", Quantity.exactly(2.1e-3)),)
    verdicts = _verdicts(_check("[gyro_x]\nmean = { min = -1e-3, max = 1e-3 }\nstd = { max = 1 }"))
    assert list(verdicts.values()) == ["pass", "fail", "pass"]


def test_a_missing_axis_fails() -> None:
    """Cases: an axis with a limit, a required axis, a sensor, and an axis whose fit failed."""
    report = small_report()
    rows = _check("[gyro_y]\nN = { max = 1 }", report).rows
    assert rows[0].text == "gyro_y: the report has no such axis; found gyro_x"
    rows = _check("[accelerometer]\nN = { max = 1 }", report).rows
    assert rows[0].text == "accel: the report has no axis of this sensor; found gyro_x"
    assert _verdicts(_check('[gyroscope]\naxes = ["x", "z"]', report)) == {"gyro_z axes": "fail"}
    broken = replace(
        report, findings=(Finding(level="error", code="stuck", text="all samples are equal", axis="gyro_y"),)
    )
    text = "[gyroscope]\nN = { max = 1 }\n[findings]\nlevel = 'none'"
    assert _verdicts(_check(text, broken)) == {"gyro_y axes": "fail", "gyro_x N <= 1 rad/s/sqrt(Hz)": "pass"}


@pytest.mark.parametrize(
    ("rules", "failed"),
    [
        ("", []),
        ("[findings]\nlevel = 'warning'", ["tone", "warm-up"]),
        ("[findings]\nlevel = 'warning'\nallow = ['tone']", ["warm-up"]),
        ("[findings]\nlevel = 'none'\nforbid = ['gaps']", ["gaps"]),
        ("[findings]\nlevel = 'info'", ["gaps", "tone", "warm-up"]),
    ],
)
def test_findings_are_forbidden_by_level_and_code(rules: str, failed: list[str]) -> None:
    """By default an error is forbidden and a warning is not."""
    result = _check(f"{rules}\n[gyro_x]\nN = {{ max = 1 }}")
    assert [row.subject for row in result.rows if row.verdict == "fail"] == failed


def test_an_error_among_the_findings_fails_by_default() -> None:
    """An error means that the numbers are wrong."""
    wrong = Finding(level="error", code="units", text="the gyroscope is in deg/s", axis="gyro")
    report = replace(consumer_report(), findings=(wrong,))
    result = _check("[gyro_x]\nN = { max = 1 }", report)
    assert result.rows[-1].text == "gyro: forbidden error [units]: the gyroscope is in deg/s"
    assert result.verdict == "fail"


def test_an_undecided_row_fails_only_on_request() -> None:
    """K of gyro_x has an interval around 1.1e-6."""
    text = "[gyro_x]\nK = { max = 1.1e-6 }"
    result = _check(text)
    assert (result.verdict, result.passed) == ("undecided", True)
    result = _check(f'undecided = "fail"\n{text}')
    assert (result.verdict, result.passed) == ("undecided", False)


def test_a_baseline_limits_the_change_of_each_term() -> None:
    """The same report passes with a ratio of 1; a third more white noise fails, a third less passes."""
    accel = consumer_report().axes[3:]
    louder = replace(consumer_report(), axes=(_gyro("N=1.6e-4"), *accel))
    base = replace(consumer_report(), axes=(_gyro("N=1.2e-4"), *accel))
    text = "[baseline]\nterms = ['N']\nmax_increase = 0.2\nmax_decrease = 0.2"
    assert set(_verdicts(_check(text, base, base)).values()) == {"pass"}
    verdicts = _verdicts(_check(text, louder, base))
    assert verdicts["gyro_x N / baseline <= 1.2"] == "fail"
    assert verdicts["gyro_x N / baseline >= 0.8"] == "pass"
    assert _verdicts(_check(text, base, louder))["gyro_x N / baseline >= 0.8"] == "fail"


def _gyro(text: str) -> AxisReport:
    return axis_report(Sensor.GYROSCOPE, "x", f"{text} + B=2e-5 + K=1e-6")


def test_the_baseline_in_the_limits_file_is_loaded(tmp_path: Path) -> None:
    """The path is relative to the limits file; a missing file is a read error."""
    limits = parse_limits('[baseline]\nreport = "golden/report.json"', folder=tmp_path)
    with pytest.raises(ReadError, match=r"golden/report\.json: no such file"):
        check(consumer_report(), limits)
    (tmp_path / "golden").mkdir()
    (tmp_path / "golden" / "report.json").write_text(dumps(to_document(consumer_report())))
    assert check(consumer_report(), limits).passed


def test_a_report_passes_with_itself_as_baseline() -> None:
    """Every ratio is exactly 1, including those of bounds, and no row is undecided."""
    result = _check(
        "[baseline]\nmax_increase = 0.01\nmax_decrease = 0.01", consumer_report(), consumer_report()
    )
    assert {row.verdict for row in result.rows} == {"pass"}
    assert {row.measured for row in result.rows if row.measured} == {Quantity.exactly(1.0)}
    assert sum("baseline" in row.subject for row in result.rows) == 2 * 3 * 6


def test_equal_bounds_of_two_records_are_undecided() -> None:
    """Bounds of two logs can be equal by chance, so their ratio is unknown."""
    other = consumer_report()
    other = replace(other, axes=tuple(replace(axis, std=2 * axis.std) for axis in other.axes))
    assert "undecided" in {row.verdict for row in _check("[baseline]", consumer_report(), other).rows}


def test_a_lost_axis_fails_and_a_new_term_is_undecided() -> None:
    """A missing baseline is an error."""
    rows = _check("[baseline]", small_report(), consumer_report()).rows
    assert {row.where for row in rows if row.verdict == "fail"} == {
        f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"
    }
    rows = _check("[baseline]\nterms = ['GM']", consumer_report(), consumer_report()).rows
    assert [row.subject for row in rows if "baseline" in row.subject] == ["GM1 / baseline", "GM2 / baseline"]
    with pytest.raises(LimitsError, match="a baseline without a report"):
        _check("[baseline]")


def test_the_level_is_taken_from_the_fit() -> None:
    """Without a fitted axis it is the default."""
    report = small_report()
    axis = replace(report.axes[0], fit=replace(report.axes[0].fit, level=0.9))
    assert _check("[gyro_x]\nN = { max = 1 }", replace(report, axes=(axis,))).level == 0.9
    assert _check("[gyro_x]\nN = { max = 1 }", replace(report, axes=())).level == 0.95


def test_a_minimum_with_unknown_degrees_of_freedom_has_no_interval() -> None:
    """With very few degrees of freedom the upper limit is infinite."""
    axis = consumer_report().axes[0]
    for edf in (1e-3, math.nan):
        curve = replace(axis.fit.curve, edf=np.full(axis.fit.curve.tau.size, edf))
        with np.errstate(divide="ignore"):
            ((_, minimum),) = measure(replace(axis, fit=replace(axis.fit, curve=curve)), "minimum")
        assert minimum == Quantity(value=(x := curve.minimum[0]), low=x, high=x, unit=axis.unit)


def test_relative_widths_of_a_ratio_add_in_quadrature() -> None:
    """The lower and the upper widths are added separately, on the logarithmic scale."""
    now = Quantity(value=8.0, low=8.0 / math.exp(0.3), high=8.0 * math.exp(0.5))
    before = Quantity(value=2.0, low=2.0 / math.exp(1.2), high=2.0 * math.exp(0.4))
    ratio = ratio_of(now, before)
    assert ratio.value == 4
    assert ratio.low == pytest.approx(4 * math.exp(-0.5))
    assert ratio.high == pytest.approx(4 * math.exp(1.3))
    assert ratio_of(Quantity.exactly(1.0), Quantity.exactly(0.0)).value == math.inf
    wide = Quantity(value=1.0, low=1e-200, high=1e200)
    assert ratio_of(wide, Quantity(value=1.0, low=1e-250, high=1.0)).high == math.inf


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (0.123456789, 0.123456789, 0.123456789, "0.123457"),
        (0.41234, 0.40001, 0.42, "0.4123 [0.4, 0.42]"),
        (None, 0.0, 0.2, "<= 0.2"),
        (None, 0.1, 0.2, "[0.1, 0.2]"),
        (None, 0.2, 0.2, "[0.2, 0.2]"),
        (None, 0.0, math.inf, "unknown"),
        (None, 0.1, math.inf, ">= 0.1"),
    ],
)
def test_the_text_of_a_quantity_contains_value_and_interval(
    value: float | None, low: float, high: float, text: str
) -> None:
    """The text of an undetected term contains its bound."""
    assert Quantity(value=value, low=low, high=high).text() == text


def test_an_error_of_a_sensor_without_limits_adds_no_row() -> None:
    """A failed accelerometer does not matter to a file that only limits the gyroscope, nor does a warning."""
    for level, axis in (("error", "accel_y"), ("warning", "gyro_y"), ("error", "gyro"), ("error", None)):
        found = Finding(level=level, code="stuck", text="all samples are equal", axis=axis)  # type: ignore[arg-type]
        report = replace(small_report(), findings=(found,))
        result = _check("[gyroscope]\nN = { max = 1 }\n[findings]\nlevel = 'none'", report)
        assert _verdicts(result) == {"gyro_x N <= 1 rad/s/sqrt(Hz)": "pass"}


def test_axes_with_different_rates_have_separate_rows() -> None:
    """Axes that agree share a row."""
    report = consumer_report()
    axes = (replace(report.axes[0], rate_hz=100.0), *report.axes[1:])
    rows = _check("[log]\nrate = { min = 150 }\ngaps = { max = 1 }", replace(report, axes=axes)).rows
    assert [(row.where, row.subject, row.verdict) for row in rows[:-1]] == [
        ("gyro_x", "rate", "fail"),
        ("gyro_y", "rate", "pass"),
        ("gyro_z", "rate", "pass"),
        ("accel", "rate", "pass"),
        ("gyro", "gaps", "pass"),
        ("accel", "gaps", "pass"),
    ]
    ((_, missing),) = measure(report.axes[0], "missing")
    assert missing.value == pytest.approx(24_000 / (2_160_000 + 24_000))


def test_each_kind_of_limit_has_its_sentence() -> None:
    """One axis has limits of all kinds, and the baseline is a third lower."""
    text = """
        [log]
        duration = { min = 4, unit = "h" }
        [gyroscope]
        axes = ["x"]
        N = { min = 0.3, max = 0.4, unit = "deg/sqrt(h)" }
        GM = { max = 1 }
        [gyro_x]
        mean = { max = 2e-3 }
        [findings]
        level = "info"
        allow = ["gaps"]
        [baseline]
        terms = ["N", "K"]
        max_increase = 0.2
        max_decrease = 0
    """
    report = consumer_report()
    now = replace(report, axes=report.axes[:1])
    before = axis_report(Sensor.GYROSCOPE, "x", "N=0.9e-4 + B=2.4e-5", n=1000)
    result = _check(text, now, replace(report, axes=(before,)))
    long, without = "; record for longer to decide", "fit a model with it, or remove the limit"
    assert [f"{row.verdict}: {row.text}" for row in result.rows] == [
        "pass: gyro: gyro_x are present",
        "fail: gyro_x: duration is 3.03333 h; below the smallest allowed, 4",
        "pass: gyro_x: N is 0.4125 [0.4109, 0.4141] deg/sqrt(h); not below the smallest allowed, 0.3",
        "fail: gyro_x: N is 0.4125 [0.4109, 0.4141] deg/sqrt(h); above the largest allowed, 0.4",
        f"undecided: gyro_x: the model has no GM and no bound for it; {without}",
        "fail: gyro_x: mean is 0.0021 rad/s; above the largest allowed, 0.002",
        f"fail: gyro_x: forbidden warning [tone]: {now.axes[0].findings[0].text}",
        "fail: gyro_x: N / baseline is 1.333 [1.326, 1.341]; above the largest allowed, 1.2",
        "pass: gyro_x: N / baseline is 1.333 [1.326, 1.341]; not below the smallest allowed, 1",
        "undecided: gyro_x: the baseline's model has no K",
    ]
    assert (result.count("pass"), result.count("fail"), result.count("undecided")) == (3, 5, 2)
    bounds = [row.text for row in _check("[gyro_y]\nK = { min = 1e-7, max = 1e-7 }").rows[:2]]
    found = "K is not detected, but <= 4.1e-07 rad/s/sqrt(s)"
    assert bounds == [
        f"gyro_y: {found}; the interval contains the {side} allowed, 1e-07{long}"
        for side in ("smallest", "largest")
    ]
