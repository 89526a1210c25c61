"""The option for each message of the library, which does not know options."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import run
from tests.readers.logs import imu_messages, samples, write_mcap
from tests.readers.messages.test_definition_files import log as undefined
from tests.readers.messages.test_definition_files import package
from tests.readers.messages.test_named_columns import two_gyros

HEAD = "gx,gy,gz,ax,ay,az"


def table(path: Path, heading: str, scale: float = 1.0) -> None:
    """Write a table of a sensor at rest."""
    rows = np.random.default_rng(1).normal(size=(300, 6)) * 0.01 + [0, 0, 0, 0, 0, 9.8]
    text = "\n".join(",".join(f"{value * scale:.6g}" for value in row) for row in rows)
    path.write_text(f"{heading}\n{text}\n", encoding="utf-8")


def test_a_missing_rate_is_asked_for_with_its_option(tmp_path: Path) -> None:
    """Not with --topic or --columns, which would not help; and the option does."""
    table(tmp_path / "log.csv", HEAD)
    done = run("fit", "log.csv", "--no-report", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.endswith("give the sampling rate\nUse --rate HZ.\n")
    assert run("adev", "log.csv", "--rate", "100", "-q", cwd=tmp_path).returncode == 0
    listed = run("info", "log.csv", cwd=tmp_path)
    assert "No samples can be read this way; give imucal fit --rate HZ.\n" in listed.stdout
    assert "No gyroscope" not in listed.stdout


def test_an_open_time_unit_is_asked_for_with_its_options(tmp_path: Path) -> None:
    """Either option works."""
    rows = "\n".join(f"{100 * i},{0.001 * (i % 7)},0.002,{0.001 * (i % 3)}" for i in range(300))
    (tmp_path / "log.csv").write_text(f"time,gx (rad/s),gy (rad/s),gz (rad/s)\n{rows}\n", encoding="utf-8")
    done = run("fit", "log.csv", "--no-report", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == "Use --time-unit UNIT or --rate HZ."
    assert "at 10000 Hz" in run("adev", "log.csv", "--time-unit", "us", cwd=tmp_path).stderr
    assert "at 10 Hz" in run("adev", "log.csv", "--rate", "10", cwd=tmp_path).stderr


def test_several_topics_are_asked_for_with_topic(tmp_path: Path) -> None:
    """The message lists them."""
    messages = imu_messages(samples(100), topic="/a") + imu_messages(samples(100), topic="/b")
    write_mcap(tmp_path / "log.mcap", messages)
    done = run("adev", "log.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == "Use --topic NAME."
    assert run("adev", "log.mcap", "--topic", "/b", "-q", cwd=tmp_path).returncode == 0


def test_a_wrong_value_is_answered_with_its_own_option(tmp_path: Path) -> None:
    """After what was expected."""
    write_mcap(tmp_path / "log.mcap", imu_messages(samples(100)))
    done = run("adev", "log.mcap", "--time", "moon", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == "Use --time CLOCK."


@pytest.mark.parametrize(
    ("option", "unit", "said"),
    [
        ("--gyro-unit", "furlong", "'furlong' is not a unit of the gyroscope; expected one of rad/s, "),
        ("--gyro-unit", "g", "'g' is not a unit of the gyroscope"),
        ("--gyro-unit", "degs", "'degs' is ambiguous; did you mean 'deg/s'?"),
        ("--accel-unit", "furlong", "'furlong' is not a unit of the accelerometer; expected one of m/s^2, g"),
        ("--accel-unit", "counts", "'counts' is not a unit of the accelerometer; give the size of a count"),
        ("--accel-unit", "rads", "'rads' is ambiguous; did you mean 'rad/s'?"),
    ],
)
def test_a_wrong_unit_is_a_usage_error(option: str, unit: str, said: str, tmp_path: Path) -> None:
    """Before the log is read; spellings that can't be meant otherwise are taken."""
    done = run("adev", "nowhere.csv", option, unit, cwd=tmp_path)
    assert done.returncode == 2
    assert f"Invalid value for '{option}': {said}" in done.stderr
    taken = "dps" if option == "--gyro-unit" else "m/s2"
    assert run("adev", "nowhere.csv", option, taken, cwd=tmp_path).returncode == 3


def test_a_message_without_an_answer_has_no_hint(tmp_path: Path) -> None:
    """No option makes an IMU of a log that has none."""
    other = [message for message in imu_messages(samples(100)) if message.log < 0]
    write_mcap(tmp_path / "log.mcap", other)
    done = run("adev", "log.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert "Say it with" not in done.stderr


def test_columns_of_messages_are_asked_for_with_their_option(tmp_path: Path) -> None:
    """The suggestion of the error works, and info -v lists the fields."""
    two_gyros(tmp_path)
    done = run("adev", "log.mcap", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == "Use --columns TEXT."
    match = re.search(r"such\s+as\s+(\S+)\s+or", done.stderr)
    assert match is not None
    asked = ("--columns", match[1], "--gyro-unit", "rad/s")
    assert run("adev", "log.mcap", *asked, "-q", cwd=tmp_path).returncode == 0
    listed = run("info", "-v", "log.mcap", cwd=tmp_path).stdout
    assert "/imu/data:\n  header.stamp time, " in listed
    assert "header.stamp time" not in run("info", "log.mcap", *asked, cwd=tmp_path).stdout
    assert "gyro, accel" in run("info", "log.mcap", *asked, cwd=tmp_path).stdout


def test_a_definition_is_asked_for_with_its_option(tmp_path: Path) -> None:
    """A file or a folder."""
    undefined(tmp_path)
    package(tmp_path)
    done = run("adev", "log.mcap", "--topic", "/board", cwd=tmp_path)
    assert done.stderr.splitlines()[-1] == "Use --msg FILE."
    assert run("adev", "log.mcap", "--msg", "src", "-q", cwd=tmp_path).returncode == 0
    assert "/board" in run("info", "log.mcap", "--msg", "src", cwd=tmp_path).stdout


def test_all_that_is_missing_is_asked_for_at_once(tmp_path: Path) -> None:
    """A rate and both units; typed once, it reads."""
    table(tmp_path / "log.csv", HEAD, scale=3.7)
    done = run("fit", "log.csv", "--no-report", cwd=tmp_path)
    assert done.returncode == 3
    accel, gyro = "--accel-unit UNIT or --accel-scale X", "--gyro-unit UNIT or --gyro-scale X"
    assert done.stderr.splitlines()[-1] == f"Use --rate HZ and {accel} and {gyro}."
    typed = ["--rate", "100", "--accel-unit", "m/s^2", "--gyro-unit", "deg/s"]
    assert run("adev", "log.csv", *typed, "-q", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("command", [("info",), ("adev",), ("compare", "other"), ("simulate", "N=1", "-o")])
def test_a_name_that_is_too_long_is_no_internal_error(command: tuple[str, ...], tmp_path: Path) -> None:
    done = run(*command, "a" * 300, cwd=tmp_path)
    assert done.returncode in {2, 3}
    assert "too long" in done.stderr
    assert "internal error" not in done.stderr


def test_linear_acceleration_is_warned_of_by_info(tmp_path: Path) -> None:
    """In the words of `fit`."""
    rng = np.random.default_rng(1)
    rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in rng.normal(size=(300, 3)) * 0.01)
    text = f"lin_acc_x (m/s^2),lin_acc_y (m/s^2),lin_acc_z (m/s^2)\n{rows}\n"
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    listed = run("info", "log.csv", "--rate", "100", cwd=tmp_path)
    assert "warning [no-gravity] accel: The accelerometer shows no gravity" in listed.stdout
    assert '"code": "no-gravity"' in run("info", "--json", "log.csv", "--rate", "100", cwd=tmp_path).stdout
