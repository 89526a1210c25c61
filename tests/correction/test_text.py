"""Tests of corrected text tables: all other cells and lines are equal, whatever their form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.correction.job import mark_file
from imucal.correction.rewriting import apply_to_log
from imucal.errors import DataError
from imucal.readers.read_options import ReadOptions
from tests.calibration.test_exports import FOUND
from tests.correction.test_containers import expected, values
from tests.raising import raises
from tests.readers.logs import samples

TRUTH = samples(120, seed=91)
NAMES = ["wx [rad/s]", "wy [rad/s]", "wz [rad/s]", "ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"]


def text(mark: str, *, end: str = "\n", decimal: str = ".", head: str = "", pad: str = "") -> str:
    """Return a table with a column of notes before and a counter behind the samples."""
    lines = [mark.join(["t [s]", "note", *NAMES, "last"])]
    for row, numbers in enumerate(TRUTH.all.tolist()):
        cells = [f"{row / 100:.2f}", f"n{row}", *(pad + repr(number) for number in numbers), f"{row}.50"]
        lines.append(mark.join(cells).replace(".", decimal))
    return head + end.join(lines) + end


@pytest.mark.parametrize(
    ("content", "mark"),
    [
        (text(","), ","),
        (text("\t", end="\r\n"), "\t"),
        (text(";", decimal=","), ";"),
        (text(",", head="# a comment\n# another, with a comma\n", pad=" "), ","),
    ],
)
def test_only_cells_of_the_imu_change(content: str, mark: str, tmp_path: Path) -> None:
    """Line ends, comments, blanks and decimal commas stay."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_bytes(content.encode())
    apply_to_log(FOUND, log, out, ReadOptions())
    np.testing.assert_allclose(values(out), expected(TRUTH), rtol=1e-12, atol=1e-13)
    before, after = log.read_bytes().splitlines(keepends=True), out.read_bytes().splitlines(keepends=True)
    assert len(before) == len(after)
    changed = 0
    for one, other in zip(before, after, strict=True):
        old, new = one.split(mark.encode()), other.split(mark.encode())
        if len(old) < 9 or b"rad/s" in one:
            assert one == other
            continue
        changed += 1
        assert [old[0], old[1], old[8]] == [new[0], new[1], new[8]]
        assert all(a != b for a, b in zip(old[2:8], new[2:8], strict=True))
    assert changed == 120


def test_rows_that_are_no_samples_stay(tmp_path: Path) -> None:
    """Also a cut last line and an empty one."""
    content = text(",")
    lines = content.splitlines(keepends=True)
    lines[50] = "something else\n"
    lines[60] = "\n"
    lines.append("1.2,n120,0.1,0.2")
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("".join(lines), encoding="utf-8")
    apply_to_log(FOUND, log, out, ReadOptions())
    found = out.read_text(encoding="utf-8").splitlines(keepends=True)
    assert [found[50], found[60], found[-1]] == [lines[50], lines[60], lines[-1]]


def test_degrees_and_g_stay_degrees_and_g(tmp_path: Path) -> None:
    """Corrected samples are in the units of the log."""
    columns = np.hstack([np.degrees(TRUTH.gyro), TRUTH.accel / 9.80665])
    rows = [f"{row / 100}," + ",".join(map(repr, numbers)) for row, numbers in enumerate(columns.tolist())]
    head = "t [s],gx [deg/s],gy [deg/s],gz [deg/s],ax [g],ay [g],az [g]"
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    apply_to_log(FOUND, log, out, ReadOptions())
    assert out.read_text(encoding="utf-8").startswith(head)
    assert imucal.read(out).source.values["gyroscope unit"] == "deg/s"
    np.testing.assert_allclose(values(out), expected(TRUTH), rtol=1e-12, atol=1e-13)


def test_counts_become_si(tmp_path: Path) -> None:
    """A calibration of counts has no count for its result."""
    counts = np.round(TRUTH.all * [1e4, 1e4, 1e4, 1e3, 1e3, 1e3])
    rows = [f"{row / 100}," + ",".join(f"{n:.0f}" for n in numbers) for row, numbers in enumerate(counts)]
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("\n".join(["t [s],gx,gy,gz,ax,ay,az", *rows]) + "\n", encoding="utf-8")
    assert FOUND.C_g is not None
    assert FOUND.b_g is not None
    assert FOUND.G is not None
    of_counts = replace(
        FOUND,
        said_si=False,
        C_a=FOUND.C_a / 1e3,
        b_a=FOUND.b_a * 1e3,
        C_g=FOUND.C_g / 1e4,
        b_g=FOUND.b_g * 1e4,
        G=FOUND.G * 1e4,
    )
    options = ReadOptions(gyro_scale=1.0, accel_scale=1.0)
    done = apply_to_log(of_counts, log, out, options)
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    rounded = replace(TRUTH, gyro=counts[:, :3] / 1e4, accel=counts[:, 3:] / 1e3)
    np.testing.assert_allclose(table[:, 1:], expected(rounded), rtol=1e-9, atol=1e-12)
    assert "counts-became-si" in {finding.code for finding in done.findings}
    with raises(DataError, "calibration poses.mcap is in SI units"):
        apply_to_log(FOUND, log, tmp_path / "other.csv", options)


def test_a_corrected_table_is_marked_by_a_file(tmp_path: Path) -> None:
    """A text has no place for a mark."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text(text(","), encoding="utf-8")
    apply_to_log(FOUND, log, out, ReadOptions())
    assert "calibration poses.mcap" in mark_file(out).read_text(encoding="utf-8")
    with raises(DataError, "already corrected"):
        apply_to_log(FOUND, out, tmp_path / "twice.csv", ReadOptions())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("quoted.csv", text(",").replace("n7,", '"n,7",')),
        ("log.jsonl", '{"t": 0.1, "gx": 1, "gy": 1, "gz": 1, "ax": 0, "ay": 0, "az": 9.8}\n' * 50),
    ],
)
def test_other_tables_are_refused(name: str, content: str, tmp_path: Path) -> None:
    """Their cells are not where the marks are."""
    (tmp_path / name).write_text(content, encoding="utf-8")
    options = ReadOptions(rate_hz=100.0, gyro_unit="rad/s", accel_unit="m/s^2")
    with raises(DataError, "no row per sample"):
        apply_to_log(FOUND, tmp_path / name, tmp_path / "out.csv", options)
    assert not (tmp_path / "out.csv").exists()
