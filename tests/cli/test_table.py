"""The table on the terminal: 80 columns, every number with its interval, right when piped."""

import textwrap
from dataclasses import replace

import pytest

from imucal.cli._result_table import summary_table
from imucal.findings import Finding
from imucal.report.result import Report
from tests.report.synthetic import consumer_report, shortest_report, small_report


def test_both_sensors_are_side_by_side() -> None:
    """Word for word, in data-sheet units."""
    report = consumer_report()
    report = replace(report, axes=report.axes[:2] + report.axes[3:5])
    assert summary_table(report, datasheet=True, encoding="utf-8").splitlines() == [
        "Check first: a tone on gyro_x; 3 of 4 axes are stationary noise, N to ±0.39 %",
        "",
        "GYROSCOPE                                ACCELEROMETER",
        "200 Hz, 2160000 samples, 3 h 2 min       200 Hz, 2160000 samples, 3 h",
        "",
        "                                         Q  quantization noise  m/s",
        "                                         x  0.00000200  [0.00000192, 0.00000208]",
        "",
        "N  angle random walk  deg/√h             N  velocity random walk  m/s/√h",
        "x  0.4125  [0.4109, 0.4141]              x  0.06600  [0.06574, 0.06626]",
        "y  0.4469  [0.4452, 0.4487]              y  0.07800  [0.07770, 0.07831]",
        "",
        "minimum of the curve  deg/h              minimum of the curve  µg",
        "(data sheets call it bias instability)   (data sheets call it bias instability)",
        "x  3.6  [2.8, 5.0]  at 328 s             x  19  [10, 110]  at 2620 s",
        "y  1.8  [1.1, 4.4]  at 1310 s            y  17  [9, 100]  at 2620 s",
        "",
        "B  flicker noise  deg/h                  B  flicker noise  µg",
        "(coefficient of the fit; floor 0.664 B)  (coefficient of the fit; floor 0.664 B)",
        "x  4.95  [4.76, 5.14]                    x  29.6  [28.5, 30.7]",
        "y  4.33  [4.17, 4.50]                    y  25.5  [24.5, 26.5]",
        "",
        "K  rate random walk  deg/h/√h            K  accel. random walk  m/s²/√h",
        "x  13.6   [11.8, 15.7]                   x  0.00054    [0.00047, 0.00062]",
        "y  < 5.1                                 y  < 0.00030",
        "",
        "[low, high]: 95 % interval; < high: not detected, upper bound",
    ]


@pytest.mark.parametrize("make", [consumer_report, small_report, lambda: shortest_report(4)])
@pytest.mark.parametrize("datasheet", [False, True])
@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1", "cp1252", "nonsense"])
def test_it_fits_80_columns_and_the_encoding(make: object, *, datasheet: bool, encoding: str) -> None:
    """Characters that the terminal can't print are replaced by words."""
    report = make()  # type: ignore[operator]
    odd = [replace(axis, rate_hz=285.7142857, duration_s=45.7) for axis in report.axes]
    report = replace(report, axes=tuple(odd))
    text = summary_table(report, datasheet=datasheet, encoding=encoding)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert all(line == line.rstrip() for line in text.splitlines())
    assert "\x1b" not in text
    if encoding != "utf-8":
        text.encode("ascii")
        assert "sqrt(" in text


def test_in_40_columns_the_sensors_are_one_below_the_other() -> None:
    """Remarks and the unit of a row are not longer than the column either."""
    for datasheet in (True, False):
        text = summary_table(consumer_report(), datasheet=datasheet, encoding="utf-8", columns=40)
        assert max(len(line) for line in text.splitlines()) <= 40
        assert text.count("(data sheets call it bias instability)\n") == 2
        assert text.index("GYROSCOPE") < text.index("K  rate") < text.index("ACCELEROMETER")


def test_si_units_share_a_power_of_ten() -> None:
    """The unit line names it once for the three axes."""
    lines = summary_table(consumer_report(), datasheet=False, encoding="utf-8").splitlines()
    place = next(i for i, line in enumerate(lines) if line.startswith("N  angle random walk"))
    assert lines[place].startswith("N  angle random walk  1e-6 rad/s/√Hz")
    assert lines[place + 1].startswith("x  120.0  [119.5, 120.5]")


def test_gauss_markov_terms_have_their_correlation_time() -> None:
    """Only axes with such a term are listed."""
    text = summary_table(consumer_report(), datasheet=True, encoding="utf-8")
    assert (
        "GM1  Gauss-Markov  deg/h\nz  8.3  [7.7, 8.9]\n\nGM1  correlation time  s\nz  90  [73, 111]" in text
    )


def test_a_heading_keeps_numbers_with_their_units() -> None:
    """A long rate is not torn from its Hz, and minutes not from min."""
    report = consumer_report()
    axes = [replace(axis, rate_hz=508.281, samples=14_992_000, duration_s=29_500.0) for axis in report.axes]
    lines = summary_table(replace(report, axes=tuple(axes)), datasheet=True).splitlines()
    assert [line[:39].rstrip() for line in lines[4:6]] == ["508.281 Hz, 14992000 samples,", "8 h 12 min"]


def test_axes_with_different_clocks_are_listed_separately() -> None:
    """If an axis is missing or has another rate, the heading names the axes."""
    report = consumer_report()
    slow = replace(report.axes[1], rate_hz=100.0)
    report = Report(source=report.source, axes=(report.axes[0], slow), settings={}, version="1", findings=())
    lines = summary_table(report, datasheet=True).splitlines()
    assert lines[2:5] == [
        "GYROSCOPE",
        "x: 200 Hz, 2160000 samples, 3 h 2 min",
        "y: 100 Hz, 2160000 samples, 3 h 2 min",
    ]


def test_axes_that_are_not_noise_are_left_out() -> None:
    """A stuck axis is omitted; for a moved log only the sentence is printed."""
    report = consumer_report()
    stuck = Finding(level="error", code="stuck", axis="gyro_x", text="It is stuck.")
    one = replace(report, findings=(*report.findings, stuck))
    text = summary_table(one, datasheet=True, encoding="utf-8")
    white = text[text.index("N  angle random walk") :].splitlines()
    assert [line[:1] for line in white[1:3]] == ["y", "z"]
    assert "x  0." not in "\n".join(line[:39] for line in white[:4])
    moved = replace(report, findings=(Finding(level="error", code="motion", text="It was moved."),))
    said = "Not noise: the IMU was moved; do not use these numbers"
    assert summary_table(moved, datasheet=True) == said
    assert summary_table(moved, datasheet=True, columns=40) == "\n".join(textwrap.wrap(said, 40))
    forced, whole = (summary_table(r, datasheet=True, forced=True) for r in (moved, report))
    assert forced.startswith(said)
    assert forced[forced.index("GYROSCOPE") :] == whole[whole.index("GYROSCOPE") :]
