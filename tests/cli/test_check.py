"""`imucal check`: pass, fail or undecided; table, JSON, JUnit, annotations."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from imucal.findings import Finding
from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run, run_process
from tests.report.synthetic import consumer_report

PASSES = '[gyroscope]\nN = { max = 0.5, unit = "deg/sqrt(h)" }\n'
FAILS = '[gyroscope]\nN = { max = 0.4, unit = "deg/sqrt(h)" }\n'
UNDECIDED = "[gyro_x]\nK = { max = 1.1e-6 }\n"


def _check(folder: Path, limits: str, *arguments: str, **environment: str) -> tuple[int, str, str]:
    if not (folder / "still-imucal").exists():
        write_report(folder)
    (folder / "limits.toml").write_text(limits)
    command = run_process if environment else run
    done = command("check", "still-imucal", "--limits", "limits.toml", *arguments, cwd=folder, **environment)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("limits", "arguments", "code", "last"),
    [
        (PASSES, (), 0, "PASS: 4 passed, 0 failed, 0 undecided (intervals at 95%)"),
        (FAILS, (), 1, "FAIL: 2 passed, 2 failed, 0 undecided (intervals at 95%)"),
        (
            UNDECIDED,
            (),
            0,
            "PASS: 1 passed, 0 failed, 1 undecided (intervals at 95%; undecided doesn't fail)",
        ),
        (
            UNDECIDED,
            ("--undecided", "fail"),
            1,
            "FAIL: 1 passed, 0 failed, 1 undecided (intervals at 95%; undecided fails)",
        ),
    ],
)
def test_the_exit_code_is_the_gate(
    limits: str, arguments: tuple[str, ...], code: int, last: str, tmp_path: Path
) -> None:
    """0 where nothing failed, 1 where something did; undecided as asked. The table fits 80 columns."""
    returned, out, _ = _check(tmp_path, limits, *arguments)
    assert returned == code
    *table, line = out.splitlines()
    assert line == last
    assert all(len(row) <= 80 for row in table)
    assert "\x1b" not in out


def test_the_table_shows_value_interval_and_limit(tmp_path: Path) -> None:
    """In the unit of the limits file."""
    _, out, err = _check(tmp_path, FAILS)
    assert out.splitlines()[:3] == [
        "fail      gyro_x N <= 0.4 deg/sqrt(h) 0.4125 [0.4109, 0.4141]",
        "fail      gyro_y N <= 0.4 deg/sqrt(h) 0.4469 [0.4452, 0.4487]",
        "pass      gyro_z N <= 0.4 deg/sqrt(h) 0.3782 [0.3767, 0.3796]",
    ]
    assert err == ""


def test_json_is_alone_on_standard_output(tmp_path: Path) -> None:
    """Annotations go to standard error then."""
    code, out, err = _check(tmp_path, FAILS, "--json", "--github")
    assert code == 1
    assert json.loads(out)["counts"] == {"pass": 2, "fail": 2, "undecided": 0}
    assert err.count("::error file=limits.toml,title=imucal gyro_") == 2


def test_junit_is_written_whole(tmp_path: Path) -> None:
    """A parser reads the file, its path is on standard error, and an invalid path ends with exit code 5."""
    code, _, err = _check(tmp_path, FAILS, "--junit", "out.xml")
    assert (code, err) == (1, "out.xml\n")
    assert ET.parse(tmp_path / "out.xml").getroot().get("failures") == "2"  # noqa: S314 - our own file
    assert _check(tmp_path, PASSES, "--junit", "out.xml")[0] == 0  # our own is replaced
    code, out, err = _check(tmp_path, FAILS, "--junit", "no/out.xml")
    assert (code, out) == (5, "")
    assert "no/out.xml: can't be written: No such file or directory" in err


def test_annotations_follow_the_table(tmp_path: Path) -> None:
    """GitHub reads them from standard output."""
    _, out, _ = _check(tmp_path, UNDECIDED, "--github")
    assert out.splitlines()[-1].startswith("::warning file=limits.toml,title=imucal gyro_x%3A K <= 1.1e-06")


def test_a_baseline_needs_no_limits(tmp_path: Path) -> None:
    """A report is not worse than itself; one of moved data fails as it does with limits."""
    write_report(tmp_path)
    done = run("check", "still-imucal", "--baseline", "still-imucal/report.json", cwd=tmp_path)
    assert done.returncode == 0
    assert "N / baseline <= 1.2" in done.stdout
    assert "0 failed, 0 undecided" in done.stdout
    moved = Finding(level="error", code="motion", text="It moved.")
    write_report(tmp_path, "moved-imucal", replace(consumer_report(), findings=(moved,)))
    done = run("check", "moved-imucal", "--baseline", "still-imucal", cwd=tmp_path)
    assert done.returncode == 1
    assert "forbidden error [motion]" in done.stdout


def test_a_baseline_path_is_relative_to_the_limits_file(tmp_path: Path) -> None:
    """The limits may be in another folder; --baseline takes its place."""
    write_report(tmp_path)
    write_report(tmp_path / "ci", "golden")
    (tmp_path / "ci" / "limits.toml").write_text('[baseline]\nreport = "golden"\nterms = ["N"]\n')
    done = run("check", "still-imucal", "--limits", "ci/limits.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "ci" / "limits.toml").write_text("[baseline]\n")
    done = run("check", "still-imucal", "--limits", "ci/limits.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "[baseline] has no report" in done.stderr


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ("[gyroscope", "Error: limits.toml: not valid TOML (Expected ']'"),
        (
            "[gyroscope]\nN = { maks = 1 }",
            "Error: limits.toml: gyroscope.N: unknown key 'maks'; did you mean",
        ),
    ],
)
def test_wrong_limits_end_with_2(limits: str, message: str, tmp_path: Path) -> None:
    """One message on standard error, no traceback."""
    code, out, err = _check(tmp_path, limits)
    assert (code, out) == (2, "")
    assert err.startswith(message)
    assert len(err.splitlines()) == 1


def test_nothing_to_check_against_is_an_error(tmp_path: Path) -> None:
    """And so is a report that isn't there."""
    write_report(tmp_path)
    done = run("check", "still-imucal", cwd=tmp_path)
    assert done.returncode == 2
    assert (
        "nothing to check against; give --limits FILE, --baseline REPORT, --fleet FLEET or --config FILE"
        in done.stderr
    )
    (tmp_path / "limits.toml").write_text(PASSES)
    assert run("check", "no.json", "--limits", "limits.toml", cwd=tmp_path).returncode == 3


def test_a_terminal_that_knows_ascii_alone_gets_ascii(tmp_path: Path) -> None:
    """Under LANG=C without UTF-8 mode nothing breaks."""
    code, out, _ = _check(tmp_path, FAILS, PYTHONUTF8="0", PYTHONIOENCODING="ascii:strict", LC_ALL="C")
    assert code == 1
    assert out.isascii()


def test_a_log_is_characterised_first(tmp_path: Path) -> None:
    """A minute of data determines little more than the rate."""
    (tmp_path / "limits.toml").write_text("[log]\nrate = { min = 1 }\n[findings]\nlevel = 'none'\n")
    log = str(SAMPLE_LOGS / "too_short.db3")
    done = run("check", log, "--limits", "limits.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "rate >= 1 Hz" in done.stdout


def test_a_filters_config_is_held_to_the_report(tmp_path: Path) -> None:
    """Exit code 1 and the line to write, which makes it pass; in JSON, JUnit and annotations, too."""
    write_report(tmp_path)
    run("export", "still-imucal", "--to", "vins", "-o", "vins.yaml", cwd=tmp_path)
    assert run("check", "still-imucal", "--config", "vins.yaml", cwd=tmp_path).returncode == 0
    right = (tmp_path / "vins.yaml").read_text(encoding="utf-8")
    value = next(line for line in right.splitlines() if line.startswith("gyr_n:")).split()[1]
    wrong = right.replace(f"gyr_n: {value}", f"gyr_n: {float(value) / 20 / 2**0.5!r}")
    (tmp_path / "vins.yaml").write_text(wrong, encoding="utf-8")
    done = run("check", "still-imucal", "--config", "vins.yaml", "--github", "--junit", "j.xml", cwd=tmp_path)
    assert done.returncode == 1
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert f"gyr_n: {value}" in lines
    assert "too small" in done.stdout
    assert "::error file=vins.yaml," in done.stdout
    assert "gyr_n" in (tmp_path / "j.xml").read_text(encoding="utf-8")
    asked = ("check", "still-imucal", "--config", "vins.yaml", "--json", "-q")
    (row,) = (
        row for row in json.loads(run(*asked, cwd=tmp_path).stdout)["rows"] if row["subject"] == "gyr_n"
    )
    assert row["instead"] == f"gyr_n: {value}"
    (tmp_path / "vins.yaml").write_text(f"{row['instead']}\n", encoding="utf-8")
    assert run(*asked, cwd=tmp_path).returncode == 0


def test_limits_and_a_config_go_together(tmp_path: Path) -> None:
    """One table; either fails it."""
    write_report(tmp_path)
    (tmp_path / "px4.params").write_text("param set EKF2_GYR_NOISE 0.0\n", encoding="utf-8")
    code, out, _ = _check(tmp_path, PASSES, "--config", "px4.params")
    assert code == 1
    assert "param set EKF2_GYR_NOISE 0.0" in out
    assert "expected a positive number" in " ".join(out.split())
    assert "gyro_x N <= 0.5 deg/sqrt(h)" in out
