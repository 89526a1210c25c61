"""A text dialect needs a table entry, an example and a word in the manual; missing parts are reported."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError
from imucal.readers.candidates import Candidate
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables import dialects
from imucal.readers.tables.dialects import DIALECTS, Dialect
from imucal.readers.tables.names import Role, parse_column
from imucal.readers.tables.text_table import open_log
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS
from tests.raising import raises
from tests.readers.tables.texts import STYLES, Style, Truth, lines, stamps, truth, write, xyz

MANUAL = Path(__file__).parents[3] / "docs" / "formats.md"


def forgotten(
    dialect: Dialect, folder: Path, styles: Sequence[Style] = STYLES, manual: str | None = None
) -> list[str]:
    """Return a sentence for each part that an entry of `DIALECTS` lacks."""
    missing = [*_wrong_units(dialect), *_wrong_names(dialect), *_without_example(dialect, folder, styles)]
    known = (manual or MANUAL.read_text(encoding="utf-8")).partition("## Tables")[2].partition("## Units")[0]
    if not re.search(rf"\b{re.escape(dialect.name)}\b", known):
        missing.append("docs/formats.md does not name it: add it to the headers listed under Tables")
    return [f"{dialect.name}: {sentence}" for sentence in missing]


def _wrong_units(dialect: Dialect) -> list[str]:
    missing = []
    if dialect.gyro_unit is None:
        missing.append("no gyro_unit: no sample tells a gyroscope's unit, so take it from the maker's manual")
    given = ((Sensor.GYROSCOPE, dialect.gyro_unit), (Sensor.ACCELEROMETER, dialect.accel_unit))
    for sensor, unit in given:
        if unit is not None and unit not in SAMPLE_UNITS[sensor]:
            known = ", ".join(SAMPLE_UNITS[sensor])
            missing.append(f"{unit!r} is not a unit of the {sensor}: write one of {known}")
    return missing


def _wrong_names(dialect: Dialect) -> list[str]:
    missing = []
    if not dialect.headers:
        missing.append("no headers: it would be found in every table")
    names = (*dialect.headers, *(name for name, _ in dialect.time_ns))
    missing += [
        f"{name!r} has a capital letter: names are compared in small letters"
        for name in names
        if re.search(r"(?<!\\)[A-Z]", name)
    ]
    return missing


def _without_example(dialect: Dialect, folder: Path, styles: Sequence[Style]) -> list[str]:
    """Read the examples of a dialect: one must show the entry, and each of its sensors must be found."""
    examples = [s for s in styles if s.layout == dialect.name and not s.file.endswith(".zip")]
    if not examples:
        example = f"Style(layout={dialect.name!r})"
        return [f"no example: add a {example} to STYLES in tests/readers/tables/texts.py"]
    taken = []
    for style in examples:
        given: dict[str, Any] = dict(style.options)
        options = ReadOptions(**given)
        with open_log(write(style, folder), options) as log:
            (table,) = log.tables
            names = [column.name for column in table.columns]
            teach = f"{_strange(names)} name none; teach them to imucal/readers/tables/names.py"
            try:
                plan = Candidate(table, options).plan
            except ChoiceError as error:
                return [f"no sensor is found in its example {style.name!r}: {teach} ({error})"]
        found = plan.dialect
        if found is dialect:
            read_of = {sensor.triad.sensor for sensor in plan.sensors}
            held = {Sensor.GYROSCOPE: style.gyro, Sensor.ACCELEROMETER: style.accel}
            return [
                f"no {sensor} is found in its example {style.name!r}: {teach}"
                for sensor, there in held.items()
                if there and sensor not in read_of
            ]
        taken.append(f"{style.name!r} shows {found.headers if found else 'no dialect'}")
    sentence = (
        f"no example shows this entry with headers {dialect.headers} ({'; '.join(taken)}): "
        "add one, correct the headers, or put the entry before the one that is found"
    )
    return [sentence]


def _strange(names: Sequence[str]) -> str:
    """Return the names that have an axis but no known sensor."""
    columns = [parse_column(name, i) for i, name in enumerate(names)]
    return ", ".join(c.header for c in columns if c.axis is not None and c.role is Role.OTHER)


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda dialect: dialect.name)
def test_a_dialect_is_complete(dialect: Dialect, tmp_path: Path) -> None:
    """Each entry has units, an example and its word in the manual."""
    assert forgotten(dialect, tmp_path) == []


def _acme_text(true: Truth) -> str:
    header = "time_ms," + ",".join(f"{kind}_{axis}" for kind in ("turn_gyro", "push_accel") for axis in "xyz")
    return lines(header, stamps(true, 10**6), *xyz(true.deg), *xyz(true.g))


ACME = Dialect(name="Acme", headers=("turn_gyro_x", "push_accel_x"), gyro_unit="deg/s", accel_unit="g")
EXAMPLE = Style(name="Acme logger", build=_acme_text, layout="Acme")
WORDS = "## Tables\nHeaders of Acme and others are known.\n## Units"


def test_a_table_entry_and_an_example_define_a_dialect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The units are known without further changes."""
    path = write(EXAMPLE, tmp_path)
    with raises(ChoiceError, "gyroscope is unknown", argument="gyro_unit"):
        read(path, ReadOptions())
    monkeypatch.setattr(dialects, "DIALECTS", (*DIALECTS, ACME))
    assert forgotten(ACME, tmp_path, (*STYLES, EXAMPLE), WORDS) == []
    recording = read(path, ReadOptions())
    npt.assert_allclose(recording.axis("gyroscope", "x").samples, truth().gyro[:, 0], rtol=1e-12)
    npt.assert_allclose(recording.axis("accelerometer", "z").samples, truth().accel[:, 2], rtol=1e-12)
    assert dict(recording.source.decisions)["gyroscope unit"] == "deg/s, as in logs of Acme"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"gyro_unit": None},
            "no gyro_unit: no sample tells a gyroscope's unit, so take it from the maker's",
        ),
        ({"accel_unit": "G"}, "'G' is not a unit of the accelerometer: write one of m/s^2, g, mg, ug"),
        ({"headers": ()}, "no headers: it would be found in every table"),
        ({"headers": ("Turn_Gyro_X",)}, "'Turn_Gyro_X' has a capital letter: names are compared in small"),
        ({"headers": ("turn_x",)}, "no example shows this entry with headers ('turn_x',)"),
        ({"name": "Apex"}, "no example: add a Style(layout='Apex') to STYLES in tests/readers/tables"),
        ({"name": "Apex"}, "docs/formats.md does not name it: add it to the headers listed under Tables"),
    ],
)
def test_missing_parts_of_a_dialect_are_reported(
    change: dict[str, Any], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sentence explains what to do."""
    broken = replace(ACME, **change)
    monkeypatch.setattr(dialects, "DIALECTS", (*DIALECTS, broken))
    found = forgotten(broken, tmp_path, (*STYLES, EXAMPLE), WORDS)
    assert any(each.startswith(f"{broken.name}: {sentence}") for each in found), found


def test_an_unrecognised_sensor_of_a_dialect_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sensor in the example of a dialect must be read."""
    half = replace(ACME, headers=("turn_gyro_x", "push_x"))
    example = replace(EXAMPLE, build=lambda true: _acme_text(true).replace("push_accel", "push"))
    monkeypatch.setattr(dialects, "DIALECTS", (*DIALECTS, half))
    sentence = (
        "Acme: no accelerometer is found in its example 'Acme logger': push_x, push_y, push_z name none; "
        "teach them to imucal/readers/tables/names.py"
    )
    assert forgotten(half, tmp_path, (*STYLES, example), WORDS) == [sentence]
    alone = replace(example, accel=False)
    assert forgotten(half, tmp_path, (*STYLES, alone), WORDS) == []


def test_an_unknown_word_for_a_sensor_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence contains the column names and the module to extend."""
    strange = replace(ACME, headers=("twirl_x",))
    example = replace(EXAMPLE, build=lambda true: re.sub("turn_gyro|push_accel", "twirl", _acme_text(true)))
    monkeypatch.setattr(dialects, "DIALECTS", (*DIALECTS, strange))
    (found,) = forgotten(strange, tmp_path, (*STYLES, example), WORDS)
    assert found.startswith(
        "Acme: no sensor is found in its example 'Acme logger': twirl_x, twirl_y, twirl_z, twirl_x, "
        "twirl_y, twirl_z name none; teach them to imucal/readers/tables/names.py ("
    )
