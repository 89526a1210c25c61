"""`imucal compare`: the table, JSON and exit codes."""

import json
from dataclasses import replace
from pathlib import Path

from tests.cli.reports import write_report
from tests.cli.run import run
from tests.report.synthetic import axis_report, consumer_report, small_report


def _two(folder: Path) -> None:
    """Write two reports: in the second, gyro_x has a third more white noise."""
    first, *others = consumer_report().axes
    louder = axis_report(first.sensor, "x", "N=1.6e-4 + B=2.4e-5 + K=1.1e-6")
    write_report(folder, "a")
    write_report(folder, "b", replace(consumer_report(), axes=(louder, *others)))


def test_a_difference_ends_with_1(tmp_path: Path) -> None:
    """The table fits 80 columns and names what differs; --no-fail reports only."""
    _two(tmp_path)
    done = run("compare", "a", "b", cwd=tmp_path)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[1] == "gyro_x  N     deg/sqrt(h)           0.4125       0.55   1.333    <1e-9  differs"
    assert lines[-1] == "1 of 21 terms differ (p adjusted for 21 tests, alpha 0.05)"
    assert max(map(len, lines)) <= 80
    assert "\x1b" not in done.stdout
    assert run("compare", "a", "b", "--no-fail", "-q", cwd=tmp_path).returncode == 0


def test_no_difference_ends_with_0(tmp_path: Path) -> None:
    """A tolerance makes one of a third none."""
    _two(tmp_path)
    assert run("compare", "a", "a/report.json", cwd=tmp_path).returncode == 0
    done = run("compare", "a", "b", "--tolerance", "0.4", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1].startswith("no significant difference beyond 0.4 of A")


def test_json_has_every_number_in_si(tmp_path: Path) -> None:
    """Strict JSON, alone on standard output."""
    _two(tmp_path)
    done = run("compare", "a", "b", "--json", "-q", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    document = json.loads(done.stdout)
    assert (document["schema"], document["tested"], document["significant"]) == ("imucal/comparison/1", 21, 1)
    first = document["differences"][0]
    assert (first["axis"], first["term"], first["outcome"]) == ("gyro_x", "N", "differs")
    assert (first["a"]["value"], first["b"]["value"]) == (1.2e-4, 1.6e-4)


def test_si_units_on_request(tmp_path: Path) -> None:
    """Instead of the data sheet's."""
    _two(tmp_path)
    done = run("compare", "a", "b", "--si", "--no-fail", cwd=tmp_path)
    assert done.stdout.splitlines()[1].startswith("gyro_x  N     rad/s/sqrt(Hz)       0.00012    0.00016")
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_what_cannot_be_compared_is_one_message(tmp_path: Path) -> None:
    """No common axis ends with 4, no report with 3."""
    write_report(tmp_path, "a", small_report())
    write_report(tmp_path, "b", replace(consumer_report(), axes=consumer_report().axes[3:]))
    done = run("compare", "a", "b", cwd=tmp_path)
    assert done.returncode == 4
    assert "have no axis in common: the first has gyro_x" in done.stderr
    (tmp_path / "c.json").write_text("[]")
    assert run("compare", "a", "c.json", cwd=tmp_path).returncode == 3
    assert run("compare", "a", "missing", cwd=tmp_path).returncode == 3
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    done = run("compare", "a.mcap", "a", cwd=tmp_path)
    assert done.returncode == 3
    assert "a.mcap: not a report.json or its folder; run 'imucal fit a.mcap' first" in done.stderr
