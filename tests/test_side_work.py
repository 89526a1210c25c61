"""Tests that failures of second opinions, screening and pictures do not prevent a result."""

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from imucal import pipeline, screening, side_work
from imucal.errors import DataError
from imucal.pipeline import Settings, characterize, screen
from imucal.recording import AxisSeries, Recording, Source
from imucal.report import figure, page
from imucal.report.json_file import load
from imucal.report.writer import write_report
from imucal.side_work import findings_or_why_not, try_side_work
from tests.cli.run import SAMPLE_LOGS, run
from tests.report.synthetic import small_report
from tests.screening.still import recording, still

#: Exceptions of side work and the resulting text; the last is a fault of the program.
FAILURES = [
    (DataError("too short, expected more", place="gyro_x"), "too short, expected more"),
    (FloatingPointError("overflow"), "the calculation failed (FloatingPointError: overflow)"),
    (np.linalg.LinAlgError("singular."), "the calculation failed (LinAlgError: singular)"),
    (
        KeyError("K"),
        "internal error (KeyError: 'K'); please report it, IMUCAL_DEBUG=1 shows where",
    ),
]


@pytest.fixture
def as_a_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """Report faults of the program as findings, as outside the tests."""
    monkeypatch.setattr(side_work, "faults_are_raised", lambda: False)


def _failing(error: Exception) -> Callable[..., NoReturn]:
    def fail(*_: object, **__: object) -> NoReturn:
        raise error

    return fail


def _one_axis() -> Recording:
    samples = np.random.default_rng(61).normal(size=3000)
    return Recording(
        source=Source(path="made.csv", format="csv"),
        series=(AxisSeries.from_samples(samples, rate_hz=100.0),),
    )


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(("error", "message"), FAILURES)
def test_a_failure_becomes_a_finding(error: Exception, message: str) -> None:
    """The finding has the code and the axis, and the default replaces the result."""
    result, (finding,) = try_side_work(_failing(error), 7, what="No picture", code="not-drawn", axis="gyro_x")
    assert result == 7
    assert (finding.level, finding.code, finding.axis) == ("warning", "not-drawn", "gyro_x")
    assert finding.text == f"No picture: {message}."
    assert findings_or_why_not(_failing(error), what="No picture", code="not-drawn", axis="gyro_x") == (
        finding,
    )


def test_a_success_is_returned_without_a_finding() -> None:
    assert try_side_work(lambda: 3, None, what="", code="") == (3, ())
    assert findings_or_why_not(tuple, what="", code="") == ()


@pytest.mark.parametrize("debug", [True, False])
def test_faults_are_raised_for_developers(monkeypatch: pytest.MonkeyPatch, *, debug: bool) -> None:
    """Developers set IMUCAL_DEBUG or run these tests; errors caused by data remain findings."""
    if debug:
        monkeypatch.undo()
        assert not side_work.faults_are_raised()
        monkeypatch.setenv("IMUCAL_DEBUG", "1")
    assert side_work.faults_are_raised()
    with pytest.raises(KeyError):
        try_side_work(_failing(KeyError("K")), None, what="", code="")
    assert try_side_work(_failing(ZeroDivisionError()), None, what="No", code="")[1]


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(("error", "message"), FAILURES)
def test_a_failed_second_opinion_keeps_the_fit(
    monkeypatch: pytest.MonkeyPatch, error: Exception, message: str
) -> None:
    """It may fail anywhere, and so may the check of the record length."""
    monkeypatch.setattr(pipeline, "second_opinion", _failing(error))
    monkeypatch.setattr(pipeline, "resolution_findings", _failing(error))
    (axis,) = characterize(_one_axis(), Settings(second_opinion=True)).axes
    assert axis.fit["N"].value == pytest.approx(0.1, rel=0.1)
    texts = {finding.code: finding.text for finding in axis.findings}
    assert texts["second-opinion"] == f"The fit of the Allan curve failed: {message}."
    assert texts["record-length"].startswith("The required record length is unknown: ")


_TABLES = ("_LOG_CHECKS", "_REST_CHECKS", "_AXIS_CHECKS")
_CHECKS = [(table, i) for table in _TABLES for i in range(len(getattr(screening, table)))]


@pytest.mark.usefixtures("as_a_user", "axes_are_screened_once")
@pytest.mark.parametrize(("table", "index"), _CHECKS)
def test_a_failed_check_does_not_prevent_the_others(
    monkeypatch: pytest.MonkeyPatch, table: str, index: int
) -> None:
    """The other checks still find the stuck axis."""
    gyro, accel = still(6000, 62)
    gyro[1] = 0.5
    checks = list(getattr(screening, table))
    failing = _failing(RuntimeError("no"))
    failing.__name__ = checks[index].__name__
    checks[index] = failing
    monkeypatch.setattr(screening, table, tuple(checks))
    found = screen(recording(gyro, accel))
    assert ("stuck", "gyro_y") in {(f.code, f.axis) for f in found}
    failed = [finding for finding in found if finding.code == "not-checked"]
    assert len(failed) == (5 if table == "_AXIS_CHECKS" else 1)
    words = failing.__name__.removeprefix("check_").replace("_", " ")
    assert failed[0].text.startswith(f"No check for {words}: internal error (RuntimeError: no); ")


@pytest.mark.usefixtures("as_a_user")
def test_an_axis_is_fitted_without_screening(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit does not need the profile that fails."""
    monkeypatch.setattr(screening, "measured", _failing(FloatingPointError("overflow")))
    (axis,) = characterize(_one_axis()).axes
    assert "N" in str(axis.fit.model)
    (finding,) = [f for f in axis.findings if f.code == "not-checked"]
    assert finding.text == (
        "The axis can't be screened: the calculation failed (FloatingPointError: overflow)."
    )


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(
    ("home", "name", "missing"),
    [(figure, "axis_figure", {"gyro_x.png"}), (page, "render_page", {"report.html"})],
)
def test_a_failed_picture_does_not_prevent_the_report(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, home: object, name: str, missing: set[str]
) -> None:
    """An old picture is removed; report.json and the caller get the finding."""
    complete = {path.name for path in write_report(small_report(), tmp_path / "out")}
    monkeypatch.setattr(home, name, _failing(ValueError("no canvas")))
    findings: list[str] = []
    files = write_report(
        small_report(), tmp_path / "out", on_finding=lambda finding: findings.append(finding.text)
    )
    assert complete - {path.name for path in files} == missing
    assert not any((tmp_path / "out" / name).exists() for name in missing)
    (finding,) = [f for f in load(tmp_path / "out").findings if f.code == "not-drawn"]
    assert findings == [finding.text]
    assert finding.text.startswith(
        f"{next(iter(missing))} was left out: internal error (ValueError: no canvas)"
    )


@pytest.mark.usefixtures("as_a_user")
def test_the_command_reports_the_missing_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is on standard error, with the table on standard output and exit code 0."""
    monkeypatch.setattr(figure, "sensor_figure", _failing(ArithmeticError("no ticks")))
    quick = ("--model", "N", "--format", "svg")
    done = run("fit", str(SAMPLE_LOGS / "too_short.db3"), "-o", "out", *quick, cwd=tmp_path)
    assert done.returncode == 0
    assert "warning [not-drawn]: gyro.svg was left out: the calculation failed" in done.stderr
    assert "ACCELEROMETER" in done.stdout
    assert (tmp_path / "out" / "gyro_x.svg").exists()
