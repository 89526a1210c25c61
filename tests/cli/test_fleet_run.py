"""``imucal fleet run`` and ``status``: output and exit codes."""

import json
import os
import shutil
from pathlib import Path

import pytest

from imucal.cli._fleet import print_plan
from imucal.errors import WriteError
from imucal.fleet.logs import LogTask
from imucal.fleet.plan import LEVEL, MODEL, FleetPlan
from imucal.fleet.store import read_store
from tests.cli.run import run
from tests.fleet.simulated_fleet import make_fleet

LABELS = ("--labels", "{model}/{unit}/{temperature_c}C/*.npz")
pytestmark = pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with seven short logs and one truncated log."""
    folder = tmp_path_factory.mktemp("logs")
    made = make_fleet(folder / "logs", logs=8, seconds=20.0, seed=4, axes=1)
    assert [log.broken for log in made] == [""] * 7 + ["cut"]
    return folder


@pytest.fixture(scope="module")
def done(logs: Path) -> Path:
    """Return the working folder, with the fleet of the logs in it, done in one process."""
    ended = run("fleet", "run", "logs", *LABELS, "--shard", "1/1", "--max-failed", "20%", cwd=logs)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith("fleet: 8 logs done: 7 good, 0 check first, 0 not noise, 1 unreadable\n")
    assert "unreadable: 1\n  logs/beta/u02/15C/log0007.npz: not a readable NPZ file: " in ended.stderr
    return logs


def test_every_log_has_its_results_and_labels(done: Path) -> None:
    """Seven logs have one axis and three terms, and the failed log has a reason without its path."""
    logs = read_store(done / "fleet").logs()
    (failed,) = [row for row in logs if row["status"] == "unreadable"]
    assert failed["path"] == "logs/beta/u02/15C/log0007.npz"
    assert failed["terms"] == []
    assert failed["reason"].startswith("not a readable NPZ file: ")
    good = [row for row in logs if row["status"] == "ok"]
    assert {tuple(value["term"] for value in row["terms"]) for row in good} == {("N", "B", "K")}
    assert {(value["sensor"], value["axis"]) for row in good for value in row["terms"]} == {
        ("gyroscope", "x")
    }
    assert sorted({row["model"] for row in good}) == ["alpha", "beta", "gamma"]
    assert sorted({row["unit"] for row in good}) == ["u00", "u01", "u02"]
    assert {(row["temperature_c"], row["started"][:10], row["samples"]) for row in good} == {
        (15.0, "2026-01-01", 2000)
    }
    assert [row["seconds"] for row in good] == pytest.approx([20.0] * 7)


def test_a_finished_run_writes_the_report(done: Path) -> None:
    """Only the page is printed."""
    document = json.loads((done / "fleet" / "fleet.json").read_text(encoding="utf-8"))
    assert document["logs"] == {"asked": 8, "done": 8, "counted": 7}
    assert [model["name"] for model in document["models"]] == ["alpha", "beta", "gamma"]
    again = run("fleet", "run", "-o", "fleet", "--max-failed", "20%", "-q", cwd=done)
    assert again.stdout.splitlines()[2:] == [str(done / "fleet" / "fleet.html")]


def test_a_fleet_does_not_take_its_own_files_as_logs(done: Path, tmp_path: Path) -> None:
    """Its table and the reports of its logs look like logs."""
    shutil.copytree(done / "logs" / "alpha" / "u00", tmp_path / "logs")
    first = run("fleet", "run", ".", "-o", "fleet", "--reports", "all", "--shard", "1/1", cwd=tmp_path)
    assert first.stdout.startswith("fleet: 1 log done: ")
    assert (tmp_path / "fleet" / "fleet.csv").is_file()
    assert [*(tmp_path / "fleet" / "reports").glob("*/*.json")]
    again = run("fleet", "run", ".", "-o", "fleet", "--dry-run", cwd=tmp_path)
    assert again.stdout == "done\t./logs/15C/log0000.npz\n"
    inside = run("fleet", "run", ".", "--dry-run", cwd=tmp_path / "fleet")
    assert inside.returncode == 3
    assert "no log in this folder" in inside.stderr


def test_the_same_command_again_does_nothing_twice(done: Path) -> None:
    """A command with only the folder does nothing either."""
    rows = read_store(done / "fleet").rows
    for arguments in (("logs", *LABELS), ()):
        again = run("fleet", "run", *arguments, "--shard", "1/1", "--max-failed", "20%", cwd=done)
        assert again.returncode == 0, again.stderr
        assert again.stderr.startswith("0 logs to do, 0 kB; 8 already done\n")
    assert read_store(done / "fleet").rows == rows


def test_status_reports_it_too(done: Path) -> None:
    """For people and for programs."""
    said = run("fleet", "status", "fleet", cwd=done)
    assert said.returncode == 0
    assert said.stdout.startswith("fleet: 8 logs done: 7 good, ")
    document = json.loads(run("fleet", "status", "fleet", "--json", cwd=done).stdout)
    assert document["statuses"]["ok"] == 7
    assert document["statuses"]["unreadable"] == 1
    assert (document["asked"], document["done"], document["left"]) == (8, 8, [])


def test_more_failures_than_allowed_end_with_4(done: Path) -> None:
    """One of eight is more than 5 %."""
    ended = run("fleet", "run", "logs", *LABELS, "--shard", "1/1", cwd=done)
    assert ended.returncode == 4
    message = "Error: fleet: 1 of 8 logs failed (12.5 %), more than --max-failed 5%\n"
    assert ended.stderr.endswith(message)


def test_labels_that_the_store_has_are_not_asked_for_again(done: Path) -> None:
    """A run without labels keeps the stored ones; a run of a new folder requires them."""
    again = run("fleet", "run", "logs", "--shard", "1/1", cwd=done)
    assert again.stderr.startswith("0 logs to do, 0 kB; 8 already done\nunreadable: 1\n")
    first = run("fleet", "run", "logs/alpha/u00", "-o", "without", "--shard", "1/1", cwd=done)
    assert "No log has the label unit, so logs are not grouped" in first.stderr


def test_the_help_shows_the_actual_defaults(tmp_path: Path) -> None:
    """The help has copies of two of them."""
    text = " ".join(run("fleet", "run", "--help", cwd=tmp_path).stdout.split())
    assert f"Fit these terms to every log. [default: {MODEL}]" in text
    assert f"Confidence level of every interval. [default: {LEVEL}]" in text


def test_a_dry_run_writes_nothing(logs: Path) -> None:
    """It prints the planned action for every log."""
    ended = run("fleet", "run", "logs", *LABELS, "-o", "other", "--dry-run", cwd=logs)
    assert ended.returncode == 0
    lines = ended.stdout.splitlines()
    assert lines[0] == "run\tlogs/alpha/u00/15C/log0000.npz\tmodel=alpha unit=u00 temperature_c=15.0"
    assert len(lines) == 8
    assert ended.stderr.startswith("8 logs, ")
    assert not (logs / "other").exists()


@pytest.mark.parametrize(
    ("number", "size", "workers", "said"),
    [
        (1, 10_000, 1, "1 log, 10 kB, about 1 s on 1 worker\n"),
        (300, 17_000_000, 4, "300 logs, 5.1 GB, about 2 min 30 s on 4 workers\n"),
        (100_000, 224_000_000, 8, "100000 logs, 22.4 TB, about 2 d 2 h on 8 workers\n"),
    ],
)
def test_the_cost_of_a_fleet_has_readable_units(
    number: int, size: int, workers: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two days not how many minutes, of terabytes not how many megabytes."""
    tasks = tuple(LogTask(place=f"{i}.npz", size=size) for i in range(number))
    plan = FleetPlan(logs=tasks)
    print_plan(plan, workers)
    assert capsys.readouterr().err == said


def test_a_report_that_cannot_be_written_ends_with_5(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The results are there, the report that they were asked for is not."""

    def full(*_: object, **__: object) -> None:
        msg = "fleet.json: can't be written"
        raise WriteError(msg)

    shutil.copytree(done, tmp_path / "copy", ignore=shutil.ignore_patterns("fleet.*"))
    monkeypatch.setattr("imucal.fleet.files.write_fleet", full)
    ended = run("fleet", "run", "-o", "fleet", "--max-failed", "20%", "-q", cwd=tmp_path / "copy")
    assert ended.returncode == 5
    assert ended.stderr.startswith(
        "Finished logs are kept; to continue: imucal fleet run -o fleet --max-failed"
    )
    assert ended.stderr.endswith("Error: fleet.json: can't be written\n")


def test_a_dry_run_lists_logs_and_duplicates(done: Path, tmp_path: Path) -> None:
    """The manifest's own folder is where its paths begin."""
    (done / "copy.npz").write_bytes((done / "logs/alpha/u00/15C/log0000.npz").read_bytes())
    (tmp_path / "m.csv").write_text(f"path,unit\n{done}/copy.npz,9\n")
    ended = run("fleet", "run", "--manifest", str(tmp_path / "m.csv"), "logs", "--dry-run", cwd=done)
    (done / "copy.npz").unlink()
    first, *others = ended.stdout.splitlines()
    assert first == f"done\t{done}/copy.npz\tunit=9\tsame content as logs/alpha/u00/15C/log0000.npz"
    assert [line.split("\t")[0] for line in others] == ["done"] * 8


def test_two_shards_do_all_of_it(done: Path) -> None:
    """Each shard does its part in one store, and the results equal those of one run."""
    for shard, code in (("2/2", 4), ("1/2", 0)):
        ended = run("fleet", "run", "logs", "-o", "halves", *LABELS, "--shard", shard, cwd=done)
        assert ended.stdout.startswith("halves: 4 logs done: ")
        assert ended.returncode == code
    one, two = (
        [(row["path"], row["key"], row["status"], row["terms"]) for row in read_store(done / name).logs()]
        for name in ("fleet", "halves")
    )
    assert one == two


def test_nothing_readable_ends_with_3(tmp_path: Path) -> None:
    """As a single log that can't be read does."""
    for name in "ab":
        (tmp_path / f"{name}.mcap").write_bytes(name.encode() * 100)
    ended = run("fleet", "run", "a.mcap", "b.mcap", "missing.bag", "--shard", "1/1", cwd=tmp_path)
    assert ended.returncode == 3, ended.stderr
    assert "missing.bag: can't be opened: No such file or directory" in ended.stderr
    assert ended.stderr.endswith("Error: fleet: none of 3 logs can be read\n")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (
            (),
            2,
            "Missing argument 'LOGS...'; name logs, or give --manifest CSV or the folder of a fleet (-o)",
        ),
        (("*.bag",), 3, "*.bag: no log has this name; expected files, or folders with logs"),
        (("x", "--shard", "0/4"), 2, "'0/4' is not a part; write I/N with I from 1 to N, such as 1/8"),
        (("x", "--shard", "1/2", "--scheduler", "tcp://h:1"), 2, "expected shard or scheduler, not both"),
        (("x", "--labels", "*.csv"), 2, "no label; write for example '{model}/{unit}/*.mcap'"),
        (("x", "--memory", "much"), 2, "memory 'much', expected a size such as 500M or 2G"),
        (("x", "--memory", "100MB"), 2, "memory '100MB', expected a size such as 500M or 2G, 300M or more"),
        (("x", "--timeout", "0"), 2, "'0' is not a time limit; write a time such as 10min, or auto"),
        (("x", "--model", "auto+"), 2, "model 'auto+'"),
        (
            ("x", "--model", "auto"),
            2,
            "model 'auto', expected terms, such as N + B + K: auto depends on the log",
        ),
        (("x", "--max-failed", "5"), 2, "'5' is more than all; did you mean 0.05 or 5%?"),
        (("nowhere",), 3, "nowhere: no such file or folder; expected logs, or folders with logs"),
        (("x/1.csv", "--labels", "{temperature_c}/*.csv"), 2, "temperature_c is 'x', expected a number"),
        (
            ("x.csv", "-o", "thesis"),
            5,
            "contains thesis.tex but no imucal fleet; nothing was changed; choose",
        ),
    ],
)
def test_slips(arguments: tuple[str, ...], code: int, said: str, tmp_path: Path) -> None:
    """Each has its message and its exit code; nothing is written."""
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("x")
    ended = run("fleet", "run", *arguments, cwd=tmp_path)
    assert (ended.returncode, said in " ".join(ended.stderr.split())) == (code, True), ended.stderr
    assert os.listdir(tmp_path) == ["thesis"]  # noqa: PTH208 - names


def test_another_model_in_the_same_folder_is_refused(done: Path) -> None:
    """A fleet has one model, and the suggestion of the message works."""
    ended = run("fleet", "run", "logs", "--model", "N + K", "--shard", "1/1", cwd=done)
    assert ended.returncode == 2
    message = (
        "fleet: contains fits with model N + B + K, found N + K; choose another folder, or repeat all logs"
    )
    assert message in " ".join(ended.stderr.split())


def test_status_of_what_is_no_fleet(tmp_path: Path) -> None:
    """The exit code is 3, and the message contains the expected content."""
    ended = run("fleet", "status", "nowhere", cwd=tmp_path)
    assert ended.returncode == 3
    assert "no such folder; expected the folder of a fleet, written by imucal fleet run" in ended.stderr


def test_a_mistyped_command_of_the_group(tmp_path: Path) -> None:
    """As in the group above."""
    (tmp_path / "logs").mkdir()
    assert "did you mean 'run'?" in run("fleet", "rum", cwd=tmp_path).stderr
    said = run("fleet", "logs", cwd=tmp_path).stderr
    assert "No such command 'logs'; to characterise a fleet, type 'imucal fleet run logs'" in said
