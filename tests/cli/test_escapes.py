"""Names of topics, columns and files that would steer the terminal: escaped wherever they are printed."""

import json
import re
from pathlib import Path

import pytest

from imucal.readers import describe
from tests.cli.run import run
from tests.readers.logs import Message, imu_messages, samples, write_mcap

#: A terminal's colour and cleared screen, an 8 bit command, a bell, text turned round.
EVIL = "\x1b[31m\x1b[2J\x9b2K\x07\u202e"
SHOWN = "\\x1b[31m\\x1b[2J\\x9b2K\\x07\\u202e"
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def folder(path: Path) -> Path:
    """Write logs whose names, of every kind, hold signs that steer."""
    path.mkdir(exist_ok=True)
    truth = samples(400)
    write_mcap(path / "one.mcap", imu_messages(truth, topic=f"/imu{EVIL}"))
    both = imu_messages(truth, topic=f"/a{EVIL}") + imu_messages(truth, topic=f"/b{EVIL}")
    write_mcap(path / "two.mcap", both)
    write_mcap(path / f"file{EVIL}.mcap", imu_messages(truth))
    other = Message(topic=f"/chat{EVIL}", type="std_msgs/msg/String", log=1, data=b"\0\1\0\0\1\0\0\0\0")
    write_mcap(path / "none.mcap", [other])
    rows = [f"{i / 100},{','.join(map(repr, row))}" for i, row in enumerate(truth.all.tolist())]
    for name, header in (
        ("table.csv", f"t,gx,gy,gz{EVIL},ax,ay,az"),
        ("unknown.csv", f"t{EVIL},a{EVIL},b,c,d,e,f"),
        (f"table{EVIL}.csv", f"t{EVIL},gx,gy,gz,foo{EVIL}x,fooy,fooz"),
    ):
        (path / name).write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    (path / f"text{EVIL}.txt").write_text(f"no table {EVIL}\n" * 9, encoding="utf-8")
    return path


COMMANDS = (
    (
        "info",
        "one.mcap",
        "two.mcap",
        "none.mcap",
        "table.csv",
        "unknown.csv",
        f"table{EVIL}.csv",
        f"file{EVIL}.mcap",
    ),
    ("adev", "-v", "one.mcap"),
    ("adev", "-v", f"file{EVIL}.mcap"),
    ("adev", "-v", "table.csv"),
    ("adev", "-v", f"table{EVIL}.csv", "--gyro-unit", "rad/s"),
    ("adev", "two.mcap"),
    ("adev", "two.mcap", "--topic", f"/c{EVIL}"),
    ("adev", "none.mcap"),
    ("adev", "unknown.csv"),
    ("adev", f"text{EVIL}.txt"),
    ("adev", f"missing{EVIL}.csv"),
    ("adev", "one.mcap", f"file{EVIL}.mcap"),
    ("adev", "one.mcap", "--time", EVIL),
    ("adev", "one.mcap", f"--wrong{EVIL}"),
    (f"command{EVIL}",),
    ("check", f"report{EVIL}.json", "--limits", f"limits{EVIL}.toml"),
    ("export", f"report{EVIL}.json", "--to", f"kalibr{EVIL}"),
    ("compare", f"a{EVIL}", f"b{EVIL}"),
    ("plan", f"N={EVIL}"),
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of logs."""
    return folder(tmp_path_factory.mktemp("logs"))


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: " ".join(arguments).replace(EVIL, "*"))
def test_nothing_steers_the_terminal(arguments: tuple[str, ...], logs: Path) -> None:
    """Not what was read, not a choice, not an error of ours or of the command line."""
    done = run(*arguments, cwd=logs)
    said = done.stdout + done.stderr
    assert "\\x1b[31m" in said
    assert not STEERING.search(said)


def test_json_is_exact_and_steers_nothing(logs: Path) -> None:
    """The same topic as the log has, in a text that a terminal can show."""
    done = run("info", "--json", "one.mcap", f"file{EVIL}.mcap", cwd=logs)
    assert not STEERING.search(done.stdout)
    first, second = json.loads(done.stdout)["logs"]
    assert first["topics"][0]["name"] == f"/imu{EVIL}" == describe(logs / "one.mcap").topics[0].name
    assert second["path"] == f"file{EVIL}.mcap"
    done = run("fit", "--json", "--no-report", "--model", "N", "one.mcap", cwd=logs)
    assert not STEERING.search(done.stdout + done.stderr)
    assert json.loads(done.stdout)["source"]["topics"] == [f"/imu{EVIL}"]


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_report_shows_escapes(logs: Path) -> None:
    """The page, the pictures and the config files contain escapes instead of control characters."""
    quick = ("--model", "N", "--format", "svg")
    done = run("fit", f"table{EVIL}.csv", *quick, "--gyro-unit", "rad/s", "-o", "r", cwd=logs)
    assert done.returncode == 0
    assert not STEERING.search(done.stderr)
    page = (logs / "r" / "report.html").read_text(encoding="utf-8")
    assert f"table{SHOWN}.csv" in page
    assert not STEERING.search(page)
    done = run("export", "r", "--to", "kalibr", "-o", "-", cwd=logs)
    assert done.returncode == 0
    assert not STEERING.search(done.stdout)
