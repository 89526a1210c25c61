"""`imucal fit`: the table, the report folder, the streams and the exit codes."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from imucal.cli.fit import report_folder
from tests.cli.run import SAMPLE_LOGS, run
from tests.remote.one_axis import OPTIONS, one_axis

SHORT = str(SAMPLE_LOGS / "too_short.db3")
QUICK = ("--model", "N")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Run the main job once; return what it printed and where it ran."""
    folder = tmp_path_factory.mktemp("whole")
    return run("fit", SHORT, cwd=folder), folder


def test_results_and_talk_go_to_different_streams(
    whole: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    """Standard output contains only the table; paths and findings are on standard error."""
    done, _ = whole
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(("Good for N; ", "Check first: "))
    assert done.stdout.splitlines()[1:3] == ["", "GYROSCOPE                                ACCELEROMETER"]
    assert "report.json" not in done.stdout
    assert "Wrote too_short-imucal: report.json, report.html, 8 pictures, 7 JSON files\n" in done.stderr
    assert "imucal export too_short-imucal" in done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "\x1b" not in done.stdout + done.stderr


def test_the_report_folder_holds_everything(whole: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    """One picture and one JSON an axis, the overviews, the report and the page."""
    _, folder = whole
    axes = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    expected = {f"{axis}.{kind}" for axis in axes for kind in ("png", "json")}
    expected |= {"gyro.png", "accel.png", "report.json", "report.html", "signal.json"}
    assert {path.name for path in (folder / "too_short-imucal").iterdir()} == expected


def test_a_log_on_standard_input_is_read(tmp_path: Path) -> None:
    """The path - is text on standard input."""
    text = one_axis().decode()
    done = run("fit", "-", *OPTIONS, "-q", "--json", "--no-report", "--model", "N", cwd=tmp_path, text=text)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["axes"][0]["samples"] == 1500


def test_an_unknown_term_is_a_usage_error(tmp_path: Path) -> None:
    """Exit code 2, and the terms there are."""
    done = run("fit", SHORT, "--model", "N + X", cwd=tmp_path)
    assert done.returncode == 2
    assert "'X' is not one of Q, N, B, GM, K, R" in done.stderr


def test_a_part_of_the_log_can_be_fitted(tmp_path: Path) -> None:
    """--skip and --take select it, and the report contains the range."""
    part = ("--skip", "5s", "--take", "10s", *QUICK)
    done = run("fit", SHORT, "-q", "--json", "--no-report", *part, cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document["axes"][0]["samples"] == 1000
    assert document["settings"]["reading"] == {"skip_s": 5.0, "take_s": 10.0}


def test_strict_turns_a_warning_into_an_exit_code(tmp_path: Path) -> None:
    """A log with gaps has a warning: the report is written, the code is 4."""
    command = ("fit", str(SAMPLE_LOGS / "with_gaps.csv"), "-q", "--no-report", *QUICK)
    assert run(*command, cwd=tmp_path).returncode == 0
    assert run(*command, "--strict", cwd=tmp_path).returncode == 4


def test_a_part_has_its_own_gaps_only(tmp_path: Path) -> None:
    """There is no warning about gaps elsewhere, and the six axes share one clock."""
    log = str(SAMPLE_LOGS / "with_gaps.csv")
    part = ("--skip", "25s", "--take", "30s", "--model", "N + B")
    done = run("fit", log, "--no-report", "--strict", *part, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "[gaps]" not in done.stderr
    assert done.stderr.count("Read with_gaps.csv") == 1
    assert "gyro xyz, accel xyz: 600 samples at 20 Hz, 30 s" in done.stderr


def test_a_folder_that_is_not_a_report_is_left_alone(tmp_path: Path) -> None:
    """The exit code is 5, and the folder is unchanged."""
    mine = tmp_path / "out"
    mine.mkdir()
    (mine / "thesis.tex").write_text("mine", encoding="utf-8")
    done = run("fit", SHORT, "-q", "-o", "out", cwd=tmp_path)
    assert done.returncode == 5
    assert "thesis.tex" in done.stderr
    assert [path.name for path in mine.iterdir()] == ["thesis.tex"]


def test_a_folder_that_can_not_be_written_is_refused_before_the_fit(tmp_path: Path) -> None:
    """No work for nothing: nothing is printed on standard output."""
    (tmp_path / "out").write_text("a file", encoding="utf-8")
    for folder in ("out", "out/report"):
        done = run("fit", SHORT, "-o", folder, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (5, "")
        assert done.stderr.startswith(f"Error: {folder}: ")


@pytest.mark.usefixtures("pictures_are_blank")
def test_hints_can_be_typed(tmp_path: Path) -> None:
    """Paths with blanks, or like options, are quoted."""
    (tmp_path / "log.csv").write_bytes(one_axis())
    done = run("fit", "log.csv", *OPTIONS, *QUICK, "-o", "-my report", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Next: imucal export './-my report' --to kalibr" in done.stderr


@pytest.mark.parametrize(
    ("log", "folder"),
    [
        ("a/log.mcap", "log-imucal"),
        ("still.csv.gz", "still-imucal"),
        ("run_2026.05.01.bag", "run_2026.05.01-imucal"),
        ("bags/rosbag2_folder/", "rosbag2_folder-imucal"),
        ("-", "stdin-imucal"),
    ],
)
def test_the_report_is_named_after_the_log(log: str, folder: str) -> None:
    """Without the endings of its format."""
    assert report_folder(log) == Path(folder)


def test_parts_of_the_record_are_compared(tmp_path: Path) -> None:
    """The report contains the number of parts."""
    rows = np.c_[np.arange(10_000) / 100, 1e-3 * np.random.default_rng(3).standard_normal(10_000)]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,gz", comments="")
    ask = ("fit", "log.csv", *OPTIONS, "--no-report", "--json", "-q", "--model", "N")
    report = json.loads(run(*ask, cwd=tmp_path).stdout)
    assert report["settings"]["segments"] == 8
    assert len(report["axes"][0]["fit"]["segments"]["start_s"]) == 4


@pytest.mark.usefixtures("forks")
def test_json_on_standard_output_is_the_report_however_many_axes_are_fitted_at_a_time(tmp_path: Path) -> None:
    """The bytes do not depend on the workers, no file is written, and zero workers are refused."""
    command = ["fit", SHORT, "--json", "--no-report", "-q", "--model", "N + B", "--jobs"]
    one, two, none = (run(*command, jobs, cwd=tmp_path) for jobs in "120")
    assert (one.returncode, two.returncode, none.returncode) == (0, 0, 2)
    assert one.stdout == two.stdout != ""
    assert "--jobs" in none.stderr
    assert one.stderr == two.stderr == ""
    assert run(*command[:-1], cwd=tmp_path).stdout == one.stdout
    document = json.loads(one.stdout)
    assert document["schema"] == "imucal/report/4"
    assert len(document["axes"]) == 6
    assert list(tmp_path.iterdir()) == []
