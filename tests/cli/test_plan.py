"""`imucal plan`: table, JSON and refusals."""

import json
from pathlib import Path

from tests.cli.reports import write_report
from tests.cli.run import run, run_process

MODEL = "N=1e-3 + K=1e-6"


def test_a_model_gives_a_table_of_80_columns(tmp_path: Path) -> None:
    """Whole, also through a pipe."""
    done = run("plan", MODEL, "--rate", "100", "--duration", "3h", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == "(n of 10): chance that a log this long detects the term\n"
    assert done.stdout.splitlines() == [
        "Record length for ±10 % (1 sd) of each term",
        "",
        "gyro  at 100 Hz, 3 h",
        "  term             value  unit                            needs       this gives",
        "  N                3.438  deg/sqrt(h)                    0.93 s         ±0.068 %",
        "  K                12.38  deg/h/sqrt(h)                3 d 22 h  ±83 % (0 of 10)",
    ]


def test_a_report_gives_each_axis(tmp_path: Path) -> None:
    """With its own rate, length and data-sheet units; no line is longer than 80."""
    write_report(tmp_path, "a")
    done = run("plan", "a", "--precision", "5%", "--level", "0.95", cwd=tmp_path)
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[0] == "Record length for ±5 % (95 %) of each term"
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith(("gyro_", "accel_")) for line in lines) == 6
    assert any("deg/sqrt(h)" in line for line in lines)
    si = run("plan", "a/report.json", "--si", cwd=tmp_path).stdout
    assert "rad/s/sqrt(Hz)" in si


def test_json_is_the_plan(tmp_path: Path) -> None:
    """SI, with null where no record is long enough."""
    done = run("plan", "N=1 + K=1e-9", "--rate", "100", "--json", "-q", cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/planning/1"
    assert document["precision"] == 0.1
    assert document["needed_s"] is None
    (axis,) = document["axes"]
    assert (axis["axis"], axis["model"]) == ("gyro", "N + K")
    assert [term["name"] for term in axis["terms"]] == ["N", "K"]
    assert axis["terms"][1] == {
        "name": "K",
        "value": 1e-9,
        "bounded": False,
        "needed_s": None,
        "reached": None,
        "detected": None,
    }


def test_a_terminal_without_signs_gets_plain_ones(tmp_path: Path) -> None:
    """Never a traceback for a sign that can't be printed."""
    done = run_process("plan", MODEL, "--rate", "100", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    assert done.stdout.startswith("Record length for +-10 % (1 sd) of each term\n")


def test_refuses_with_what_to_do(tmp_path: Path) -> None:
    """A model without a rate, neither model nor report, a log, a precision of nothing."""
    rate = run("plan", MODEL, cwd=tmp_path)
    assert rate.returncode == 2
    assert "a model has no sampling rate; give one, such as --rate 200" in rate.stderr
    neither = run("plan", "still", cwd=tmp_path)
    assert neither.returncode == 3
    assert "still: no such file, expected the report.json" in neither.stderr
    (tmp_path / "log.csv").write_text("t,gx\n", encoding="utf-8")
    log = run("plan", "log.csv", cwd=tmp_path)
    assert log.returncode == 3
    assert log.stderr == "Error: log.csv: not a report.json or its folder; run 'imucal fit log.csv' first\n"
    nothing = run("plan", MODEL, "--rate", "100", "--precision", "0", cwd=tmp_path)
    assert nothing.returncode == 2
    assert "0.0 is not in the range x>0" in nothing.stderr
