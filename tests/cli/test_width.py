"""Tables fit the terminal: 80 columns where the output goes to a file, 40 on a narrow one."""

import io
import re
from pathlib import Path

import pytest

from imucal.cli._printing import fleet_progress, width, wrapped
from imucal.fleet.running import RunCount
from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run

DOCS = SAMPLE_LOGS.parent / "docs"
_QUICK = ("--no-report", "--take", "10s")
COMMANDS = [
    ("fit", str(SAMPLE_LOGS / "too_short.db3"), "--model", "N + GM", *_QUICK),
    ("fit", str(SAMPLE_LOGS / "too_short.db3"), "--model", "N", "--si", *_QUICK),
    ("info", "log.csv"),
    ("check", "still-imucal", "--limits", str(DOCS / "limits-example.toml")),
    ("check", "still-imucal", "--baseline", "other-imucal"),
    ("compare", "still-imucal", "other-imucal"),
    ("plan", "still-imucal", "--duration", "3h"),
    ("drift", "still-imucal"),
    ("sensor", "ADIS16448"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two reports, a log with a short name."""
    place = tmp_path_factory.mktemp("width")
    write_report(place)
    write_report(place, "other-imucal")
    (place / "log.csv").write_bytes((SAMPLE_LOGS / "with_gaps.csv").read_bytes())
    return place


@pytest.mark.parametrize("columns", [40, 80])
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_every_table_fits(command: tuple[str, ...], columns: int, folder: Path) -> None:
    """No line is longer than the terminal, and the narrow table contains the values of the wide one."""
    done = run(*command, cwd=folder, COLUMNS=str(columns))
    assert done.returncode in {0, 1}
    assert done.stdout
    assert [line for line in done.stdout.splitlines() if len(line) > columns] == []
    assert "\x1b" not in done.stdout
    if columns == 40:
        wide = run(*command, cwd=folder, COLUMNS="200").stdout
        numbers = [word for word in wide.split() if any(c.isdigit() for c in word)]
        lost = [word for word in numbers if word not in done.stdout]
        assert lost == []


def test_the_width_is_80_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is at least 30, because narrower lines would be unreadable."""
    for columns, expected in [("200", 80), ("80", 80), ("55", 55), ("10", 30)]:
        monkeypatch.setenv("COLUMNS", columns)
        assert width() == expected


def test_a_line_breaks_between_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only where it must; later lines are indented by two more."""
    monkeypatch.setenv("COLUMNS", "30")
    assert wrapped("nine of thirty letters, no more") == ["nine of thirty letters, no", "  more"]
    assert wrapped("nine of thirty letters, indeed") == ["nine of thirty letters, indeed"]
    assert wrapped("nine of thirty letters", indent=9) == ["         nine of thirty", "           letters"]


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("columns", "left"), [(40, " 50%"), (80, "1.0/2.0 MB")])
def test_progress_is_one_line(columns: int, left: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a narrow terminal, too: with the share in place of bar, bytes and time."""
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    with fleet_progress() as tell:
        assert tell is not None
        tell(RunCount(logs=30, size=2_000_000, done=15, failed=1, running=2, done_size=1_000_000))
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue())
    lines = [line.rstrip() for line in re.split("[\r\n]", plain) if line.strip()]
    last = lines[-1]
    assert last.startswith("15 of 30 logs, 1 failed, 2 running")
    assert left in last
    # The bar of the first moment has no words yet.
    assert all(len(line) <= columns for line in lines)
    assert len({line for line in lines if "15 of 30" not in line}) <= 1
