"""No second opinion, screening or picture may cost a user the result."""

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from imucal import pipeline, processes, screening
from imucal.errors import DataError
from imucal.pipeline import Settings, characterize, screen
from imucal.processes import findings_or_why_not, try_side_work
from imucal.recording import AxisSeries, Recording, Source
from imucal.report import figure, html_page
from imucal.report.json_file import load
from imucal.report.writer import write_report
from tests.cli.run import SAMPLE_LOGS, run
from tests.report.synthetic import small_report
from tests.screening.still import recording, still

#: How side work may fail, and what is then said. The last is a fault of the program.
FAILURES = [
    (DataError("gyro_x: too short, expected more"), "too short, expected more"),
    (FloatingPointError("overflow"), "the calculation failed (FloatingPointError: overflow)"),
    (np.linalg.LinAlgError("singular."), "the calculation failed (LinAlgError: singular)"),
    (
        KeyError("K"),
        "internal error (KeyError: 'K'); please report it, IMUCAL_DEBUG=1 shows where",
    ),
]


@pytest.fixture
def as_a_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tell faults of the program, as outside the tests."""
    monkeypatch.setattr(processes, "faults_are_raised", lambda: False)


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
@pytest.mark.parametrize(("error", "said"), FAILURES)
def test_a_failure_becomes_a_finding(error: Exception, said: str) -> None:
    """In one sentence, with the code and the axis; what is made otherwise takes the result's place."""
    made, (finding,) = try_side_work(_failing(error), 7, what="No picture", code="not-drawn", axis="gyro_x")
    assert made == 7
    assert (finding.level, finding.code, finding.axis) == ("warning", "not-drawn", "gyro_x")
    assert finding.text == f"No picture: {said}."
    assert findings_or_why_not(_failing(error), what="No picture", code="not-drawn", axis="gyro_x") == (
        finding,
    )


def test_what_succeeds_is_returned_as_it_is() -> None:
    """Without a finding."""
    assert try_side_work(lambda: 3, None, what="", code="") == (3, ())
    assert findings_or_why_not(tuple, what="", code="") == ()


@pytest.mark.parametrize("debug", [True, False])
def test_faults_are_raised_where_someone_looks_for_them(
    monkeypatch: pytest.MonkeyPatch, *, debug: bool
) -> None:
    """With IMUCAL_DEBUG and in these tests; what data can do is a finding there too."""
    if debug:
        monkeypatch.undo()
        assert not processes.faults_are_raised()
        monkeypatch.setenv("IMUCAL_DEBUG", "1")
    assert processes.faults_are_raised()
    with pytest.raises(KeyError):
        try_side_work(_failing(KeyError("K")), None, what="", code="")
    assert try_side_work(_failing(ZeroDivisionError()), None, what="No", code="")[1]


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(("error", "said"), FAILURES)
def test_a_second_opinion_costs_no_result(
    monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    """Wherever in the fit of the curve it fails; nor does what a longer record would show."""
    monkeypatch.setattr(pipeline, "second_opinion", _failing(error))
    monkeypatch.setattr(pipeline, "resolution_findings", _failing(error))
    (axis,) = characterize(_one_axis(), Settings(second_opinion=True)).axes
    assert axis.fit["N"].value == pytest.approx(0.1, rel=0.1)
    texts = {finding.code: finding.text for finding in axis.findings}
    assert texts["second-opinion"] == f"The fit of the Allan curve failed: {said}."
    assert texts["record-length"].startswith("The required record length is unknown: ")


_TABLES = ("_LOG_CHECKS", "_REST_CHECKS", "_AXIS_CHECKS")
_CHECKS = [(table, i) for table in _TABLES for i in range(len(getattr(screening, table)))]


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(("table", "index"), _CHECKS)
def test_a_check_that_fails_leaves_the_others(
    monkeypatch: pytest.MonkeyPatch, table: str, index: int
) -> None:
    """Each in turn: the others still see that a table was knocked, or an axis is stuck."""
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
def test_an_axis_that_can_not_be_screened_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its profile fails; the fit does not need it."""
    monkeypatch.setattr(screening, "profile", _failing(FloatingPointError("overflow")))
    (axis,) = characterize(_one_axis()).axes
    assert "N" in str(axis.fit.model)
    (finding,) = [f for f in axis.findings if f.code == "not-checked"]
    assert finding.text == (
        "The axis can't be screened: the calculation failed (FloatingPointError: overflow)."
    )


@pytest.mark.usefixtures("as_a_user")
@pytest.mark.parametrize(
    ("home", "name", "missing"),
    [(figure, "axis_figure", {"gyro_x.png"}), (html_page, "render_page", {"report.html"})],
)
def test_a_picture_that_fails_costs_no_report(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, home: object, name: str, missing: set[str]
) -> None:
    """It is left out, also in the place of an old one; report.json and the caller get the finding."""
    whole = {path.name for path in write_report(small_report(), tmp_path / "out")}
    monkeypatch.setattr(home, name, _failing(ValueError("no canvas")))
    findings: list[str] = []
    files = write_report(
        small_report(), tmp_path / "out", on_finding=lambda finding: findings.append(finding.text)
    )
    assert whole - {path.name for path in files} == missing
    assert not any((tmp_path / "out" / name).exists() for name in missing)
    (finding,) = [f for f in load(tmp_path / "out").findings if f.code == "not-drawn"]
    assert findings == [finding.text]
    assert finding.text.startswith(
        f"{next(iter(missing))} was left out: internal error (ValueError: no canvas)"
    )


@pytest.mark.usefixtures("as_a_user")
def test_the_command_names_the_missing_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """On standard error; the table is there, and exit code 0."""
    monkeypatch.setattr(figure, "sensor_figure", _failing(ArithmeticError("no ticks")))
    done = run("fit", str(SAMPLE_LOGS / "too_short.db3"), "-o", "out", cwd=tmp_path)
    assert done.returncode == 0
    assert "warning [not-drawn]: gyro.png was left out: the calculation failed" in done.stderr
    assert "ACCELEROMETER" in done.stdout
    assert (tmp_path / "out" / "gyro_x.png").exists()
