"""Typical mistakes: the exit code, and one message that helps. The docs contain the table."""

import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.findings import Finding
from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run
from tests.cli.test_not_noise import dead, moved, write
from tests.report.synthetic import consumer_report

PAGE = SAMPLE_LOGS.parent / "docs" / "results" / "mistakes.md"
SLIPS = re.findall(r"^\| `imucal (.*)` \| (\d+) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the page's examples."""
    place = tmp_path_factory.mktemp("slips")
    write_report(place)
    moving = Finding(level="error", code="motion", text="It moved.")
    write_report(place, "moved-imucal", replace(consumer_report(), findings=(moving,)))
    shutil.copy(SAMPLE_LOGS / "consumer_mems.mcap", place / "log.mcap")
    write(place / "moved.csv", moved)
    write(place / "dead.csv", dead)
    (place / "empty.csv").touch()
    (place / "notes.txt").write_text("Dear diary,\ntoday I recorded an IMU.\n", encoding="utf-8")
    (place / "half.mcap").write_bytes((place / "log.mcap").read_bytes()[:40])
    (place / "folder").mkdir()
    (place / "thesis").mkdir()
    (place / "thesis" / "thesis.tex").write_text("mine", encoding="utf-8")
    rows = np.random.default_rng(1).normal(size=(200, 6))
    np.savetxt(place / "raw.csv", rows, delimiter=",", fmt="%.6g", header="gx,gy,gz,ax,ay,az", comments="")
    (place / "limits.toml").write_text(
        '[gyroscope]\nN = { max = 1, unit = "deg/sqrt(h)" }\n', encoding="utf-8"
    )
    (place / "typo.toml").write_text("[gyroscop]\nN = { max = 1 }\n", encoding="utf-8")
    (place / "unit.toml").write_text('[gyroscope]\nN = { max = 1, unit = "deg/h" }\n', encoding="utf-8")
    return place


def test_the_page_lists_forty() -> None:
    """Of every command that reads or writes, and of every code a user can bring about."""
    assert len(SLIPS) >= 40
    assert {code for _, code, _ in SLIPS} == {"2", "3", "4", "5"}


@pytest.mark.parametrize(("typed", "code", "said"), SLIPS, ids=[typed for typed, *_ in SLIPS])
def test_a_slip_is_answered(typed: str, code: str, said: str, folder: Path) -> None:
    """As the page has it; nothing is written, and no traceback is shown."""
    before = sorted(folder.rglob("*"))
    done = run(*shlex.split(typed), cwd=folder)
    assert done.returncode == int(code)
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert sorted(folder.rglob("*")) == before
    if "-q" in typed.split():
        assert done.stderr.count("Error: ") == 1
