"""Bags of several files, and several files as one recording."""

from pathlib import Path

import numpy as np
import pytest

from imucal.errors import ReadError
from imucal.readers import describe, read
from imucal.readers.containers.rosbag2_folder import natural, parse_metadata
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.logs import TOPIC, Samples, imu_messages, samples, write_bag, write_db3, write_mcap

TRUTH = samples(400)


def part(first: int, last: int) -> Samples:
    """Return some of the samples."""
    chosen = slice(first, last)
    return Samples(
        stamps=TRUTH.stamps[chosen], log=TRUTH.log[chosen], gyro=TRUTH.gyro[chosen], accel=TRUTH.accel[chosen]
    )


def rows(recording: Recording) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the samples, shape (n, 6)."""
    return np.array([series.samples for series in recording.series]).T


EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  compression_format: "{format}"
  compression_mode: "{mode}"
  relative_file_paths:
    - bag_10.mcap
    - "bag_2.mcap"
  topics_with_message_count:
    - topic_metadata:
        name: /imu/data
        type: sensor_msgs/msg/Imu
        serialization_format: cdr
      message_count: 400
    - message_count: 7
      topic_metadata:
        name: '/other'
        type: std_msgs/msg/String
  files:
    - path: bag_10.mcap
      message_count: 200
"""


def split(folder: Path) -> Path:
    """Write a bag of two files; the order of their names is not that of their times."""
    folder.mkdir()
    write_mcap(folder / "bag_10.mcap", imu_messages(part(0, 200)))
    write_mcap(folder / "bag_2.mcap", imu_messages(part(200, 400)))
    return folder


def test_files_are_read_in_the_order_of_the_metadata(tmp_path: Path) -> None:
    """The recording has no gap."""
    folder = split(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(METADATA, encoding="utf-8")
    recording = read(folder)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert len(recording.series[0].clock.segments) == 1
    assert recording.source.format == "rosbag2-mcap"
    contents = describe(folder)
    assert contents.topics[0].count == 400
    assert contents.duration_s == pytest.approx(3.99)
    assert contents.size_bytes == sum(file.stat().st_size for file in folder.glob("*.mcap"))


def test_a_folder_without_metadata_is_read_in_the_order_of_time(tmp_path: Path) -> None:
    """Each file must continue its predecessor."""
    recording = read(split(tmp_path / "bag"))
    assert np.array_equal(rows(recording), TRUTH.all)
    (finding,) = [finding for finding in recording.findings if finding.code == "joined"]
    assert finding.level == "info"
    assert finding.text == "2 logs are joined as one recording: bag_10.mcap, bag_2.mcap."


def test_a_missing_file_of_a_bag_is_reported(tmp_path: Path) -> None:
    """The other files are read."""
    folder = split(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(METADATA, encoding="utf-8")
    (folder / "bag_2.mcap").unlink()
    recording = read(folder)
    assert np.array_equal(rows(recording), TRUTH.all[:200])
    assert recording.findings[0].text == ("1 files of the bag are missing: bag_2.mcap; their time is a gap.")


def test_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    """The error lists its content."""
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "notes.md").write_text("nothing", encoding="utf-8")
    with pytest.raises(ReadError) as caught:
        read(folder)
    assert str(caught.value) == (
        f"{folder}: not the folder of a ROS 2 bag: it contains notes.md; expected .mcap or .db3 files"
    )


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (
            "report.json",
            "is a report of imucal; expected a log; to use the report run 'imucal export REPORT",
        ),
        ("run-1.fleet", "it is a fleet of imucal; give a log, or run 'imucal fleet report'"),
    ],
)
def test_a_folder_written_by_imucal_is_recognised(file: str, message: str, tmp_path: Path) -> None:
    """The error explains which command reads such a folder."""
    (tmp_path / file).write_text('{"schema": "imucal/report/4"}', encoding="utf-8")
    with pytest.raises(ReadError, match=f"{tmp_path}: {message}"):
        read(tmp_path)
    if file == "report.json":
        with pytest.raises(ReadError, match=f"it {message}"):
            read(tmp_path / file)


def test_metadata_are_parsed() -> None:
    """Metadata contain files, compression and message counts, in any order and with any quotes."""
    found = parse_metadata(METADATA.format(format="zstd", mode="MESSAGE"))
    assert found.files == ("bag_10.mcap", "bag_2.mcap")
    assert found.compression_mode == "MESSAGE"
    assert found.topic_counts == {"/imu/data": 400, "/other": 7}


def test_numbers_in_file_names_are_sorted_as_numbers() -> None:
    """bag_10 comes after bag_2."""
    names = ["bag_10.mcap", "bag_2.mcap", "bag_0.mcap", "a.mcap"]
    assert sorted(names, key=lambda name: natural(Path(name))) == [
        "a.mcap", "bag_0.mcap", "bag_2.mcap", "bag_10.mcap",
    ]  # fmt: skip


def test_files_of_different_formats_are_joined_with_a_gap(tmp_path: Path) -> None:
    """The first file is an MCAP file, the second a bag; missing samples between them are a gap."""
    first = write_mcap(tmp_path / "a_1.mcap", imu_messages(part(0, 150)))
    last = write_db3(tmp_path / "a_2", imu_messages(part(160, 400)))
    recording = read(last, first)
    assert np.array_equal(rows(recording), np.delete(TRUTH.all, np.s_[150:160], axis=0))
    (gap,) = recording.series[0].clock.gaps
    assert gap.missing == 10
    assert recording.source.path == f"{first}, {last}"
    assert recording.source.topics == (TOPIC,)


def test_tables_are_joined_in_the_order_of_their_first_samples(tmp_path: Path) -> None:
    paths = []
    for name, chosen in (("log_2.csv", part(0, 150)), ("log_1.csv", part(160, 400))):
        path = tmp_path / name
        lines = [EUROC]
        for stamp, row in zip(chosen.stamps.tolist(), chosen.all.tolist(), strict=True):
            lines.append(",".join([str(stamp), *map(repr, row)]))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        paths.append(path)
    recording = read(*paths)
    assert np.array_equal(rows(recording), np.delete(TRUTH.all, np.s_[150:160], axis=0))
    (gap,) = recording.series[0].clock.gaps
    assert gap.missing == 10
    assert recording.series[0].rate_hz == pytest.approx(100)


def test_files_of_different_rates_are_refused(tmp_path: Path) -> None:
    """Files with different rates do not belong to one recording."""
    first = write_mcap(tmp_path / "a_1.mcap", imu_messages(part(0, 150)))
    table = tmp_path / "a_2.csv"
    other = samples(50, rate=50.0)
    numbers = [[row / 50, *other.all[row].tolist()] for row in range(50)]
    lines = ["time,gx,gy,gz,ax,ay,az", *(",".join(map(repr, row)) for row in numbers)]
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(ReadError) as caught:
        read(first, table, join=True, gyro_unit="rad/s")
    assert str(caught.value) == (
        f"{first}: its rate is 100 Hz, and {table} has 50 Hz; expected one recording; read one log at a time"
    )


@pytest.mark.parametrize("mcap", [True, False], ids=["mcap", "db3"])
def test_a_single_zstd_file_of_a_bag_is_read(mcap: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """`.db3.zstd` and `.mcap.zstd` need no folder; a truncated database is refused."""
    truth = samples(6000)
    folder = write_db3(tmp_path / "bag", imu_messages(truth), compression="file", mcap=mcap)
    path = next(folder.glob("*.zstd"))
    assert np.array_equal(rows(read(path)), truth.all)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    if not mcap:
        with raises(ReadError, r"has \d+ of \d+ bytes", place="bag.db3.zstd"):
            read(path)
        return
    recording = read(path)
    n = recording.series[0].n
    assert 0 < n < 6000
    assert np.array_equal(rows(recording), truth.all[:n])
    assert "truncated" in [finding.code for finding in recording.findings]


def test_split_ros1_bags_are_joined(tmp_path: Path) -> None:
    """`rosbag record --split` writes `_0.bag`, `_1.bag`."""
    first = write_bag(tmp_path / "log_0.bag", imu_messages(part(0, 200), ros1=True))
    last = write_bag(tmp_path / "log_1.bag", imu_messages(part(200, 400), ros1=True), compression="bz2")
    recording = read(first, last)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert recording.series[0].clock.missing == 0
