"""All commands: help, exit codes, one message and no traceback."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imucal.cli import COMMANDS
from tests.cli.run import SAMPLE_LOGS, run
from tests.remote.one_axis import one_axis


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_has_help_with_examples_that_fits_80_columns(command: str, tmp_path: Path) -> None:
    """The help is the first text that users read."""
    done = run(command, "--help", cwd=tmp_path, COLUMNS="80")
    assert done.returncode == 0
    assert "Examples:" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_help_lists_every_command(tmp_path: Path) -> None:
    """One line each."""
    done = run("--help", cwd=tmp_path)
    assert all(f"\n  {command} " in done.stdout for command in COMMANDS)


@pytest.mark.parametrize(
    ("content", "name"),
    [(b"", "empty.csv"), (b"\x00" * 5000, "zeros.mcap"), (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "x.bag")],
)
@pytest.mark.parametrize("command", ["fit", "info", "adev"])
def test_a_file_that_is_no_log_ends_with_one_message(
    command: str, content: bytes, name: str, tmp_path: Path
) -> None:
    """Exit code 3 or 4, the file named, no traceback, nothing on standard output, nothing written."""
    (tmp_path / name).write_bytes(content)
    done = run(command, name, cwd=tmp_path)
    assert done.returncode in {3, 4}, done.stderr
    assert done.stderr.startswith("Error: ")
    assert name in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("command", ["fit", "info", "adev"])
def test_a_missing_log_is_a_read_error(command: str, tmp_path: Path) -> None:
    """Exit code 3, and the name as it was typed."""
    done = run(command, "nowhere.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.startswith("Error: nowhere.mcap: ")


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *((name, value) for name in ("--rate", "--level", "--gyro-scale") for value in ("nan", "inf", "0")),
        ("--rate", "1e300"),
        ("--level", "0.9999999999999999"),
        ("--model", "nonsense"),
        ("--skip", "nan"),
    ],
)
def test_a_number_that_makes_no_sense_is_a_usage_error(option: str, value: str, tmp_path: Path) -> None:
    """Exit code 2, naming the option, before the log is read."""
    done = run("fit", "nowhere.mcap", option, value, cwd=tmp_path)
    assert done.returncode == 2
    assert f"Error: Invalid value for '{option}': " in done.stderr


def test_columns_of_a_log_of_messages(tmp_path: Path) -> None:
    """They are given like columns of a table; constants are not samples."""
    log = str(SAMPLE_LOGS / "too_short.db3")
    found = run("adev", log, cwd=tmp_path).stdout
    for columns in ("g=angular_velocity,a=linear_acceleration", "t=0,g=14:17,a=26:29"):
        assert run("adev", log, "--columns", columns, cwd=tmp_path).stdout == found
    done = run("adev", log, "--columns", "t=0,g=1:4,a=4:7", cwd=tmp_path)
    assert done.returncode == 4
    assert "no sensor has samples that change" in done.stderr


def test_a_reader_that_leaves_early_is_no_error(tmp_path: Path) -> None:
    """`imucal adev LOG | head -1` prints no error."""
    command = f"{sys.executable} -m imucal adev -q --taus all {SAMPLE_LOGS / 'too_short.db3'} | head -1"
    done = subprocess.run(  # noqa: S602 - a pipe is the point
        command, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 1


@pytest.mark.parametrize("command", [f"adev -q {SAMPLE_LOGS / 'too_short.db3'}", "--help"])
def test_a_full_disk_under_standard_output_is_reported(command: str, tmp_path: Path) -> None:
    """Exit code 5 and one message, not an internal error."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    done = subprocess.run(  # noqa: S602 - the shell's redirection is the point
        f"{sys.executable} -m imucal {command} > /dev/full",
        shell=True, cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 5
    assert done.stderr == (
        "Error: can't write to standard output: No space left on device; free some space\n"
    )


@pytest.mark.parametrize(
    ("redirection", "code"),
    [
        (">&- 2>&-", 0),
        ("- <&-", 3),
        *(pytest.param(alone, 0, marks=[pytest.mark.slow]) for alone in (">&-", "2>&-", "<&-")),
    ],
)
def test_closed_streams_are_no_error(redirection: str, code: int, tmp_path: Path) -> None:
    """As a service manager starts programs; a closed standard input is an empty one."""
    log = "" if redirection.startswith("-") else SAMPLE_LOGS / "too_short.db3"
    done = subprocess.run(  # noqa: S602 - the shell's redirection is the point
        f"{sys.executable} -m imucal adev -q {log} {redirection}",
        shell=True, cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert "internal error" not in done.stderr


def test_a_pipe_by_name_is_refused_instead_of_waited_for(tmp_path: Path) -> None:
    """Its first bytes would be gone after the format was found; standard input does what is meant."""
    os.mkfifo(tmp_path / "log.csv")
    done = run("info", "log.csv", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        3, "Error: log.csv: a pipe can be read only once; expected a file, or - with text on standard input\n"
    )  # fmt: skip


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_name_that_is_no_text_is_read_and_reported(tmp_path: Path) -> None:
    """Linux allows any bytes; the report holds them escaped."""
    (tmp_path / "one.csv").write_bytes(one_axis())
    for source, name in ((SAMPLE_LOGS / "too_short.db3", b"x\xff.db3"), (tmp_path / "one.csv", b"y\xfe.csv")):
        shutil.copy(source, tmp_path / os.fsdecode(name))
        quick = ("--model", "N", "--format", "svg", "--gyro-unit", "rad/s")
        done = run("fit", "-q", "--take", "5s", *quick, os.fsdecode(name), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        (folder,) = [p for p in tmp_path.iterdir() if p.is_dir() and os.fsencode(p.name).startswith(name[:1])]
        document = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        assert document["source"]["path"].isascii()


def test_an_interrupted_command_leaves_no_file_and_reports_it(tmp_path: Path) -> None:
    """Ctrl-C ends with 130 and leaves the folder as it was."""
    process = subprocess.Popen(
        [sys.executable, "-m", "imucal", "simulate", "N=1", "--duration", "3h", "-o", "big.csv"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr.strip() == "Interrupted; no file is incomplete."
    assert stdout == ""
    assert list(tmp_path.iterdir()) == []
