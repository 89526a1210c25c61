"""``imucal apply``: output and exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest

import imucal
from tests.cli.run import SAMPLE_LOGS, run

POSES = str(SAMPLE_LOGS / "poses.mcap")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the calibration of a log."""
    folder = tmp_path_factory.mktemp("apply")
    assert run("calibrate", POSES, "-o", "cal", "--no-html", "-q", cwd=folder).returncode == 0
    return folder


def test_a_log_is_corrected(folder: Path) -> None:
    """The corrected log calibrates to 0 within its intervals; messages are on the other stream."""
    done = run("apply", "cal", POSES, "-o", "corrected.mcap", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "Corrected 4400 samples of /imu/data_raw; everything else is unchanged.\n"
    assert done.stderr.endswith("Wrote corrected.mcap\n")
    again = imucal.calibrate(imucal.read(folder / "corrected.mcap"))
    for sensor in (again.accel, again.gyro):
        assert sensor is not None
        for name, parameter in sensor.parameters.items():
            if parameter.low is not None and parameter.high is not None:
                assert parameter.low <= 0 <= parameter.high, name
    ends = run("apply", "cal", "corrected.mcap", "-o", "twice.mcap", cwd=folder)
    assert (ends.returncode, "it is already corrected; give the original log" in ends.stderr) == (4, True)
    assert not (folder / "twice.mcap").exists()


def test_json_lists_what_was_corrected(folder: Path) -> None:
    done = run("apply", "cal/calibration.json", POSES, "-o", "json.mcap", "--json", "-q", cwd=folder)
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/apply/1"
    assert document["corrected"] == ["/imu/data_raw"]
    assert (document["samples"], document["written"], done.stderr) == (4400, "json.mcap", "")


def test_the_gravity_of_another_session_is_right(tmp_path: Path) -> None:
    """|f| = g at the rests of another session of the same unit."""
    for name, seed in (("first", "61"), ("second", "62")):
        made = run(
            *("simulate", "N=1e-4", "--accel", "N=1e-3", "--rests", "18", "--seed", seed),
            *("-o", f"{name}.mcap"),
            cwd=tmp_path,
        )
        assert made.returncode == 0, made.stderr
    run("calibrate", "first.mcap", "-o", "cal", "--no-html", "-q", "--gravity", "9.80665", cwd=tmp_path)
    run("apply", "cal", "first.mcap", "-o", "corrected.mcap", "-q", cwd=tmp_path)
    recording = imucal.read(tmp_path / "corrected.mcap")
    force = np.column_stack([one.samples for one in recording.series[3:]])
    # The first rest lasts five seconds or more.
    length = np.linalg.norm(force[:200].mean(axis=0))
    assert length == pytest.approx(9.80665, abs=2e-3)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("nothing", POSES, "-o", "x"), 3, "nothing: can't be read: No such file or directory"),
        (("cal", "nothing.mcap", "-o", "x"), 3, "nothing.mcap: can't be opened: No such file"),
        (("cal", POSES), 2, "Missing option '-o'"),
        (("cal", POSES, "-o", "cal"), 5, "cal: exists already; choose another name"),
        (("cal", POSES, "-o", "no/such/folder/x.mcap"), 5, "can't be written"),
        (("cal", str(SAMPLE_LOGS / "truth.json"), "-o", "x"), 3, "truth.json"),
    ],
)
def test_slips(words: tuple[str, ...], code: int, text: str, folder: Path) -> None:
    done = run("apply", *words, cwd=folder)
    assert (done.returncode, text in " ".join(done.stderr.split())) == (code, True), done.stderr
    assert not (folder / "x").exists()
