"""Files that are read together: which of them holds nothing but times, and how they become one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.clock import Clock
from imucal.findings import Finding
from imucal.readers.tables.text_table import merge, times_of
from imucal.recording import AxisSeries, Recording, Sensor, Source, Temperature


@pytest.mark.parametrize(
    ("content", "times"),
    [
        ("time\n1\n2\n", True),
        ("time\n1\n", False),
        ("count\n1\n2\n", False),
        ("time\n1\nx\n", False),
        ("time\n\n1\n2.5\n", True),
        ("time,gx\n1,2\n2,3\n", False),
        ("", False),
    ],
)
def test_a_file_of_times(content: str, times: bool, tmp_path: Path) -> None:  # noqa: FBT001 - of the case
    """One column named as a time, with two numbers or more."""
    path = tmp_path / "times.csv"
    path.write_text(content, encoding="utf-8")
    assert (times_of(path) is not None) == times


@pytest.mark.parametrize(
    ("header", "ns", "source"),
    [("time_ms", 1_000_000, "from the header of times.csv"), ("time", None, "")],
)
def test_the_unit_of_a_file_of_times(header: str, ns: int | None, source: str, tmp_path: Path) -> None:
    """The header is named as the source of the unit only where it has one."""
    path = tmp_path / "times.csv"
    path.write_text(f"{header}\n1\n2.5\n4\n", encoding="utf-8")
    times = times_of(path)
    assert times is not None
    assert (times.choice.name, times.choice.ns, times.choice.ns_source) == (header, ns, source)
    assert times.values.tolist() == [1.0, 2.5, 4.0]


def recording(sensor: Sensor, start_ns: int, *texts: str, temperature: bool = False) -> Recording:
    """Return one axis, with findings and decisions of some texts."""
    clock = replace(Clock.even(4, 10.0), start_ns=start_ns)
    return Recording(
        source=Source(
            path="part", format="csv", topics=(str(sensor),), decisions=tuple((t, t) for t in texts)
        ),
        series=(AxisSeries(samples=np.arange(4.0), clock=clock, sensor=sensor, axis="x"),),
        temperature=Temperature(samples=np.arange(4.0) + start_ns, clock=clock) if temperature else None,
        findings=tuple(Finding(level="info", code=text, text=text) for text in texts),
    )


def test_recordings_of_two_files_become_one() -> None:
    """The gyroscope first; what both say is said once; the first temperature there is."""
    accel = recording(Sensor.ACCELEROMETER, 5, "both", "accel")
    gyro = recording(Sensor.GYROSCOPE, 7, "both", "gyro", temperature=True)
    whole = merge([accel, gyro], ["a.csv", "g.csv"], "folder")
    assert [series.sensor for series in whole.series] == [Sensor.GYROSCOPE, Sensor.ACCELEROMETER]
    assert [series.clock.start_ns for series in whole.series] == [7, 5]
    assert whole.source.path == "folder"
    assert whole.source.topics == (str(Sensor.ACCELEROMETER), str(Sensor.GYROSCOPE))
    assert whole.source.decisions == (
        ("files", "a.csv, g.csv"),
        *(("both", "both"), ("accel", "accel"), ("gyro", "gyro")),
    )
    assert [finding.code for finding in whole.findings] == ["both", "accel", "gyro"]
    assert whole.temperature is gyro.temperature


def test_a_recording_of_one_file_is_itself() -> None:
    """Under the name of the set."""
    gyro = recording(Sensor.GYROSCOPE, 7, "one")
    whole = merge([gyro], ["g.csv"], "folder")
    assert whole.source.path == "folder"
    assert (whole.series, whole.findings) == (gyro.series, gyro.findings)
    assert whole.source.decisions == gyro.source.decisions


def test_clocks_that_are_equal_become_one() -> None:
    """So that what is found about them is found once."""
    parts = [recording(Sensor.ACCELEROMETER, 5), recording(Sensor.GYROSCOPE, 5)]
    first, second = merge(parts, ["a", "g"], "folder").series
    assert first.clock is second.clock
    parts = [recording(Sensor.ACCELEROMETER, 5), recording(Sensor.GYROSCOPE, 6)]
    first, second = merge(parts, ["a", "g"], "folder").series
    assert (first.clock.start_ns, second.clock.start_ns) == (6, 5)
