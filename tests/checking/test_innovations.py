"""The mean of normalised innovations has chi-square limits that cover the truth."""

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from imucal.arrays import FloatArray
from imucal.checking.innovations import are_innovations, check_innovations, mean_with_limits
from imucal.checking.verdict import Row
from imucal.errors import LimitsError
from tests.cli.run import run


def innovations(
    number: int, dimension: int, rng: np.random.Generator, *, factor: float = 1.0, correlation: float = 0.0
) -> FloatArray:
    """Return the NIS of innovations whose deviation is `factor` times that of the filter; AR(1)."""
    white = rng.normal(size=(number, dimension))
    white[1:] *= np.sqrt(1 - correlation**2)
    values = signal.lfilter([1.0], [1.0, -correlation], white, axis=0)
    return np.asarray(np.sum((factor * values) ** 2, axis=1))


def rows(file: Path, **columns: FloatArray) -> dict[str, Row]:
    table = np.column_stack(list(columns.values()))
    np.savetxt(file, table, delimiter=",", header=",".join(columns), comments="")
    return {row.where: row for row in check_innovations(file).rows}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "innovations.csv"


@pytest.mark.parametrize(
    ("number", "dimension", "correlation"), [(60, 1, 0.0), (400, 3, 0.0), (2000, 2, 0.5), (4000, 1, 0.9)]
)
def test_the_limits_cover_the_truth(number: int, dimension: int, correlation: float) -> None:
    """300 filters each; a nominal 95 % may miss 9 %."""
    rng = np.random.default_rng(60_310)
    hits = 0
    for _ in range(300):
        nis = innovations(number, dimension, rng, factor=1.3, correlation=correlation)
        _, low, high = mean_with_limits(nis, np.full(number, float(dimension)))
        hits += low <= 1.3**2 <= high
    assert hits / 300 > 0.91


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [(1.0, "pass"), (1.4, "pass"), (3.0, "fail"), (1 / 3, "undecided"), (1 / 50, "fail")],
)
def test_the_verdict_is_on_the_standard_deviation(file: Path, factor: float, verdict: str) -> None:
    rng = np.random.default_rng(60_311)
    nis = innovations(2000, 3, rng, factor=factor)
    row = rows(file, time=np.arange(2000.0), nis=nis, dof=np.full(2000, 3.0))["nis"]
    assert row.verdict == verdict
    assert row.measured is not None
    assert row.measured.value == pytest.approx(factor**2, rel=0.05)


def test_few_innovations_are_undecided_near_the_limit(file: Path) -> None:
    nis = innovations(40, 1, np.random.default_rng(60_312), factor=2.0)
    row = rows(file, nis=nis, dof=np.ones(40))["nis"]
    assert row.verdict == "undecided"
    assert "log for longer" in row.found


def test_correlated_innovations_are_named(file: Path) -> None:
    nis = innovations(3000, 1, np.random.default_rng(60_313), correlation=0.9)
    row = rows(file, nis=nis, dof=np.ones(3000))["nis"]
    assert row.verdict == "undecided"
    assert "not white" in row.found


def test_each_column_has_its_row_and_cells_without_number_are_left_out(file: Path) -> None:
    rng = np.random.default_rng(60_314)
    gps, mag = innovations(500, 3, rng), innovations(500, 3, rng, factor=4.0)
    gps[::2] = np.nan
    found = rows(file, gps_nis=gps, nis_mag=mag, nis_dof=np.full(500, 3.0))
    assert {where: row.verdict for where, row in found.items()} == {"gps_nis": "pass", "nis_mag": "fail"}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("nis\n" + "1\n" * 50, "no column 'dof'"),
        ("nis,dof\n" + "1,1\n" * 5, "has 5 numbers"),
        ("nis,dof\n" + "-1,1\n" * 50, "negative"),
        ("nis,dof\n1,1\n2\n", "line 3 has 1 cells"),
        ("nis,dof\n", "has 0 numbers"),
        ("nis,dof\n" + "x,1\n" * 50, "has 0 numbers"),
    ],
)
def test_wrong_files_are_refused(file: Path, text: str, problem: str) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LimitsError, match=problem):
        check_innovations(file)


def test_other_files_are_not_taken_for_innovations(tmp_path: Path) -> None:
    for number, head in enumerate([b"time,gx,gy,gz\n", b"tennis,dof\n", b"\xff\xfe", b"", b"nis_dof,a\n"]):
        file = tmp_path / f"{number}.csv"
        file.write_bytes(head)
        assert not are_innovations(file)


def test_the_command_takes_the_number_of_components(file: Path) -> None:
    nis = innovations(500, 2, np.random.default_rng(60_315))
    np.savetxt(file, nis, header="Normalized Innovation Squared", comments="")
    refused = run("check", file.name, cwd=file.parent)
    assert refused.returncode == 2
    assert "--dof 3" in refused.stderr
    good = run("check", file.name, "--dof", "2", cwd=file.parent)
    assert good.returncode == 0
    assert "expected 1" in good.stdout
    assert run("check", file.name, "--dof", "9", "--undecided", "fail", cwd=file.parent).returncode == 1
    assert run("check", file.name, "--dof", "2", "--rate", "5", cwd=file.parent).returncode == 2
    assert run("check", file.name, "--limits", file.name, cwd=file.parent).returncode == 2
