"""Data that are not noise at rest: exit code 4, no export, one line with --quiet, a finding."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from imucal.arrays import FloatArray
from tests.cli.run import run

pytestmark = pytest.mark.usefixtures("pictures_are_blank")

RATE, N = 50.0, 1000
AXES = ("gx", "gy", "gz", "ax", "ay", "az")
#: As short a way to a result as there is.
QUICK = ("--model", "N", "--no-report")


def moved(rows: FloatArray) -> None:
    """Put it down after 1 s."""
    rows[:50, 1:] += np.sin(np.arange(50) / 8)[:, None]


def knocked(rows: FloatArray) -> None:
    """Knock on the table."""
    rows[500:520, 1:4] *= 6


def swapped(rows: FloatArray) -> None:
    """Take one sensor for the other."""
    rows[:, 1:] = rows[:, [4, 5, 6, 1, 2, 3]]


def dead(rows: FloatArray) -> None:
    """Leave an axis unfilled."""
    rows[:, 2] = 0


def absurd(rows: FloatArray) -> None:
    """Write stamps in ms below a header with s."""
    rows[:, 0] *= 1000


def fine(rows: FloatArray) -> None:
    """Change nothing."""


def write(path: Path, change: Callable[[FloatArray], None], axes: Sequence[str] = AXES) -> None:
    """Write a log of an IMU at rest, changed, with some of its axes."""
    rng = np.random.default_rng(11)
    rows = rng.standard_normal((N, 7)) * [0, 1e-3, 1e-3, 1e-3, 2e-2, 2e-2, 2e-2]
    rows[:, 0] = np.arange(N) / RATE
    rows[:, 6] += 9.81
    change(rows)
    head = ",".join(["t [s]", *(f"{axis} [{'rad/s' if axis[0] == 'g' else 'm/s^2'}]" for axis in axes)])
    kept = rows[:, [0, *(1 + AXES.index(axis) for axis in axes)]]
    np.savetxt(path, kept, delimiter=",", fmt="%.9g", header=head, comments="")


WRONG = [
    (moved, ("gx",), "the IMU was moved; do not use these numbers"),
    (swapped, AXES, "gyroscope and accelerometer are swapped; do not use these numbers"),
    (dead, ("gx", "gy"), "no (data|result) on gyro_y; 1 of 2 axes are stationary noise"),
    (absurd, ("gx",), "the sampling rate is absurd; do not use these numbers"),
]


@pytest.mark.parametrize(("change", "axes", "said"), WRONG, ids=[change.__name__ for change, *_ in WRONG])
def test_fit_and_adev_end_with_code_4_and_one_sentence(
    change: Callable[[FloatArray], None], axes: Sequence[str], said: str, tmp_path: Path
) -> None:
    """Both print their results and write nothing here; --force takes the log as it is."""
    write(tmp_path / "log.csv", change, axes)
    unit = ("--time-unit", "s") if change is absurd else ()
    for command in (("fit", "log.csv", *QUICK), ("adev", "log.csv")):
        done = run(*command, *unit, "-q", cwd=tmp_path)
        assert done.returncode == 4
        again = r"record again at rest, or force it\nUse --force\."
        check = r"(, or check the stream: type 'imucal doctor' in place of 'imucal fit')?"
        advice = rf"({again}|fit the quiet part with --skip [\d.]+s --take [\d.]+s{check})"
        ended = f"(nothing was written|the curves were printed); {advice}\n"
        assert re.fullmatch(f"Error: log.csv: not noise: {said}(, N to .*)?; {ended}", done.stderr)
        assert done.stdout
    forced = run("adev", "log.csv", *unit, "-q", "--force", cwd=tmp_path)
    assert (forced.returncode, forced.stderr, forced.stdout) == (0, "", done.stdout)
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_a_log_that_is_not_noise_is_not_exported(tmp_path: Path) -> None:
    """One line, and no file; --force writes it."""
    write(tmp_path / "log.csv", dead, ("gx", "gy"))
    command = ("export", "log.csv", "-q", "--to", "kalibr", "-o", "imu.yaml")
    done = run(*command, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert "nothing was exported" in done.stderr
    assert done.stderr.count("Error: ") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    assert run(*command, "--force", cwd=tmp_path).returncode == 0
    assert (tmp_path / "imu.yaml").exists()


def test_the_report_is_written_and_named(tmp_path: Path) -> None:
    """JSON, page and table begin with it; no export is suggested; the gate stays shut."""
    write(tmp_path / "log.csv", moved, ("gx", "gy"))
    done = run("fit", "log.csv", "--model", "N", "--format", "svg", cwd=tmp_path)
    said = "Not noise: the IMU was moved; do not use these numbers"
    assert done.returncode == 4
    assert done.stdout.splitlines()[0] == said
    assert "imucal export" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith(
        "Error: log.csv: not noise: the IMU was moved; do not use these numbers; see log-imucal; "
        "fit the quiet part with --skip "
    )
    report = json.loads((tmp_path / "log-imucal" / "report.json").read_text(encoding="utf-8"))
    assert (report["verdict"], report["verdict_sentence"]) == ("not-noise", said)
    page = (tmp_path / "log-imucal" / "report.html").read_text(encoding="utf-8")
    assert f'<p class="verdict not-noise">{said}</p>' in page
    assert f"<p>{said}. No filter should be given its numbers.</p>" in page

    done = run("export", "log-imucal", "--to", "vins", "-o", "x.yaml", cwd=tmp_path)
    assert done.returncode == 4
    assert not (tmp_path / "x.yaml").exists()
    done = run("export", "log-imucal", "--to", "vins", "-o", "x.yaml", "--force", cwd=tmp_path)
    assert (done.returncode, (tmp_path / "x.yaml").exists()) == (0, True)
    gate = run("check", "log-imucal", "--baseline", "log-imucal", "--json", "-q", cwd=tmp_path)
    assert gate.returncode == 1
    assert json.loads(gate.stdout)["noise"] == {"verdict": "not-noise", "sentence": said}


def test_json_goes_to_standard_output_all_the_same(tmp_path: Path) -> None:
    """A script that reads it sees the verdict too; adev's JSON agrees with fit's."""
    write(tmp_path / "log.csv", dead, ("gx", "gy"))
    grades = []
    for command in (("fit", "log.csv", *QUICK), ("adev", "log.csv")):
        done = run(*command, "-q", "--json", cwd=tmp_path)
        assert done.returncode == 4
        grades.append(json.loads(done.stdout)["verdict"])
    assert grades == ["not-noise", "not-noise"]


def test_noise_at_rest_is_good(tmp_path: Path) -> None:
    """The same log unchanged: code 0, the verdict first, nothing when quiet."""
    write(tmp_path / "log.csv", fine)
    done = run("fit", "log.csv", *QUICK, "-q", "--strict", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(
        "Good for N; too short for B and K: 6 of 6 axes are stationary noise, N to ±"
    )
    done = run("adev", "log.csv", cwd=tmp_path)
    assert done.stderr.splitlines()[-1].startswith("Good: 6 of 6 axes")


def test_a_strict_run_says_what_it_found(tmp_path: Path) -> None:
    """The code alone would leave a script guessing."""
    write(tmp_path / "log.csv", knocked, ("gx", "gy"))
    done = run("fit", "log.csv", *QUICK, "-q", "--strict", cwd=tmp_path)
    assert done.returncode == 4
    (line,) = done.stderr.splitlines()
    assert line == "Error: log.csv: touch found; --strict allows no warning"


def test_a_wrong_unit_is_not_a_matter_of_stationarity(tmp_path: Path) -> None:
    """All axes count as stationary; the unit's option is suggested in place of an export, once."""

    def in_degrees(rows: FloatArray) -> None:
        """Write deg/s under a heading of rad/s, far from zero."""
        rows[:, 1:4] = np.degrees(rows[:, 1:4]) + np.array([40, 0, 0])

    write(tmp_path / "log.csv", in_degrees, ("gx", "gy", "gz"))
    command = ("fit", "log.csv", "--model", "N", "--format", "svg")
    done = run(*command, cwd=tmp_path)
    assert done.returncode == 0
    first = " ".join(done.stdout.splitlines()[:2])
    assert first.startswith("Check first: a unit that looks wrong on gyro; ")
    assert "Next: run again with --gyro-unit deg/s, because the unit looks wrong" in done.stderr
    assert "imucal export" not in done.stderr
    again = run(*command, "--gyro-unit", "deg/s", cwd=tmp_path)
    assert again.returncode == 0
    assert "Next: run again with" not in again.stderr.replace("run again without", "")


def test_white_noise_that_is_hardly_known_is_not_exported(tmp_path: Path) -> None:
    """A random walk hides it: neither fit nor export offers its N."""
    rng = np.random.default_rng(5)
    rows = np.column_stack([np.arange(N) / RATE, np.cumsum(rng.standard_normal(N)) * 1e-3])
    np.savetxt(tmp_path / "walk.csv", rows, delimiter=",", header="t [s],gx [rad/s]", comments="")
    command = ("fit", "walk.csv", "--model", "N + K", "--force", "--format", "svg", "-o", "walk")
    done = run(*command, cwd=tmp_path)
    assert done.returncode == 0
    assert "is uncertain by more than a factor of 10" in done.stderr
    assert "imucal export" not in done.stderr
    done = run("export", "walk", "--to", "vins", "-o", "x.yaml", cwd=tmp_path)
    assert done.returncode == 4


def test_a_given_unit_that_contradicts_the_log_is_repeated(tmp_path: Path) -> None:
    """`fit` suggests the command without it, and `export` repeats the warning."""
    write(tmp_path / "log.csv", fine, ("gx", "gy", "gz"))
    command = ("fit", "log.csv", "--model", "N", "--format", "svg", "-o", "out")
    done = run(*command, "--gyro-unit", "deg/s", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith("Check first: a unit other than the log's own on gyro")
    said = " ".join(done.stderr.split())
    assert "Next: run again without --gyro-unit if the log's own unit is right; if not, imucal export" in said
    exported = run("export", "out", "--to", "vins", "-o", "x.yaml", cwd=tmp_path)
    assert exported.returncode == 0
    assert "warning: The unit of the gyroscope is deg/s as given; the log has rad/s" in exported.stderr
    assert "it warns of: unit-given" in (tmp_path / "x.yaml").read_text(encoding="utf-8")
    again = run(*command, cwd=tmp_path)
    assert "Next: imucal export out" in again.stderr
