"""Verdicts: by the interval, for each axis, and never by what isn't there."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.checking import CheckResult, Measured, check, parse_limits
from imucal.checking.gate import measure, relative
from imucal.checking.verdict import judge
from imucal.errors import LimitsError, ReadError
from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.report.document import to_document
from imucal.report.json_file import dumps
from imucal.report.result import AxisReport, Report
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
    """Wholly within passes, wholly beyond fails, the limit inside is undecided; the point plays no part."""
    for value in (low, high):
        measured = Measured(value=value, low=low, high=high)
        row = judge("gyro_x", "N", measured, side=side, limit=1.0)  # type: ignore[arg-type]
        assert row.verdict == verdict


@pytest.mark.parametrize(("limit", "verdict"), [(1.0, "pass"), (0.5, "undecided")])
def test_a_bound_never_exceeds_a_largest_value(limit: float, verdict: str) -> None:
    """What the data don't show is between 0 and its bound."""
    measured = Measured(value=None, low=0.0, high=0.9)
    assert judge("gyro_x", "K", measured, side="max", limit=limit).verdict == verdict


def test_a_true_value_at_the_limit_fails_and_passes_as_seldom_as_the_level_says() -> None:
    """With 95 % intervals a sensor exactly at its limit fails in 2.5 % and passes in 2.5 % of records."""
    replications, deviation = 20_000, 0.1
    estimates = np.exp(deviation * np.random.default_rng(6).standard_normal(replications))
    wide = math.exp(1.96 * deviation)
    verdicts = [
        judge("x", "N", Measured(value=e, low=e / wide, high=e * wide), side="max", limit=1.0).verdict
        for e in estimates.tolist()
    ]
    # Four standard errors of a proportion of 0.025.
    error = 4 * math.sqrt(0.025 * 0.975 / replications)
    assert verdicts.count("fail") / replications == pytest.approx(0.025, abs=error)
    assert verdicts.count("pass") / replications == pytest.approx(0.025, abs=error)


def test_the_interval_of_a_ratio_covers_the_ratio() -> None:
    """Of two estimates with lopsided 95 % intervals of unequal width, 95 % of ratios cover the truth."""
    replications = 20_000
    rng = np.random.default_rng(66)
    covered = 0
    draws = np.exp(rng.standard_normal((replications, 2)) * [0.3, 0.05])
    for a, b in draws.tolist():
        now = Measured(value=a, low=a / math.exp(1.96 * 0.3), high=a * math.exp(1.96 * 0.3))
        before = Measured(value=b, low=b / math.exp(1.96 * 0.05), high=b * math.exp(1.96 * 0.05))
        ratio = relative(now, before)
        covered += ratio.low <= 1 <= ratio.high
    # Four standard errors of a proportion of 0.95.
    assert covered / replications == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / replications))


@pytest.mark.parametrize(
    ("now", "before", "low", "high"),
    [
        (Measured(value=None, low=0, high=2), Measured(value=4, low=2, high=8), 0, 1),
        (Measured(value=4, low=2, high=8), Measured(value=None, low=0, high=4), 0.5, math.inf),
        (Measured(value=None, low=0, high=2), Measured(value=None, low=0, high=4), 0, math.inf),
        (Measured(value=4, low=0, high=8), Measured(value=4, low=4, high=4), 0, 2),
    ],
)
def test_the_ratio_of_a_bound_is_an_interval(
    now: Measured, before: Measured, low: float, high: float
) -> None:
    """A bound is any value from 0 to its upper limit."""
    ratio = relative(now, before)
    assert [ratio.low, ratio.high] == pytest.approx([low, high])


def test_a_sensors_limit_is_for_each_of_its_axes() -> None:
    """And an axis's own limit adds to it; units are those of the file."""
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


def test_sentences_say_what_was_found_and_allowed() -> None:
    """One sentence a verdict; a bound is named as one."""
    texts = [row.text for row in _check("[gyroscope]\nK = { max = 5e-7 }").rows]
    assert texts[:3] == [
        "gyro_x: K is 1.1e-06 [9.509e-07, 1.272e-06] rad/s/sqrt(s); above the largest allowed, 5e-07",
        "gyro_y: K is not identified, but <= 4.1e-07 rad/s/sqrt(s); not above the largest allowed, 5e-07",
        "gyro_z: K is 3e-07 [2.593e-07, 3.47e-07] rad/s/sqrt(s); not above the largest allowed, 5e-07",
    ]


def test_each_gauss_markov_term_is_judged() -> None:
    """gyro_z has two; an axis whose model has none is undecided, with words."""
    result = _check("[gyroscope]\nGM = { max = 5e-5 }")
    assert _verdicts(result) == {
        "gyro_x GM <= 5e-05 rad/s": "undecided",
        "gyro_y GM <= 5e-05 rad/s": "undecided",
        "gyro_z GM1 <= 5e-05 rad/s": "pass",
        "gyro_z GM2 <= 5e-05 rad/s": "fail",
    }
    assert result.rows[0].text.startswith("gyro_x: the model has no GM, and no bound on it;")


def test_quantities_of_the_log() -> None:
    """Rate, duration, gaps and missing samples; one row a sensor where its axes agree."""
    result = _check(
        '[log]\nrate = { min = 199, max = 201 }\nduration = { min = 4, unit = "h" }\n'
        'gaps = { max = 0 }\nmissing = { max = 2, unit = "%" }'
    )
    verdicts = _verdicts(result)
    assert verdicts["gyro rate >= 199 Hz"] == verdicts["gyro rate <= 201 Hz"] == "pass"
    assert verdicts["accel duration >= 4 h"] == "fail"
    assert verdicts["gyro gaps <= 0"] == "fail"
    assert verdicts["gyro missing <= 2 %"] == "pass"


def test_mean_spread_and_minimum() -> None:
    """The curve's minimum has the interval of the curve; mean and std have none."""
    axis = consumer_report().axes[0]
    ((_, minimum),) = measure(axis, "minimum")
    assert minimum.value == axis.fit.curve.minimum[0]
    assert minimum.low < minimum.value < minimum.high
    assert measure(axis, "mean") == (("mean", Measured.exactly(2.1e-3)),)
    verdicts = _verdicts(_check("[gyro_x]\nmean = { min = -1e-3, max = 1e-3 }\nstd = { max = 1 }"))
    assert list(verdicts.values()) == ["pass", "fail", "pass"]


def test_a_missing_axis_fails() -> None:
    """Nothing passes by not being there: an axis with a limit, a required one, a sensor, one that failed."""
    report = small_report()
    rows = _check("[gyro_y]\nN = { max = 1 }", report).rows
    assert rows[0].text == "gyro_y: the report has no such axis; found gyro_x"
    rows = _check("[accelerometer]\nN = { max = 1 }", report).rows
    assert rows[0].text == "accelerometer: the report has no axis of it; found gyro_x"
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
    """By default an error is forbidden, a warning is not."""
    result = _check(f"{rules}\n[gyro_x]\nN = {{ max = 1 }}")
    assert [row.subject for row in result.rows if row.verdict == "fail"] == failed


def test_an_error_among_the_findings_fails_by_default() -> None:
    """An error says that the numbers are wrong."""
    wrong = Finding(level="error", code="units", text="the gyroscope is in deg/s", axis="gyro")
    report = replace(consumer_report(), findings=(wrong,))
    result = _check("[gyro_x]\nN = { max = 1 }", report)
    assert result.rows[-1].text == "gyro: forbidden error [units]: the gyroscope is in deg/s"
    assert result.verdict == "fail"


def test_undecided_fails_only_where_asked() -> None:
    """K of gyro_x has an interval about 1.1e-6."""
    text = "[gyro_x]\nK = { max = 1.1e-6 }"
    result = _check(text)
    assert (result.verdict, result.passed) == ("undecided", True)
    result = _check(f'undecided = "fail"\n{text}')
    assert (result.verdict, result.passed) == ("undecided", False)


def test_a_baseline_limits_the_change_of_each_term() -> None:
    """The same report is 1 by its interval; a third more white noise fails, a third less passes."""
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


def test_the_baseline_that_the_limits_name_is_loaded(tmp_path: Path) -> None:
    """From the folder of the limits file; one that isn't there is a read error."""
    limits = parse_limits('[baseline]\nreport = "golden/report.json"', folder=tmp_path)
    with pytest.raises(ReadError, match=r"golden/report\.json: no such file"):
        check(consumer_report(), limits)
    (tmp_path / "golden").mkdir()
    (tmp_path / "golden" / "report.json").write_text(dumps(to_document(consumer_report())))
    assert check(consumer_report(), limits).passed


def test_a_baseline_that_the_report_does_not_match() -> None:
    """A lost axis fails; a term the baseline lacks is undecided; no baseline at all is an error."""
    rows = _check("[baseline]", small_report(), consumer_report()).rows
    assert {row.where for row in rows if row.verdict == "fail"} == {
        f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"
    }
    rows = _check("[baseline]\nterms = ['GM']", consumer_report(), consumer_report()).rows
    assert [row.subject for row in rows if "baseline" in row.subject] == ["GM1 / baseline", "GM2 / baseline"]
    with pytest.raises(LimitsError, match="no older report was given"):
        _check("[baseline]")
