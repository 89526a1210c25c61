"""``imucal info``: the contents of a log, on 80 columns or as JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.cli.info import _jitter, _what_was_read
from imucal.findings import Finding
from imucal.readers import TopicContents
from imucal.recording import AxisSeries, Recording, Sensor, Source
from tests.cli.run import run
from tests.readers.logs import Samples, imu_messages, samples, write_bag, write_db3, write_mcap

TRUTH = samples(300)


def test_prints_topics_and_gaps(tmp_path: Path) -> None:
    """The table has topic, type, count, rate, duration and sensors; rate, gaps and units follow."""
    gap = Samples(
        stamps=TRUTH.stamps + (TRUTH.stamps > TRUTH.stamps[150]) * 100_000_000,
        log=TRUTH.log,
        gyro=TRUTH.gyro,
        accel=TRUTH.accel,
    )
    write_mcap(tmp_path / "log.mcap", imu_messages(gap))
    done = run("info", "log.mcap", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == "log.mcap"
    assert lines[1].startswith("  mcap, compression zstd, ")
    assert lines[3].split() == ["topic", "type", "messages", "rate", "duration", "sensors"]
    assert lines[4].split()[:4] == ["/imu/data", "sensor_msgs/msg/Imu", "300", "100"]
    assert lines[4].endswith(" 2.99 s  gyro, accel")
    assert "/imu/data: 100 Hz by header stamp, 300 samples, 1 gap, 10 missing" in done.stdout
    assert "gyroscope unit: rad/s, from the message type" in done.stdout
    assert "[gaps]: 10 samples" in done.stdout


def test_long_names_stay_within_80_columns(tmp_path: Path) -> None:
    """They are cut in their middle and repeated in full."""
    topic = "/robot/with/a/very/long/name/sensors/front/left/imu/data_raw"
    write_db3(tmp_path / "bag", imu_messages(TRUTH, topic=topic))
    done = run("info", "bag", cwd=tmp_path)
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert f"      {topic}" in done.stdout.splitlines()


def test_prints_json(tmp_path: Path) -> None:
    """Every figure of the text, for several logs."""
    write_mcap(tmp_path / "a.mcap", imu_messages(TRUTH))
    write_bag(tmp_path / "b.bag", imu_messages(TRUTH, ros1=True), compression="lz4")
    done = run("info", "--json", "a.mcap", "b.bag", cwd=tmp_path)
    assert done.returncode == 0
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/info/1"
    first, second = document["logs"]
    assert (first["format"], second["format"]) == ("mcap", "rosbag1")
    assert (first["compression"], second["compression"]) == ("zstd", "lz4")
    (topic,) = first["topics"]
    assert topic["name"] == "/imu/data"
    assert topic["count"] == 300
    assert topic["sensors"] == ["gyroscope", "accelerometer"]
    assert topic["clocks"]["gyroscope"]["samples"] == 300
    assert topic["clocks"]["gyroscope"]["gaps"] == []


def test_reads_no_samples_where_it_need_not(tmp_path: Path) -> None:
    """The index contains the values of the first table."""
    write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH))
    done = run("info", "--no-gaps", "log.mcap", cwd=tmp_path)
    assert "Gaps were not checked in a large log; --gaps reads all samples." in done.stdout
    assert "header stamp" not in done.stdout


def test_shows_what_can_not_be_read(tmp_path: Path) -> None:
    """A log of nothing is listed all the same, and a missing file ends with code 3."""
    write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH)[:1])
    done = run("info", "log.mcap", cwd=tmp_path)
    assert done.returncode == 0
    assert "/imu/data: log.mcap: topic /imu/data: one sample (header stamp)" in done.stdout
    done = run("info", "nowhere.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr == "Error: nowhere.mcap: can't be opened: No such file or directory\n"


def test_a_finding_is_printed_once() -> None:
    """Not for each sensor, and not for each topic where it is about the whole log."""
    gap = Finding(level="warning", code="gaps", text="3 samples are missing.")
    whole = Finding(level="info", code="dropouts", text="The logger lost some.", advice="Log less.")
    series = AxisSeries.from_samples(np.arange(9.0), rate_hz=100.0, sensor=Sensor.GYROSCOPE)
    recording = Recording(
        source=Source(path="log.csv", format="csv", decisions=(("topic", "/a: as given"),)),
        series=(series,),
        findings=(replace(gap, axis="gyro"), replace(gap, axis="accel"), whole),
    )
    topic = TopicContents(name="/a", type="table")
    said = {("info", "dropouts", "The logger lost some. Log less.")}
    lines = list(_what_was_read(topic, recording, said))
    assert lines == [
        "",
        "/a: 100 Hz by given rate, 9 samples, no gaps",
        "  warning [gaps] gyro accel: 3 samples are missing.",
    ]


def test_units_of_a_table_are_printed_once(tmp_path: Path) -> None:
    """Where they were read with the samples, the list of topics does not repeat them."""
    rows = "\n".join(f"{0.01 * i:.2f},0.1,0.2,0.{i % 7},1,2,9.8{i % 3}" for i in range(200))
    heading = "t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    (tmp_path / "log.csv").write_text(f"{heading}\n{rows}\n", encoding="utf-8")
    done = run("info", "log.csv", cwd=tmp_path)
    assert done.stdout.count("gyroscope unit") == 1
    assert "from 1970" not in done.stdout
    assert run("info", "--no-gaps", "log.csv", cwd=tmp_path).stdout.count("gyroscope unit") == 1


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "no jitter"), (7.16e-8, "jitter 71.6 ns"), (3.4e-5, "jitter 34 us"), (0.0445, "jitter 44.5 ms")],
)
def test_jitter_is_in_the_unit_of_its_size(seconds: float, text: str) -> None:
    """Not 7.16e-05 ms."""
    assert _jitter(seconds) == text


def test_standard_input_is_described_but_not_read_twice(tmp_path: Path) -> None:
    """Its samples are gone; --gaps can't bring them back."""
    rows = "\n".join(f"{0.01 * i:.2f},0.1,0.2,0.{i % 7},1,2,9.8{i % 3}" for i in range(200))
    text = f"t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]\n{rows}\n"
    for options in ((), ("--gaps",)):
        done = run("info", *options, "-", cwd=tmp_path, text=text)
        assert (done.returncode, done.stderr) == (0, "")
        assert "Gaps were not checked on standard input.\n" in done.stdout
