"""``imucal adev``: curves on standard output."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

import imucal
from imucal.allan import spectrum
from tests.cli.run import SAMPLE_LOGS, run

MEMS = str(SAMPLE_LOGS / "consumer_mems.mcap")
GAPS = str(SAMPLE_LOGS / "with_gaps.csv")
HEADER = "axis,tau,m,adev,low,high,edf"


def _table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_prints_every_axis_as_csv(tmp_path: Path) -> None:
    """The output is a header and the library's curves with nine digits; notes are on standard error."""
    done = run("adev", MEMS, cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.splitlines()[0] == HEADER
    rows = _table(done.stdout)
    recording = imucal.read(MEMS)
    assert list(dict.fromkeys(row["axis"] for row in rows)) == [s.name for s in recording.series]
    curve = imucal.allan_curve(recording.axis("gyroscope", "x"))
    mine = [row for row in rows if row["axis"] == "gyro_x"]
    npt.assert_array_equal([int(row["m"]) for row in mine], curve.m)
    low, high = curve.confidence_interval(0.95)
    for column, values in {
        "tau": curve.tau,
        "adev": curve.adev,
        "low": low,
        "high": high,
        "edf": curve.edf,
    }.items():
        npt.assert_allclose([float(row[column]) for row in mine], values, rtol=1e-5)
    assert "Read consumer_mems.mcap (mcap): gyro xyz, accel xyz: " in done.stderr
    assert not list(tmp_path.iterdir())


def test_quiet_leaves_standard_error_empty(tmp_path: Path) -> None:
    """Results only."""
    done = run("adev", MEMS, "-q", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


def test_prints_json_with_the_spectrum(tmp_path: Path) -> None:
    """SI, no NaN, the curve and the two-sided psd of every axis."""
    done = run("adev", GAPS, "--json", "-q", "--level", "0.68", cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/adev/1"
    assert document["level"] == 0.68
    axis = document["axes"][0]
    assert (axis["name"], axis["unit"], axis["computed"]) == ("gyro_x", "rad/s", "windows")
    series = imucal.read(GAPS).axis("gyroscope", "x")
    npt.assert_allclose(axis["curve"]["adev"], imucal.allan_curve(series).adev)
    assert axis["spectrum"]["unit"] == "(rad/s)^2/Hz"
    assert axis["spectrum"]["sided"] == "two"
    npt.assert_allclose(axis["spectrum"]["psd"], spectrum(series).psd)


def test_a_set_of_times_is_an_option(tmp_path: Path) -> None:
    """The values are equal to those of the library."""
    done = run("adev", MEMS, "-q", "--taus", "decade:3", cwd=tmp_path)
    curve = imucal.allan_curve(imucal.read(MEMS).axis("gyroscope", "x"), taus="decade:3")
    mine = [row for row in _table(done.stdout) if row["axis"] == "gyro_x"]
    npt.assert_allclose([float(row["adev"]) for row in mine], curve.adev, rtol=1e-8)
    npt.assert_allclose([float(row["edf"]) for row in mine], curve.edf, rtol=1e-5)


def test_a_list_of_times_has_units(tmp_path: Path) -> None:
    """Seconds, or a number with its unit; each rounds to whole samples."""
    done = run("adev", MEMS, "-q", "--taus", "0.1, 1s,1min", cwd=tmp_path)
    taus = [float(row["tau"]) for row in _table(done.stdout) if row["axis"] == "accel_z"]
    npt.assert_allclose(taus, [0.1, 1.0, 60.0])


@pytest.mark.parametrize("text", ["octaves", "-1", "1,,2"])
def test_refuses_times_that_are_neither(text: str, tmp_path: Path) -> None:
    """The exit code is 2, and the message lists valid values."""
    done = run("adev", MEMS, f"--taus={text}", cwd=tmp_path)
    assert done.returncode == 2
    expected = "is neither octave, decade, decade:20 or all, nor a list of times such as 0.1,1,10min"
    assert f"Invalid value for '--taus': {text!r} {expected}" in done.stderr


def test_a_time_out_of_reach_is_one_message(tmp_path: Path) -> None:
    """Exit code 4, nothing on standard output."""
    done = run("adev", MEMS, "-q", "--taus", "100d", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert done.stderr == (
        "Error: gyro_x: the averaging time 8.64e+06 s is out of reach: the samples support 0.02 s to "
        "360 s; leave it out or record longer\n"
    )


def test_one_bad_axis_does_not_hide_the_others(tmp_path: Path) -> None:
    """The other axes are printed; a message and the exit code report the bad one."""
    rng = np.random.default_rng(0)
    lines = ["t,gx,gy,gz"]
    for i in range(400):
        x, y = rng.standard_normal(2)
        lines.append(f"{i / 100},{x:.6f},{y:.6f},nan")
    log = tmp_path / "log.csv"
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = run("adev", "log.csv", "-q", "--gyro-unit", "rad/s", cwd=tmp_path)
    assert done.returncode == 4
    assert {row["axis"] for row in _table(done.stdout)} == {"gyro_x", "gyro_y"}
    assert done.stderr == (
        "Error: log.csv: not noise: no result on gyro_z; 2 of 3 axes are stationary noise; "
        "the curves were printed; record again at rest, or force it\nUse --force.\n"
    )
    said = run("adev", "log.csv", "--gyro-unit", "rad/s", "--force", cwd=tmp_path)
    assert (said.returncode, said.stdout) == (0, done.stdout)
    assert "error [no-result] gyro_z: No usable samples among 400: all are NaN," in said.stderr


def test_a_missing_log_is_exit_code_3(tmp_path: Path) -> None:
    """The reader's message, no traceback."""
    done = run("adev", "absent.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert "absent.mcap" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_shows_examples(tmp_path: Path) -> None:
    """A user learns the command from its help."""
    done = run("adev", "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "imucal adev log.mcap > curves.csv" in done.stdout


def test_warnings_of_reading_are_printed_and_end_a_strict_run(tmp_path: Path) -> None:
    """The curves are printed all the same; the code is 4."""
    log = str(SAMPLE_LOGS / "with_gaps.csv")
    done = run("adev", log, cwd=tmp_path)
    assert done.returncode == 0
    assert "warning [gaps]: 114 samples" in done.stderr
    strict = run("adev", log, "--strict", "-q", cwd=tmp_path)
    assert (strict.returncode, strict.stdout, strict.stderr) == (
        *(4, done.stdout),
        f"Error: {log}: gaps found; --strict allows no warning\n",
    )
