"""``imucal info``: what is in a log, on 80 columns or as JSON."""

import json
from pathlib import Path

from tests.cli.run import run
from tests.readers.logs import Samples, imu_messages, samples, write_bag, write_db3, write_mcap

TRUTH = samples(300)


def test_prints_topics_and_gaps(tmp_path: Path) -> None:
    """Topic, type, count, rate, duration, sensors; then rate, gaps and units of what was read."""
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
    assert "/imu/data: 100 Hz by header stamp, 300 samples, 1 gaps, 10 missing" in done.stdout
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
    """The index is enough for what the first table shows."""
    write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH))
    done = run("info", "--no-gaps", "log.mcap", cwd=tmp_path)
    assert "Gaps are not looked for in a large log; --gaps reads all samples." in done.stdout
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
