"""Rare problems: long names, wide tables, memory limits, accelerations without gravity."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy.io

from imucal.errors import ReadError
from imucal.readers import describe, read
from imucal.readers.scales import infer_accel_unit
from imucal.screening import screen_units
from tests.readers.tables.texts import N, lines, truth, xyz
from tests.readers.ulog.test_ulog import two_sensors

SI = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"


@pytest.mark.parametrize("action", [read, describe])
def test_a_file_name_that_is_too_long_is_refused(action: object, tmp_path: Path) -> None:
    path = tmp_path / ("a" * 300 + ".csv")
    with pytest.raises(ReadError, match="File name too long"):
        action(path)  # type: ignore[operator]


def test_the_command_for_a_table_that_is_too_wide_works(tmp_path: Path) -> None:
    """The command in the error writes a file with the necessary columns, which is read."""
    path, filling = tmp_path / "wide log.csv", ",0" * 100_000
    rows = lines(
        f"t_s,{SI}", [i / 100 for i in range(N)], *xyz(truth().gyro), *xyz(truth().accel)
    ).splitlines()
    path.write_text("\n".join(row + filling for row in rows[:60]) + "\n", encoding="utf-8")
    with pytest.raises(ReadError) as caught:
        read(path)
    assert re.search(r"or at least \d{6} columns; expected the few columns of an IMU", str(caught.value))
    shell, command = shutil.which("bash") or "sh", re.search(r"cut .*", str(caught.value))
    assert command is not None
    subprocess.run([shell, "-c", command[0]], cwd=tmp_path, check=True)  # noqa: S603 - what the message says
    recording = read(tmp_path / "imu.csv")
    np.testing.assert_array_equal(recording.axis("gyroscope", "x").samples, truth().gyro[:59, 0])


@pytest.mark.skipif(sys.platform == "win32", reason="limits of memory are of Unix")
def test_a_hard_memory_limit_is_respected(tmp_path: Path) -> None:
    """Batch schedulers set `ulimit -v`; the child process for other packages must still start."""
    columns = {"t_s": np.arange(N) / 100}
    for sensor in ("gyro", "accel"):
        columns |= {f"{sensor}_{axis}": truth().accel[:, i] for i, axis in enumerate("xyz")}
    scipy.io.savemat(tmp_path / "log.mat", columns)
    pl.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    two_sensors(tmp_path / "log.ulg")
    script = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3_500_000_000, 3_500_000_000))\n"
        "from imucal.readers import read\n"
        "for log in sys.argv[1:]: print(len(read(log, gyro_unit='rad/s', accel_unit='m/s^2').series))\n"
    )
    logs = [str(tmp_path / f"log.{ending}") for ending in ("mat", "parquet", "ulg")]
    done = subprocess.run(  # noqa: S603 - this interpreter
        [sys.executable, "-c", script, *logs],
        capture_output=True,
        text=True,
        check=False,
        env={"OPENBLAS_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1"},
    )
    assert (done.stdout, done.stderr) == ("6\n6\n6\n", "")


def carried(mean: float) -> np.ndarray:
    """Return accelerations with median size 1 and a given mean, as of a phone in a walker's hand."""
    rng = np.random.default_rng(8)
    rows = rng.normal(size=(5000, 3)) * np.sqrt((1 - mean**2) / 3) + np.array([0, 0, mean])
    return np.asarray(rows / np.median(np.linalg.norm(rows, axis=1)))


def test_accelerations_without_gravity_are_not_in_g() -> None:
    """The size equals gravity in g, but the mean does not; a carried phone has the right mean."""
    assert infer_accel_unit(carried(0.9)).unit == "g"
    found = infer_accel_unit(carried(0.1))
    assert found.unit is None
    assert re.search(
        r"is not gravity in m/s\^2, g or mg, and the mean vector has the length 0\.1\d*",
        found.reason,
    )


def test_linear_acceleration_is_reported_if_it_was_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    linear = truth().accel - truth().accel.mean(axis=0)
    header = (
        f"t_s,{SI}".replace("ax", "linear_acc_x").replace("ay", "linear_acc_y").replace("az", "linear_acc_z")
    )
    path.write_text(lines(header, [i / 100 for i in range(N)], *xyz(truth().gyro), *xyz(linear)))
    assert [finding.code for finding in screen_units(read(path))] == ["no-gravity"]
    path.write_text(lines(f"t_s,{SI}", [i / 100 for i in range(N)], *xyz(truth().gyro), *xyz(truth().accel)))
    assert screen_units(read(path)) == ()
