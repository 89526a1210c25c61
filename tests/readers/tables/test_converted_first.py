"""Logs that must be converted first: the error explains how, and its instructions work."""

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ImucalError
from imucal.readers import read
from imucal.recording import Recording
from tests.readers.tables.texts import (
    N,
    Truth,
    ardupilot_log,
    gnss_logger,
    kitti,
    lines,
    seconds,
    truth,
    vnimu,
    vnymr,
    xyz,
)

SI = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"


def refused(*paths: Path, **options: Any) -> str:  # noqa: ANN401 - options of any kind
    with pytest.raises(ImucalError) as caught:
        read(*paths, **options)
    return str(caught.value)


def typed(command: str, folder: Path) -> None:
    """Run a command in a folder."""
    shell = shutil.which("bash") or "sh"
    subprocess.run([shell, "-c", command], cwd=folder, check=True)  # noqa: S603 - what the message says


def is_truth(recording: Recording, tolerance: float = 0.0) -> None:
    """Check samples and rate."""
    for sensor, values in (("gyroscope", truth().gyro), ("accelerometer", truth().accel)):
        for index, axis in enumerate("xyz"):
            series = recording.axis(sensor, axis)
            np.testing.assert_allclose(series.samples, values[:, index], rtol=0, atol=tolerance)
            assert series.rate_hz == pytest.approx(100)
            assert series.clock.missing == 0


@pytest.mark.parametrize(
    ("build", "what"),
    [
        (ardupilot_log, "a text log of ArduPilot; give the binary log (.bin)"),
        (gnss_logger, "a log of GnssLogger; write the rows of each sensor to a CSV of its own"),
        (vnymr, "a log of VectorNav's messages; write it as CSV with a row for each sample"),
        (vnimu, "a log of VectorNav's messages; write it as CSV with a row for each sample"),
    ],
)
def test_the_text_of_a_logger_is_named(build: Callable[[Truth], str], what: str, tmp_path: Path) -> None:
    path = tmp_path / "a log.txt"
    path.write_text(build(truth()), encoding="utf-8")
    assert f"{path}: it is {what}" in refused(path)


def test_kitti_is_refused_with_a_list_of_its_columns(tmp_path: Path) -> None:
    """The manual contains the columns text for KITTI."""
    path = tmp_path / "oxts.txt"
    path.write_text(kitti(truth()), encoding="utf-8")
    assert "the 30 columns have no header; found columns: 0 = 0, " in refused(path)
    manual = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    match = re.search(r"--columns (g=17\S+) --rate (\d+) --gyro-unit ([^`]+)`", manual)
    assert match is not None
    is_truth(read(path, columns=match[1], rate_hz=float(match[2]), gyro_unit=match[3]))


def test_times_of_the_week_are_read_without_the_weeks(tmp_path: Path) -> None:
    """A columns text with weeks is refused with the right column."""
    path = tmp_path / "log.csv"
    tow = [f"{345_600 + ns * 1e-9:.3f}" for ns in truth().ns]
    path.write_text(lines(f"week,tow,{SI}", ["2200"] * N, tow, *xyz(truth().gyro), *xyz(truth().accel)))
    is_truth(read(path))
    message = refused(path, columns="t=week+tow,g=2:5,a=5:8")
    assert "week counts weeks, which imucal does not add to a time; use column 1 (tow) alone" in message
    is_truth(read(path, columns="t=1,g=2:5,a=5:8"))


def test_the_end_of_a_gps_week_is_a_clock_jump(tmp_path: Path) -> None:
    """The time of the week starts again at zero."""
    path = tmp_path / "log.csv"
    tow = [f"{(604_798 + ns * 1e-9) % 604_800:.3f}" for ns in truth().ns]
    path.write_text(lines(f"week,tow,{SI}", ["2200"] * N, tow, *xyz(truth().gyro), *xyz(truth().accel)))
    recording = read(path)
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert "clock-jump" in {finding.code for finding in recording.findings}


@pytest.mark.parametrize("name", ["dt", "delta_t"])
def test_a_column_of_time_steps_is_refused(name: str, tmp_path: Path) -> None:
    """The error explains how to compute a column of times. With a rate the log is read."""
    path = tmp_path / "log.csv"
    values = [*xyz(truth().gyro), *xyz(truth().accel)]
    path.write_text(lines(f"{name},{SI}", ["0.01"] * N, *values), encoding="utf-8")
    way = f"{name} contains steps, not times; write their running sum in a column time"
    assert f"no time column ({way}) and no sampling rate" in refused(path)
    assert way in refused(path, columns="t=0,g=1:4,a=4:7")
    assert way in refused(path, time=name)
    is_truth(read(path, rate_hz=100.0))
    times = [f"{value:.2f}" for value in np.cumsum(np.full(N, 0.01))]
    path.write_text(lines(f"time,{SI}", times, *values), encoding="utf-8")
    is_truth(read(path))


def test_dates_in_separate_columns_are_refused(tmp_path: Path) -> None:
    """The error explains how to write the date in one column. With a rate the log is read."""
    path = tmp_path / "log.csv"
    values = [*xyz(truth().gyro), *xyz(truth().accel)]
    second = [f"{56 + i // 100 if i < 400 else 0}.{i % 100:02d}" for i in range(N)]
    parts = [["2026"] * N, ["11"] * N, ["22"] * N, ["10"] * N, ["59"] * N, second]
    path.write_text(lines(f"year,month,day,hour,minute,second,{SI}", *parts, *values), encoding="utf-8")
    message = refused(path)
    assert "(minute, second: parts of a date; write date and time in one column, such as" in message
    match = re.search(r"such as (\S+ \S+)\)", message)
    assert match is not None
    is_truth(read(path, rate_hz=100.0))
    written = match[1].rpartition(":")[0]
    dates = [f"{written}:{float(text):05.2f}" for text in second]
    path.write_text(lines(f"time,{SI}", dates, *values), encoding="utf-8")
    is_truth(read(path))


def test_times_in_a_separate_file_are_refused(tmp_path: Path) -> None:
    """The error offers two solutions: join the files, or give the rate."""
    paths = [tmp_path / f"{name}.csv" for name in ("accel", "gyro", "time")]
    for path, header, columns in zip(
        paths,
        ("ax (m/s^2),ay (m/s^2),az (m/s^2)", "gx (rad/s),gy (rad/s),gz (rad/s)", "time (s)"),
        (xyz(truth().accel), xyz(truth().gyro), [seconds(truth())]),
        strict=True,
    ):
        path.write_text(lines(header, *columns), encoding="utf-8")
    message = refused(*paths)
    assert message.startswith(f"{paths[2]}: it contains only times; write them next to the samples")
    is_truth(read(*paths[:2], rate_hz=100.0))
    match = re.search(r"with (paste .*) > log.csv, or leave it out and give the sampling rate$", message)
    assert match is not None
    joined = match[1].replace("SAMPLES", f"{paths[0]} {paths[1]}")
    typed(f"{joined} > log.csv", tmp_path)
    is_truth(read(tmp_path / "log.csv"))
