"""Output on the terminal: one line per folder, one remedy, errors as JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from imucal.cli import main
from tests.cli.run import SAMPLE_LOGS, run

_PLAIN = ("--model", "N")
_QUICK = (*_PLAIN, "--format", "svg")
_SHORT = str(SAMPLE_LOGS / "too_short.db3")


def _write(path: Path, seconds: int, *, carried_s: float = 0.0) -> None:
    """Write an axis of each sensor, of white noise at 50 Hz, carried about for some time at both ends."""
    rng, t = np.random.default_rng(12), np.arange(seconds * 50) / 50
    values = rng.standard_normal((t.size, 2)) * [1e-3, 1e-2] + [0.0, 9.81]
    moved = (t < carried_s) | (t >= seconds - carried_s)
    values[moved] += (0.5 * np.sin(2 * np.pi * 0.7 * t[moved]))[:, None]
    header = "t[s],gx[rad/s],az[m/s^2]"
    np.savetxt(path, np.column_stack([t, values]), delimiter=",", header=header, comments="", fmt="%.9g")


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_folder_is_one_line_and_a_second_run_reports_the_replacement(tmp_path: Path) -> None:
    """Instead of a line a file."""
    _write(tmp_path / "log.csv", 40)
    first = run("fit", "log.csv", "-o", "out", *_QUICK, cwd=tmp_path)
    assert "Wrote out: report.json, report.html, 4 pictures, 3 JSON files\n" in first.stderr
    again = run("fit", "log.csv", "-o", "out", *_QUICK, cwd=tmp_path)
    assert "Replaced the report in out: report.json, report.html, 4 pictures, 3 JSON files\n" in again.stderr


def test_a_log_carried_at_both_ends_gets_one_error_and_one_remedy(tmp_path: Path) -> None:
    """The suggested options work, and the JSON output stays one document."""
    _write(tmp_path / "carried.csv", 120, carried_s=10.0)
    done = run("fit", "carried.csv", "--no-report", "--json", *_PLAIN, cwd=tmp_path)
    assert done.returncode == 4
    assert json.loads(done.stdout)["verdict"] == "not-noise"
    said = " ".join(done.stderr.split())
    assert said.count("error [") == 1
    assert "--force" not in said
    options = said.partition("Try ")[2].partition(". ")[0].split()
    assert f"nothing was written; fit the quiet part with {' '.join(options)}, or check the stream: " in said
    kept = run("fit", "carried.csv", "--no-report", *_PLAIN, *options, cwd=tmp_path)
    assert kept.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "kind", "code"),
    [
        (("fit", "nothing.mcap", "--json"), "ReadError", 3),
        (("info", "nothing.mcap", "--json"), "ReadError", 3),
        (("fit", _SHORT, "--levl", "0.9", "--json"), "NoSuchOption", 2),
    ],
)
def test_errors_are_json_where_json_was_asked_for(
    arguments: tuple[str, ...], kind: str, code: int, tmp_path: Path
) -> None:
    """JSON is on standard output, a sentence on standard error."""
    done = run(*arguments, cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/error/2"
    assert (document["error"]["type"], document["error"]["exit_code"]) == (kind, code)
    assert done.returncode == code
    assert document["error"]["message"] in done.stderr


def test_a_log_of_seconds_is_good_for_n_only(tmp_path: Path) -> None:
    """The verdict reports that it is too short for B and K."""
    _write(tmp_path / "short.csv", 20)
    done = run("fit", "short.csv", "--no-report", "-q", cwd=tmp_path)
    assert done.stdout.startswith("Good for N; too short for B and K: 2 of 2 axes are stationary noise")


@pytest.mark.usefixtures("pictures_are_blank")
def test_open_shows_the_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In the browser, once it is written; not without a page, and not unless asked for."""
    shown: list[str] = []
    monkeypatch.setattr("click.launch", shown.append)
    monkeypatch.chdir(tmp_path)
    _write(tmp_path / "log.csv", 20)
    for more in (("--open",), ("--open", "--no-report"), ()):
        with pytest.raises(SystemExit) as ended:
            main(["fit", "log.csv", "-o", "out", "-q", *_PLAIN, "--format", "svg", *more])
        assert ended.value.code == 0
    assert shown == [str(Path("out") / "report.html")]
