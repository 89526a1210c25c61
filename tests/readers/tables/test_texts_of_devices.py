"""Texts of devices and serial monitors that are no tables: the error names them."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.readers import read
from tests.raising import raises

N = 900
RATE = 100.0
TIME = np.arange(N) / RATE
GYRO = np.round(1.5e-3 * np.random.default_rng(55201).standard_normal((N, 3)) + (2e-3, -3e-3, 1e-3), 6)
ACCEL = np.round(2e-2 * np.random.default_rng(55202).standard_normal((N, 3)) + (0.3, -0.2, 9.79), 4)
#: Sizes of counts of increments, in rad and m/s.
GYRO_COUNT = 1e-9
ACCEL_COUNT = 1e-8


def refused(path: Path, **options: Any) -> str:  # noqa: ANN401 - options of any kind
    with pytest.raises(ImucalError) as caught:
        read(path, **options)
    return str(caught.value)


def novatel_counts(heading: str) -> list[str]:
    """Return lines of counts, accelerometer first, as z, -y, x; the checksums are arbitrary."""
    gyro = np.round(GYRO / RATE / GYRO_COUNT).astype(int)
    accel = np.round(ACCEL / RATE / ACCEL_COUNT).astype(int)
    return [
        heading.format(s=361900 + TIME[k])
        + f",{accel[k, 2]},{-accel[k, 1]},{accel[k, 0]},{gyro[k, 2]},{-gyro[k, 1]},{gyro[k, 0]}*{k:08x}"
        for k in range(N)
    ]


def novatel_increments() -> list[str]:
    lines = []
    for k, numbers in enumerate(np.column_stack([GYRO, ACCEL]) / RATE):
        cells = ",".join(f"{number:.12f}" for number in numbers)
        lines.append(f"%CORRIMUSA,1581,{361900 + TIME[k]:.3f};1,{cells},0,0*{k:08x}")
    return lines


def arduino() -> list[str]:
    def clock(seconds: float) -> str:
        return f"15:33:{seconds:06.3f}"

    return [f"{clock(TIME[k])} -> " + ",".join(f"{x:.6f}" for x in (*ACCEL[k], *GYRO[k])) for k in range(N)]


def plotter() -> list[str]:
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    values = np.column_stack([ACCEL, GYRO])
    return [",".join(f"{name}:{x:.6f}" for name, x in zip(names, row, strict=True)) for row in values]


def adafruit() -> list[str]:
    found = []
    for accel, gyro in zip(ACCEL, GYRO, strict=True):
        found.append("Acceleration X: {:.6f}, Y: {:.6f}, Z: {:.6f} m/s^2".format(*accel))
        found.append("Rotation X: {:.6f}, Y: {:.6f}, Z: {:.6f} rad/s".format(*gyro))
        found += ["Temperature: 36.53 degC", ""]
    return found


#: Lines of a text -> its name in the error.
LOGS: dict[str, tuple[list[str], str]] = {
    "RAWIMUSXA": (
        novatel_counts("%RAWIMUSXA,1868,{s:.3f};00,41,1868,{s:.9f},00000077"),
        "a text log of NovAtel with counts of increments, accelerometer first, as z, -y, x",
    ),
    "RAWIMUSA": (
        novatel_counts("%RAWIMUSA,1868,{s:.3f};1868,{s:.9f},00000077"),
        "a text log of NovAtel with counts of increments, accelerometer first, as z, -y, x",
    ),
    "RAWIMUA": (
        novatel_counts("#RAWIMUA,COM1,0,77.5,FINESTEERING,1868,{s:.3f},00000020,dc4c,42;1868,{s:.9f},0077"),
        "a text log of NovAtel with counts of increments, accelerometer first, as z, -y, x",
    ),
    "CORRIMUSA": (
        novatel_increments(),
        "a text log of NovAtel with increments of angle and of velocity without gravity",
    ),
    "arduino": (arduino(), "the text of a serial monitor, with a time before an arrow; replace the arrow"),
    "plotter": (plotter(), "the text of a serial plotter, with a name before each number; write it as CSV"),
    "adafruit": (adafruit(), "the text of an example of Adafruit, with a line for each sensor; write it as"),
}


@pytest.mark.parametrize("name", LOGS)
def test_the_text_of_a_device_is_named(tmp_path: Path, name: str) -> None:
    lines, what = LOGS[name]
    path = tmp_path / "a log.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert f"{path}: it is {what}" in refused(path)


def test_a_comma_in_place_of_the_arrow_makes_a_table(tmp_path: Path) -> None:
    """As the error says."""
    path = tmp_path / "log.csv"
    text = "\n".join(LOGS["arduino"][0]).replace(" -> ", ",")
    path.write_text(text, encoding="utf-8")
    recording = read(path, columns="t=0,g=4:7,a=1:4", gyro_unit="rad/s")
    npt.assert_allclose(recording.series[0].samples, GYRO[:, 0], atol=1e-6)


def test_columns_of_the_unconverted_text_get_the_same_advice(tmp_path: Path) -> None:
    path = tmp_path / "log.asc"
    path.write_text("\n".join(LOGS["RAWIMUSXA"][0]), encoding="utf-8")
    message = refused(path, columns="t=5,g=12+11+10,a=9+8+7")
    assert "the table has no rows of its sensors; it is a text log of NovAtel" in message


def test_a_table_with_one_value_a_row_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "esf.csv"
    kinds = (14, 13, 5, 16, 17, 18)
    values = np.round(np.column_stack([GYRO * 1e6, ACCEL * 1e4])).astype(int)
    rows = [f"{k * 10},{kind},{values[k, i]}" for k in range(N) for i, kind in enumerate(kinds)]
    path.write_text("\n".join(["sTtag,dataType,dataField", *rows]), encoding="utf-8")
    message = refused(path, columns="gx=2@14,gy=2@13,gz=2@5")
    assert "write a table with one value a row as one with a row for each sample" in message


def test_a_folder_of_oxts_is_named(tmp_path: Path) -> None:
    """Its files, joined to one, are read with the columns and units of the error."""
    folder = tmp_path / "a drive"
    (folder / "data").mkdir(parents=True)
    (folder / "timestamps.txt").write_text("2011-09-26 13:02:25.0\n" * 200, encoding="utf-8")
    rows = []
    for k in range(200):
        numbers = np.concatenate([np.ones(11), ACCEL[k], ACCEL[k], GYRO[k], GYRO[k], np.ones(7)])
        rows.append(" ".join(f"{number:.6f}" for number in numbers) + "\n")
        (folder / "data" / f"{k:010d}.txt").write_text(rows[-1], encoding="utf-8")
    message = refused(folder)
    assert "it is a folder of KITTI's oxts, with a file for each sample" in message
    (columns,) = re.findall(r"columns (\S+?), the", message)
    (tmp_path / "log.txt").write_text("".join(rows), encoding="utf-8")
    options: dict[str, Any] = {"columns": columns, "gyro_unit": "rad/s", "accel_unit": "m/s^2"}
    recording = read(tmp_path / "log.txt", rate_hz=10.0, **options)
    npt.assert_allclose(recording.series[0].samples, GYRO[:200, 0], atol=1e-6)


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    text = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 132735\n"
    path.write_text(text, encoding="utf-8")
    with raises(ReadError, "a pointer of Git LFS", place="log.csv"):
        read(path)


def test_two_devices_in_one_table_are_listed(tmp_path: Path) -> None:
    """As DatCon names them; each choice is read."""
    path = tmp_path / "log.csv"
    axes = [f"IMU_ATTI({{}}):{kind}{axis}:{axis}" for kind in ("accel", "gyro") for axis in "XYZ"]
    header = ",".join(["time_s", *(name.format(device) for device in (0, 1) for name in axes)])
    values = np.column_stack([TIME, ACCEL, GYRO, ACCEL, 2 * GYRO])
    np.savetxt(path, values, delimiter=",", header=header, comments="", fmt="%.6f")
    with raises(ChoiceError, "2 sets of gyroscope columns", place="log.csv", argument="columns") as error:
        read(path)
    examples = re.findall(r"t=0,g=\d+:\d+,a=\d+:\d+", str(error.value))
    assert examples == ["t=0,g=4:7,a=1:4", "t=0,g=10:13,a=7:10"]
    for scale, example in zip((1, 2), examples, strict=True):
        found = read(path, columns=example, gyro_unit="rad/s").series[0].samples
        npt.assert_allclose(found, scale * GYRO[:, 0], atol=1e-6)


def test_columns_whose_names_are_numbers_are_named_by_a_range(tmp_path: Path) -> None:
    """GoPro's telemetry names only the first column of a vector."""
    path = tmp_path / "log.csv"
    header = '"cts","Accelerometer [m/s2]","1","2"'
    rows = np.column_stack([TIME * 1000, ACCEL])
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    message = refused(path, columns="a=1+2+3", time_unit="ms", time="cts")
    assert "a number that is a name comes first; give a range such as a=2:5" in message
    found = read(path, columns="t=0,a=1:4", time_unit="ms").series[0].samples
    npt.assert_allclose(found, ACCEL[:, 0], atol=1e-6)


def test_linear_accelerations_are_not_proposed_with_gyroscopes(tmp_path: Path) -> None:
    """RoNIN's groups have a dotted name."""
    header = "time_s," + ",".join(
        f"synced.{name}[{k}]" for name in ("gyro", "gyro_uncalib", "acce", "linacce") for k in range(3)
    )
    path = tmp_path / "log.csv"
    rows = np.column_stack([TIME, GYRO, GYRO, ACCEL, ACCEL - ACCEL.mean(axis=0)])
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    with pytest.raises(ChoiceError) as error:
        read(path)
    proposals = re.findall(r"t=0,g=\d+:\d+,a=\d+:\d+", str(error.value))
    assert proposals == ["t=0,g=1:4,a=7:10", "t=0,g=4:7,a=7:10"]


def test_names_in_a_list_have_no_marks(tmp_path: Path) -> None:
    """PSINS writes its names in a comment."""
    path = tmp_path / "log.imu"
    rows = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in np.column_stack([GYRO, ACCEL, TIME]))
    path.write_text(f"% [gx, gy, gz, ax, ay, az, t]\n{rows}\n", encoding="utf-8")
    recording = read(path, gyro_unit="rad/s")
    npt.assert_allclose(recording.series[2].samples, GYRO[:, 2], atol=1e-6)


@pytest.mark.parametrize("start", [638_000_000_000_000_000, 133_500_000_000_000_000, 98_765_432_100])
def test_ticks_of_100_ns_are_proposed_and_read(tmp_path: Path, start: int) -> None:
    """.NET, FILETIME and Windows' performance counter."""
    path = tmp_path / "log.csv"
    values = np.column_stack([GYRO, ACCEL])
    rows = [f"{start + k * 100_000}," + ",".join(f"{x:.6f}" for x in values[k]) for k in range(N)]
    path.write_text("\n".join(["timestamp,gx (rad/s),gy,gz,ax (m/s^2),ay,az", *rows]), encoding="utf-8")
    assert "100 Hz in 100ns" in refused(path)
    recording = read(path, time_unit="100ns")
    assert recording.series[0].rate_hz == pytest.approx(RATE, rel=1e-6)
