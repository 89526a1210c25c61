"""Several logs: parts of one recording are joined, unrelated logs are refused."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from imucal.errors import ArgumentError, ChoiceError
from imucal.readers import read
from imucal.readers.split import series_of
from imucal.recording import Recording
from tests.cli.run import run
from tests.raising import raises
from tests.readers.logs import Samples, imu_messages, samples, write_bag, write_db3, write_mcap

TRUTH = samples(900, seed=41)
EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)


def part(first: int, last: int, *, later_s: float = 0.0) -> Samples:
    """Return some of the samples, shifted by some seconds."""
    chosen, shift = slice(first, last), round(later_s * 1e9)
    return Samples(
        stamps=TRUTH.stamps[chosen] + shift,
        log=TRUTH.log[chosen] + shift,
        gyro=TRUTH.gyro[chosen],
        accel=TRUTH.accel[chosen],
    )


def table(path: Path, chosen: Samples, header: str = EUROC, *, seconds: bool = False) -> Path:
    """Write samples as a CSV with ns since 1970, or with `seconds` from the first sample."""
    lines = [header] if header else []
    for stamp, row in zip(chosen.stamps.tolist(), chosen.all.tolist(), strict=True):
        time = repr((stamp - int(TRUTH.stamps[0])) / 1e9) if seconds else str(stamp)
        lines.append(",".join([time, *map(repr, row)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def rows(recording: Recording) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the samples, shape (n, 6)."""
    return np.array([series.samples for series in recording.series]).T


def refusal(paths: Sequence[Path]) -> str:
    """Return the error message for logs, which lists them and explains what to do."""
    with pytest.raises(ChoiceError) as caught:
        read(*paths)
    message = str(caught.value)
    for path in paths:
        assert f"\n  {path.name}  " in message
    assert message.endswith("or state that they are parts of one recording")
    return message


@pytest.mark.parametrize("kind", ["mcap", "bag", "csv", "db3"])
def test_logs_of_simultaneous_units_are_refused(kind: str, tmp_path: Path) -> None:
    """Joining three units with overlapping stamps would triple the rate."""
    paths = []
    for i in range(3):
        chosen = part(300 * i, 300 * i + 300, later_s=-3.0 * i)
        if kind == "mcap":
            paths.append(write_mcap(tmp_path / f"unit{i}.mcap", imu_messages(chosen)))
        elif kind == "bag":
            paths.append(write_bag(tmp_path / f"unit{i}.bag", imu_messages(chosen, ros1=True)))
        elif kind == "db3":
            paths.append(write_db3(tmp_path / f"unit{i}", imu_messages(chosen)))
        else:
            paths.append(table(tmp_path / f"unit{i}.csv", chosen))
    message = refusal(paths)
    assert "unit0" in message
    assert "3 logs do not look like one recording: " in message
    assert "overlap in time by 3 s" in message
    joined = read(*paths, join=True)
    assert joined.series[0].rate_hz == pytest.approx(100)
    assert joined.series[0].n == 900
    (finding,) = [finding for finding in joined.findings if finding.code == "joined"]
    assert finding.level == "warning"
    assert "overlap in time by 3 s. They are joined in the given order" in finding.text


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_a_folder_of_unrelated_logs_is_refused(kind: str, tmp_path: Path) -> None:
    """Without a metadata.yaml a folder is not a bag; the error lists its logs."""
    folder = tmp_path / "bench"
    folder.mkdir()
    for i in range(2):
        chosen = part(300 * i, 300 * i + 300, later_s=100.0 * i)
        if kind == "mcap":
            write_mcap(folder / f"imu_{i}.mcap", imu_messages(chosen))
        elif kind == "bag":
            write_bag(folder / f"imu_{i}.bag", imu_messages(chosen, ros1=True))
        else:
            inner = write_db3(tmp_path / f"imu_{i}", imu_messages(chosen))
            next(inner.glob("*.db3")).rename(folder / f"imu_{i}.db3")
    with pytest.raises(ChoiceError) as caught:
        read(folder)
    assert f"imu_1.{kind} starts 100 s after the end of imu_0.{kind}" in str(caught.value)
    joined = read(folder, join=True)
    assert np.array_equal(rows(joined), TRUTH.all[:600])
    (gap,) = joined.series[0].clock.gaps
    assert gap.missing == 10_000


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (("morning.mcap", "evening.mcap"), "their names are not a series: they differ in more than a number"),
        (("unit1.mcap", "unit2.mcap"), "the numbers in their names are of devices, not of parts"),
        (("rest_imu1.mcap", "rest_imu2.mcap"), "the numbers in their names are of devices, not of parts"),
        (("sn_0017.mcap", "sn_0018.mcap"), "the numbers in their names are of devices, not of parts"),
    ],
)
def test_consecutive_logs_are_refused_if_their_names_are_no_series(
    names: tuple[str, str], why: str, tmp_path: Path
) -> None:
    """Consecutive times are no proof: a bench that logs one unit after another leaves no pause either."""
    paths = [
        write_mcap(tmp_path / name, imu_messages(part(300 * i, 300 * i + 300)))
        for i, name in enumerate(names)
    ]
    assert f"recording: {why}; found" in refusal(paths)
    assert np.array_equal(rows(read(*paths, join=True)), TRUTH.all[:600])


@pytest.mark.parametrize(
    "names",
    [
        ("bag_0.mcap", "bag_1.mcap", "bag_2.mcap"),
        ("imu_0.mcap", "imu_1.mcap", "imu_2.mcap"),
        ("2024-01-31-23-59-58_0.bag", "2024-02-01-00-00-01_1.bag", "2024-02-01-00-00-04_2.bag"),
        ("log_0001.csv", "log_0002.csv", "log_0003.csv"),
        ("imu.csv.2", "imu.csv.1", "imu.csv"),
        ("20240131T235958.csv", "20240201T000001.csv", "20240201T000004.csv"),
        ("rest_9.csv", "rest_10.csv", "rest_11.csv"),
    ],
)
def test_splits_of_one_recording_are_joined(names: tuple[str, ...], tmp_path: Path) -> None:
    """Splits of rosbag2 and rosbag and rotated tables lose no sample. A finding reports the join."""
    paths = []
    for i, name in enumerate(names):
        chosen, path = part(300 * i, 300 * i + 300), tmp_path / name
        if ".csv" in name:
            table(path, chosen)
        elif name.endswith(".bag"):
            write_bag(path, imu_messages(chosen, ros1=True))
        else:
            write_mcap(path, imu_messages(chosen))
        paths.append(path)
    recording = read(*sorted(paths))
    assert np.array_equal(rows(recording), TRUTH.all)
    clock = recording.series[0].clock
    assert (len(clock.segments), clock.missing) == (1, 0)
    assert clock.rate_hz == pytest.approx(100)
    assert len({id(series.clock) for series in recording.series}) == 1
    (finding,) = [finding for finding in recording.findings if finding.code == "joined"]
    assert (finding.level, finding.text) == (
        "info", f"3 logs are joined as one recording: {', '.join(names)}."
    )  # fmt: skip


def test_missing_samples_between_parts_are_a_gap(tmp_path: Path) -> None:
    """The gap is at the stamp of the first sample after it, for any number of parts."""
    pieces = [(0, 200), (210, 300), (300, 450), (457, 900)]
    paths = [write_mcap(tmp_path / f"log_{i}.mcap", imu_messages(part(*p))) for i, p in enumerate(pieces)]
    clock = read(*paths).series[0].clock
    assert [(round(gap.start_s * 100), gap.missing) for gap in clock.gaps] == [(200, 10), (450, 7)]
    assert clock.duration_s == pytest.approx(9.0)


def test_different_topics_frames_columns_and_units_are_refused(tmp_path: Path) -> None:
    """The error shows the values of each log."""
    first = write_mcap(tmp_path / "a_0.mcap", imu_messages(part(0, 300)))
    topic = write_mcap(tmp_path / "a_1.mcap", imu_messages(part(300, 600), topic="/imu2/data"))
    assert "their topics differ (/imu/data and /imu2/data)" in refusal([first, topic])
    frame = write_mcap(tmp_path / "a_2.mcap", imu_messages(part(300, 600), frames=("imu_b",)))
    message = refusal([first, frame])
    assert "their frames differ (imu and imu_b)" in message
    assert "/imu/data, frame imu_b" in message
    head = "t,gx,gy,gz,ax,ay,az"
    plain = table(tmp_path / "b_0.csv", part(0, 300), head, seconds=True)
    other = table(tmp_path / "b_1.csv", part(300, 600), "t,wx,wy,wz,ax,ay,az", seconds=True)
    names = "gx, gy, gz, ax, ay, az and wx, wy, wz, ax, ay, az"
    assert f"their columns differ ({names})" in refusal([plain, other])
    same = table(tmp_path / "b_2.csv", part(300, 600), head, seconds=True)
    assert read(plain, same).series[0].n == 600


def test_parts_join_if_the_sensor_moves_in_one(tmp_path: Path) -> None:
    """The sensor turns in one part, so its statistics differ, but gravity is the same."""
    chosen = part(300, 600)
    turn = 0.5 * np.sin(np.arange(300) / 20)[:, None] * [1.0, 0.2, 0.1]
    moved = Samples(stamps=chosen.stamps, log=chosen.log, gyro=chosen.gyro + turn, accel=chosen.accel + turn)
    paths = [
        write_mcap(tmp_path / "a_0.mcap", imu_messages(part(0, 300))),
        write_mcap(tmp_path / "a_1.mcap", imu_messages(moved)),
    ]
    assert read(*paths).series[0].n == 600


def test_times_that_restart_are_refused(tmp_path: Path) -> None:
    """Each table starts at zero, so their order is unknown."""
    paths = []
    for i in range(2):
        path = tmp_path / f"log_{i}.csv"
        table(path, part(300 * i, 300 * i + 300, later_s=-3.0 * i), "t,gx,gy,gz,ax,ay,az", seconds=True)
        paths.append(path)
    assert "log_0.csv and log_1.csv overlap in time by 3 s" in refusal(paths)
    joined = read(*paths, join=True)
    assert np.array_equal(rows(joined), TRUTH.all[:600])
    assert len(joined.series[0].clock.segments) == 1


def test_logs_without_stamps_are_refused(tmp_path: Path) -> None:
    """Nothing shows that one log continues the other."""
    paths = []
    for i in range(2):
        chosen = part(300 * i, 300 * i + 300)
        lines = ["gx,gy,gz,ax,ay,az", *(",".join(map(repr, row)) for row in chosen.all.tolist())]
        path = tmp_path / f"log_{i}.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        paths.append(path)
    with raises(ChoiceError, "no time stamps of the recording", place="log_0.csv", argument="join"):
        read(*paths, rate_hz=100.0, gyro_unit="rad/s")
    joined = read(*paths, rate_hz=100.0, gyro_unit="rad/s", join=True)
    assert np.array_equal(rows(joined), TRUTH.all[:600])
    assert joined.series[0].clock.missing == 0


def test_a_gyroscope_and_an_accelerometer_of_different_times_are_refused(tmp_path: Path) -> None:
    """The files were recorded an hour apart."""
    stamps = TRUTH.stamps.tolist()
    for name, values, later in (("gyro", TRUTH.gyro, 0), ("accel", TRUTH.accel, 3_600_000_000_000)):
        unit = "rad/s" if name == "gyro" else "m/s^2"
        lines = [f"time_ns,{name}_x ({unit}),{name}_y ({unit}),{name}_z ({unit})"]
        both = zip(stamps, values.tolist(), strict=True)
        lines += [f"{stamp + later},{','.join(map(repr, row))}" for stamp, row in both]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    paths = [tmp_path / "gyro.csv", tmp_path / "accel.csv"]
    with raises(ChoiceError, "not recorded at the same time", place="gyro.csv"):
        read(*paths)
    assert read(paths[0]).series[0].n == 900


@pytest.mark.parametrize(
    ("name", "series"),
    [
        ("bag_12.db3.zstd", "bag"),
        ("imu.csv.1", "imu"),
        ("imu.csv", "imu"),
        ("2024-01-02 log.txt", " log"),
        ("run.b_1.csv", "run.b"),
    ],
)
def test_the_series_is_the_file_name_without_numbers_and_extensions(name: str, series: str) -> None:
    assert series_of(name) == series


def test_the_advice_in_the_message_works(tmp_path: Path) -> None:
    """The user can add --join or give one log at a time, in all commands that read logs."""
    for i in range(2):
        write_mcap(tmp_path / f"unit{i}.mcap", imu_messages(part(450 * i, 450 * i + 450)))
    for command in ("adev", "fit"):
        done = run(command, "unit0.mcap", "unit1.mcap", cwd=tmp_path)
        assert done.returncode == 3
        assert "unit0.mcap: 2 logs do not look like one recording" in done.stderr
        assert done.stderr.endswith("or state that they are parts of one recording\nUse --join.\n")
    assert run("adev", "unit0.mcap", "unit1.mcap", "--join", "-q", cwd=tmp_path).returncode == 0
    assert run("adev", "unit0.mcap", "-q", cwd=tmp_path).returncode == 0
    done = run(
        "fit", "unit0.mcap", "unit1.mcap", "--join", "--json", "--no-report", "--model", "N", cwd=tmp_path
    )
    assert done.returncode == 0
    assert '"join": true' in done.stdout


def test_info_describes_the_logs_of_a_folder_one_by_one(tmp_path: Path) -> None:
    """The logs must not be described as one log with twice the rate."""
    folder = tmp_path / "bench"
    folder.mkdir()
    for i in range(2):
        write_mcap(folder / f"unit{i}.mcap", imu_messages(part(450 * i, 450 * i + 450, later_s=-4.5 * i)))
    done = run("info", "bench", cwd=tmp_path)
    assert done.stdout.count("/imu/data  sensor_msgs/msg/Imu") == 2
    assert "200 Hz" not in done.stdout
    assert "2 logs without a metadata.yaml" in done.stdout


def test_standard_input_is_refused_among_several_logs(tmp_path: Path) -> None:
    """Several logs are opened twice, and standard input can be read only once."""
    path = tmp_path / "log.csv"
    path.write_text("time_s,gx,gy,gz\n" + "0,1,2,3\n" * 9, encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"standard input .-. is one of 2 logs; expected it alone"):
        read(path, "-")
