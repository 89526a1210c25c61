"""A program that reads the output of imucal may end first: the exit code is 141, without a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.run import SAMPLE_LOGS, run
from tests.remote.one_axis import OPTIONS, one_axis

LOG = str(SAMPLE_LOGS / "consumer_mems.mcap")


def codes_and_errors(*arguments: str, cwd: Path, both: bool) -> tuple[int, str]:
    """Run a command whose standard output, or `both` streams, have no reader; return code and errors."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        process = subprocess.run(  # noqa: S603 - our own command
            [sys.executable, "-m", "imucal", *arguments],
            cwd=cwd,
            stdout=writer,
            stderr=writer if both else subprocess.PIPE,
            encoding="utf-8",
            check=False,
            timeout=120,
        )
    finally:
        os.close(writer)
    return process.returncode, process.stderr or ""


COMMANDS = (
    "--help",
    "--version",
    "info LOG",
    "adev LOG",
    "fit nosuch.csv --json",
    "fleet --help",
    "completion bash",
)


@pytest.mark.parametrize(
    ("command", "both"), [*((each, False) for each in COMMANDS), ("--help", True), ("adev LOG", True)]
)
def test_a_closed_pipe_ends_a_command_with_141(tmp_path: Path, *, command: str, both: bool) -> None:
    code, errors = codes_and_errors(*command.replace("LOG", LOG).split(), cwd=tmp_path, both=both)
    assert code == 141
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors


@pytest.mark.parametrize(("command", "code"), [("fit nosuch.csv", 3), ("nosuch", 2), ("export --nosuch", 2)])
def test_an_error_whose_reader_is_gone_has_its_own_code(tmp_path: Path, command: str, code: int) -> None:
    assert codes_and_errors(*command.split(), cwd=tmp_path, both=True) == (code, "")


def test_messages_without_a_reader_cost_no_result(tmp_path: Path) -> None:
    """All results are written, although the reader of both streams has gone before the first message."""
    (tmp_path / "log.csv").write_bytes(one_axis())
    quick = ("--model", "N", "--format", "svg")
    code, errors = codes_and_errors(
        "fit", "log.csv", *OPTIONS, *quick, "-o", "report", cwd=tmp_path, both=True
    )
    assert (code, errors) == (141, "")
    assert (tmp_path / "report" / "report.json").is_file()


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_check_has_its_own_code_if_its_output_is_read(tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text("[log]\nrate = { min = 1 }\n", encoding="utf-8")
    run("fit", LOG, "-o", "report", "-q", "--take", "10s", "--model", "N", cwd=tmp_path)
    assert run("check", "report", "--limits", "limits.toml", cwd=tmp_path).returncode == 0
    assert codes_and_errors("check", "report", "--limits", "limits.toml", cwd=tmp_path, both=False)[0] == 141


@pytest.mark.parametrize(
    ("name", "content", "hint"),
    [
        (
            "still",
            "report.json",
            "to write a config file from a report, type 'imucal export still --to kalibr'",
        ),
        (
            "cal",
            "calibration.json",
            "to write a config file from a calibration, type 'imucal export cal --to kalibr'",
        ),
        ("units", "run-1.fleet", "to print the state of a fleet, type 'imucal fleet status units'"),
        ("imu.yaml", "", "expected one of info, doctor, fit, "),
        ("log.csv", "", "to fit a log, type 'imucal fit log.csv'"),
    ],
)
def test_a_path_instead_of_a_command_is_answered_by_what_it_is(
    tmp_path: Path, name: str, content: str, hint: str
) -> None:
    path = tmp_path / name
    if content:
        path.mkdir()
        path /= content
    path.write_text("{}", encoding="utf-8")
    result = run(name, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert hint in " ".join(result.stderr.split())


def test_a_fleet_instead_of_a_command_of_fleets_is_not_run_again(tmp_path: Path) -> None:
    (tmp_path / "units").mkdir()
    (tmp_path / "units" / "run-1.fleet").touch()
    assert "type 'imucal fleet status units'" in run("fleet", "units", cwd=tmp_path).stderr


@pytest.mark.parametrize("command", ["fit", "info"])
def test_an_address_with_open_brackets_is_refused(tmp_path: Path, command: str) -> None:
    result = run(command, "http://user:secret@[::1/x.csv", cwd=tmp_path)
    assert result.returncode == 3
    assert "http://[::1/x.csv: not a valid web address (Invalid IPv6 URL)" in result.stderr
    assert "secret" not in result.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")  # noqa: PTH110
@pytest.mark.parametrize(("command", "code"), [("fit nosuch.csv --json", 3), ("info LOG", 5)])
def test_a_full_disk_has_a_message_and_no_traceback(command: str, code: int) -> None:
    """The error of the log counts if there is one, otherwise that of the output."""
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123 - a device
        done = subprocess.run(  # noqa: S603 - our own command
            [sys.executable, "-m", "imucal", *command.replace("LOG", LOG).split()],
            stdout=full,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            check=False,
        )
    assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
    assert done.stderr.startswith("Error: ")
