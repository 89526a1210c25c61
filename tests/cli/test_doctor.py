"""``imucal doctor``: the table, JSON, JUnit XML and exit codes."""

import errno
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

import imucal
from imucal.errors import ChoiceError
from imucal.report import out_folder
from tests.cli.run import run
from tests.raising import raises

ACTIONS = Path(__file__).parents[2] / ".github" / "actions"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a log of turns, and of one whose gyroscope z has the wrong sign."""
    folder = tmp_path_factory.mktemp("drive")
    command = ("simulate", "N=1e-4", "--accel", "N=1e-3", "--rests", "8", "--rest", "4s", "--seed", "3")
    assert run(*command, "--rate", "100", "-o", "drive.csv", cwd=folder).returncode == 0
    head, *rows = (folder / "drive.csv").read_text(encoding="utf-8").splitlines()
    place = next(index for index, name in enumerate(head.split(",")) if name == "w_RS_S_z [rad s^-1]")
    turned = []
    for row in rows:
        cells = row.split(",")
        cells[place] = str(-float(cells[place]))
        turned.append(",".join(cells))
    (folder / "yaw.csv").write_text("\n".join([head, *turned]) + "\n", encoding="utf-8")
    return folder


def test_a_good_stream_passes(drive: Path) -> None:
    """Questions that the log can't answer do not count."""
    done = run("doctor", "drive.csv", "-q", cwd=drive)
    assert (done.returncode, done.stderr) == (0, "")
    verdict, *rows = done.stdout.splitlines()
    assert verdict == "Fit for a filter, as far as this log tells; it leaves 5 of 21 questions open"
    assert any(row.startswith("pass  axes and signs: ") for row in rows)
    assert any(row.startswith("?     temperature: ") for row in rows)
    assert max(map(len, rows)) <= 80


def test_a_wrong_sign_is_named_and_ends_with_1(drive: Path) -> None:
    """JSON and JUnit XML contain the same row."""
    done = run("doctor", "yaw.csv", "--json", "-q", "--junit", "doctor.xml", cwd=drive)
    assert done.returncode == 1
    document = json.loads(done.stdout)
    assert (document["schema"], document["status"]) == ("imucal/doctor/1", "fail")
    (row,) = [row for row in document["rows"] if row["status"] == "fail"]
    assert row["code"] == "axes"
    assert "-z" in row["found"]
    suite = ET.parse(drive / "doctor.xml").getroot()  # noqa: S314 - our own file
    (failure,) = suite.iter("failure")
    assert row["found"] in str(failure.text)


def test_the_axis_that_is_up_may_be_expected(drive: Path) -> None:
    """An unknown one is refused with the choices."""
    assert run("doctor", "drive.csv", "--expect", "z-up", "-q", cwd=drive).returncode == 0
    done = run("doctor", "drive.csv", "--expect", "z-down", "-q", cwd=drive)
    assert done.returncode == 1
    assert done.stdout.splitlines()[0] == "Not fit for a filter: axis that is up"
    with raises(ChoiceError, argument="expect"):
        imucal.doctor(drive / "drive.csv", expect="up")


def test_a_narrow_terminal_and_annotations(drive: Path) -> None:
    """Annotations of GitHub name the failed row."""
    done = run("doctor", "yaw.csv", "--github", "-q", cwd=drive, COLUMNS="40")
    table = [line for line in done.stdout.splitlines() if not line.startswith("::")]
    assert max(map(len, table)) <= 40
    assert "::error title=imucal doctor%3A axes and signs::" in done.stdout


def test_a_warning_is_refused_if_strict(drive: Path) -> None:
    """A lost sample is a warning; the table is printed in any case."""
    lines = (drive / "drive.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (drive / "lost.csv").write_text("".join(lines[:500] + lines[501:]), encoding="utf-8")
    done = run("doctor", "lost.csv", "-q", cwd=drive)
    assert done.returncode == 0
    assert done.stdout.splitlines()[0] == "Check first: gaps"
    strict = run("doctor", "lost.csv", "-q", "--strict", cwd=drive)
    assert (strict.returncode, strict.stdout) == (4, done.stdout)
    assert strict.stderr == "Error: lost.csv: gaps: --strict allows no warning\n"


def test_a_folder_has_a_page_and_the_same_json(drive: Path, tmp_path: Path) -> None:
    """Without -o nothing is written; a good log has no picture."""
    before = sorted(path.name for path in drive.iterdir())
    alone = run("doctor", "yaw.csv", "--json", "-q", cwd=drive)
    assert sorted(path.name for path in drive.iterdir()) == before
    done = run("doctor", "yaw.csv", "--json", "-o", str(tmp_path / "out"), cwd=drive)
    assert (done.returncode, done.stdout) == (1, alone.stdout)
    assert done.stderr.endswith(f"Wrote {tmp_path / 'out'}: doctor.json, doctor.html, 1 picture\n")
    assert json.loads((tmp_path / "out" / "doctor.json").read_bytes()) == json.loads(alone.stdout)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "doctor-axes.png",
        "doctor.html",
        "doctor.json",
    ]
    done = run("doctor", "drive.csv", "-o", str(tmp_path / "out"), cwd=drive)
    assert done.returncode == 0
    assert done.stderr.endswith(": doctor.json, doctor.html\n")
    assert not (tmp_path / "out" / "doctor-axes.png").exists()


def test_the_page_shows_the_option_of_a_fix(drive: Path, tmp_path: Path) -> None:
    """The option is the one of the command line."""
    run("doctor", "drive.csv", "--gyro-unit", "deg/s", "-o", str(tmp_path / "out"), "-q", cwd=drive)
    assert "<code>--gyro-unit rad/s</code>" in (tmp_path / "out" / "doctor.html").read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_written_ends_with_5(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A foreign folder and a file are refused before the log is read; a full disk changes nothing."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine", encoding="utf-8")
    for path in ("mine", "mine/notes.txt"):
        done = run("doctor", "nothing.csv", "-o", str(tmp_path / path), cwd=drive)
        assert (done.returncode, done.stdout) == (5, "")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(out_folder, "sync_folder", full)
    done = run("doctor", "yaw.csv", "-q", "-o", str(tmp_path / "out"), cwd=drive)
    assert done.returncode == 5
    assert "free some space" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_action_of_github_runs(drive: Path, tmp_path: Path) -> None:
    """The last step with its inputs in the environment, and all inputs have a description."""
    action = yaml.safe_load((ACTIONS / "doctor" / "action.yml").read_text(encoding="utf-8"))
    assert all(entry["description"] for entry in action["inputs"].values())
    step = action["runs"]["steps"][-1]
    assert set(step["env"]) == {name.upper() for name in action["inputs"]}
    for expect, code in (("", 0), ("z-down", 1)):
        values = {"LOG": str(drive / "drive.csv"), "OUT": str(tmp_path / "out"), "EXPECT": expect}
        command = f'imucal() {{ {shlex.quote(sys.executable)} -m imucal "$@"; }}; {step["run"]}'
        done = subprocess.run(  # noqa: S603 - our own command
            ["/bin/bash", "-c", command],
            cwd=tmp_path,
            env=os.environ | values,
            capture_output=True,
            check=False,
            timeout=60,
        )
        assert done.returncode == code, done.stderr
        assert (tmp_path / "out" / "doctor.html").exists()
        assert (tmp_path / "out.xml").exists()


def test_a_log_of_few_samples_passes_no_check_of_them(drive: Path) -> None:
    """It says how much it leaves open."""
    done = run("doctor", "drive.csv", "--take", "1s", "--json", "-q", cwd=drive)
    document = json.loads(done.stdout)
    states = {row["code"]: row["status"] for row in document["rows"]}
    assert {states[code] for code in ("stuck", "held-samples", "interpolated-samples", "spikes")} == {
        "unknown"
    }
    assert "questions open" in document["sentence"]
