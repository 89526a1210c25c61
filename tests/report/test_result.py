"""The overview: the raw signal reduced to a size that can be drawn."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.clock import Clock, Segment
from imucal.grading import judge_findings
from imucal.prediction.filter_numbers import filter_numbers
from imucal.recording import AxisSeries, Sensor
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS
from imucal.report.json_file import to_document
from imucal.report.page import render_page
from imucal.report.result import Overview
from tests.report.synthetic import consumer_report

_NAN = np.nan


@pytest.mark.parametrize(
    ("stretches", "time", "low", "high"),
    [
        (1, [6.5], [0], [9]),
        (3, [2, 6.5, 11], [0, 4, 6], [3, 5, 9]),
        # The third of six stretches is in the gap.
        (6, [1, 3, 5, 7.5, 10, 12], [0, 2, _NAN, 4, 6, 8], [1, 3, _NAN, 5, 7, 9]),
        (99, [k + 0.5 for k in range(13)], [0, 1, 2, 3, *[_NAN] * 3, 4, 5, 6, 7, 8, 9], None),
    ],
)
def test_an_overview_contains_the_extremes_of_equal_stretches(
    stretches: int, time: list[float], low: list[float], high: list[float] | None
) -> None:
    """The log has ten samples at 10 Hz on thirteen places, starting at the fifth; three places are a gap."""
    segments = (Segment(start=0, stop=4, offset=5), Segment(start=4, stop=10, offset=12))
    clock = Clock(source="stamps", rate_hz=10.0, segments=segments)
    series = AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=np.arange(10.0), clock=clock)
    overview = Overview.of(series, stretches=stretches)
    npt.assert_allclose(overview.time_s, np.array(time) / 10)
    npt.assert_array_equal(overview.low, low)
    npt.assert_array_equal(overview.high, low if high is None else high)


def test_an_overview_without_samples_is_empty() -> None:
    clock = Clock(source="stamps", rate_hz=10.0, segments=())
    overview = Overview.of(AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=np.zeros(0), clock=clock))
    assert overview.time_s.size == overview.low.size == overview.high.size == 0


def test_the_verdict_and_each_pair_for_filters_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page, the JSON and the config files ask for them many times."""
    report = consumer_report()
    verdicts, requests = [], []
    judge, numbers = judge_findings, filter_numbers

    def judged(*args: object, **options: object) -> object:
        verdicts.append(options)
        return judge(*args, **options)  # type: ignore[arg-type]

    def counted(fits: list[object], **options: object) -> object:
        requests.append((*map(id, fits), *options.items()))
        return numbers(fits, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("imucal.report.result.judge_findings", judged)
    monkeypatch.setattr("imucal.report.result.filter_numbers", counted)
    for _ in range(2):
        to_document(report)
        render_page(report)
        for target in TARGETS.values():
            target.render(report, DEFAULT_OPTIONS)
    assert len(verdicts) == 1
    assert len(requests) == len(set(requests)) > 2
