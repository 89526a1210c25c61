"""Dates and times of day in the formats of people, spreadsheets and loggers."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imucal.readers import read
from imucal.readers.tables.dates import NO_STAMP, day_first, parse_texts, text_kind
from tests.readers.tables.texts import N, lines, truth, xyz

SI = "gx (rad/s),gy (rad/s),gz (rad/s)"
#: One second before noon, on a day that can't be a month, and on one that can.
LATE = datetime(2026, 11, 22, 11, 59, 59, tzinfo=UTC)
EARLY = datetime(2026, 3, 4, 23, 59, 59, tzinfo=UTC)


def ns(moment: datetime) -> int:
    return int(moment.timestamp()) * 10**9


def us(moment: datetime) -> str:
    return moment.strftime("%m/%d/%Y %I:%M:%S.%f %p")


SPELLINGS: dict[str, Callable[[datetime], str]] = {
    "US, half days": us,
    "US, small letters with points": lambda t: us(t).replace("AM", "a.m.").replace("PM", "p.m."),
    "US, 24 hours": lambda t: t.strftime("%m/%d/%Y %H:%M:%S.%f"),
    "US, dashes": lambda t: t.strftime("%m-%d-%Y %H:%M:%S.%f"),
    "US, no zeros": lambda t: f"{t.month}/{t.day}/{t.year} {t.hour}:{t:%M:%S.%f}",
    "points": lambda t: t.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "MATLAB": lambda t: t.strftime("%d-%b-%Y %H:%M:%S.%f"),
    "ISO": lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
}


@pytest.mark.parametrize("start", [LATE, EARLY], ids=["noon", "midnight"])
@pytest.mark.parametrize("spelling", SPELLINGS)
def test_each_date_format_gives_start_and_rate(spelling: str, start: datetime, tmp_path: Path) -> None:
    """Logs that pass midnight are correct too."""
    stamps = [SPELLINGS[spelling](start + timedelta(milliseconds=10 * i)) for i in range(N)]
    path = tmp_path / "log.csv"
    path.write_text(lines(f"date,{SI}", stamps, *xyz(truth().gyro)), encoding="utf-8")
    clock = read(path).series[0].clock
    assert clock.start_ns == ns(start)
    assert clock.rate_hz == pytest.approx(100)
    assert not clock.gaps


def test_a_number_above_12_is_the_day(tmp_path: Path) -> None:
    """Without such a number the month is assumed to come first, and a finding reports that."""
    stamps = [(LATE + timedelta(milliseconds=10 * i)).strftime("%d/%m/%Y %H:%M:%S.%f") for i in range(N)]
    path = tmp_path / "log.csv"
    path.write_text(lines(f"date,{SI}", stamps, *xyz(truth().gyro)), encoding="utf-8")
    assert read(path).series[0].clock.start_ns == ns(LATE)
    stamps = [us(EARLY + timedelta(milliseconds=10 * i)) for i in range(N)]
    path.write_text(lines(f"date,{SI}", stamps, *xyz(truth().gyro)), encoding="utf-8")
    decisions = dict(read(path).source.decisions)
    assert decisions["time"] == "column date, date and time, read as month, day, year"
    assert day_first(["1/13/2026"]) is False
    assert day_first(["1/2/2026"]) is None
    assert day_first(["13/1/2026"]) is True
    assert day_first(["1.2.2026"]) is True
    assert day_first(["2026/13/1"]) is False


MARKS = (" ", ",", "\t", ";")
#: Delimiter, names of date, time and AM or PM, and whether AM or PM exists. Only blanks split a column that
#: has a single name.
SPLIT = [
    *((mark, names, half) for mark in MARKS for names, half in (("", False), ("", True))),
    *((mark, names, len(names.split()) == 3) for mark in MARKS for names in ("date time", "date time half")),
    *((" ", names, True) for names in ("time", "stamp half")),
    (" ", "time", False),
]


@pytest.mark.parametrize(("mark", "names", "half"), SPLIT)
def test_date_and_time_in_separate_columns_are_joined(
    mark: str,
    names: str,
    half: bool,  # noqa: FBT001 - a parameter of the case
    tmp_path: Path,
) -> None:
    """Blanks separate date, time, and AM or PM; one name can stand for all of them."""
    cells = 3 if half else 2
    form = "%m/%d/%Y %I:%M:%S.%f %p" if half else "%Y-%m-%d %H:%M:%S.%f"
    moments = [LATE + timedelta(milliseconds=10 * i) for i in range(N)]
    columns = [[t.strftime(form).split()[i] for t in moments] for i in range(cells)]
    header = mark.join([*names.split(), "gx_rads", "gy_rads", "gz_rads"]) if names else ""
    path = tmp_path / "log.txt"
    path.write_text(lines(header, *columns, *xyz(truth().gyro), mark=mark), encoding="utf-8")
    place = "+".join(map(str, range(cells)))
    asked = f"t={place},g={cells}:{cells + 3}" if not names else None
    recording = read(path, columns=asked, gyro_unit="rad/s")
    clock = recording.series[0].clock
    assert clock.start_ns == ns(LATE)
    assert clock.rate_hz == pytest.approx(100)
    assert not clock.gaps
    np.testing.assert_allclose(recording.series[2].samples, truth().gyro[:, 2])


@pytest.mark.parametrize(
    ("cells", "kind"),
    [
        (["2026-11-22", ""], "date"),
        (["22-Nov-2026"], "date"),
        (["AM", "p.m."], "half"),
        (["2026-11-22 10:00:00"], "stamp"),
        (["2026-11-22", "x"], "stamp"),
        ([], "stamp"),
    ],
)
def test_all_filled_cells_of_a_column_have_one_kind(cells: list[str], kind: str) -> None:
    assert text_kind(cells) == kind


@pytest.mark.parametrize(
    "cell",
    [
        "13/13/2026 10:00:00",
        "22-Foo-2026 10:00:00",
        "9026-01-02 10:00:00",
        "0026-01-02 10:00:00",
        "10:00",
        "",
        "x",
    ],
)
def test_other_texts_are_not_times(cell: str) -> None:
    assert parse_texts([cell]).tolist() == [NO_STAMP]
    assert parse_texts([cell], "date").tolist() == [NO_STAMP]
    assert parse_texts([cell], "half").tolist() == [NO_STAMP]
