"""Tests of manifests: labels and reading options of each log, and errors."""

from pathlib import Path

import pytest

from imucal.errors import ManifestError
from imucal.fleet.manifest import read_manifest


def test_labels_and_options_are_read(tmp_path: Path) -> None:
    """Numbers are converted, empty cells are omitted, other columns remain text, and URLs are unchanged."""
    file = tmp_path / "m.csv"
    file.write_text(
        "path,model,unit,temperature_c,started,rate_hz,gyro_unit,strict,topic,bench\n"
        "a.csv,bmi,007,-25,2026-01-31,200,deg/s,yes,/a /b,3\n"
        "s3://b/x.mcap,bmi,008,,,,,,,\n\n",
        encoding="utf-8-sig",
    )
    first, second = read_manifest(file)
    assert first.path == str(tmp_path / "a.csv")
    assert first.labels == {
        "model": "bmi",
        "unit": "007",
        "temperature_c": -25.0,
        "started": "2026-01-31",
        "bench": "3",
    }
    assert first.reading == {"rate_hz": 200.0, "gyro_unit": "deg/s", "strict": True, "topic": ["/a", "/b"]}
    assert (second.path, second.labels) == ("s3://b/x.mcap", {"model": "bmi", "unit": "008"})
    assert second.reading == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ":1: the headings are nothing; expected each once, and 'path' among them"),
        ("file,unit\na,b\n", ":1: the headings are file, unit; expected each once, and 'path' among them"),
        ("path,path\na,b\n", ":1: the headings are path, path; expected each once"),
        ("path,unit\na\n", ":2: 1 cells, expected 2 as in the headings"),
        ("path,unit\n,7\n", ":2: no path; expected the path of a log"),
        ("path\na\na\n", ":3: {folder}/a is duplicated; expected one row per log"),
        ("path,temperature_c\na,hot\n", ":2: column 'temperature_c' is 'hot', expected a number"),
        (
            "path,started\na,31.1.26\n",
            ":2: column 'started' is '31.1.26', expected a date",
        ),
        ("path,rate_hz\na,0\n", ":2: column 'rate_hz' is '0', expected a number above 0"),
        ("path,gyro_unit\na,g\n", ":2: column 'gyro_unit' is 'g', expected a unit of the gyroscope"),
        (
            "path,time_unit\na,week\n",
            ":2: column 'time_unit' is 'week', expected a unit such as s, ms, us, ns, min or 100ns",
        ),
        ("path,strict\na,maybe\n", ":2: column 'strict' is 'maybe', expected true or false"),
        ("path,skip_s\na,-1\n", ":2: column 'skip_s' is '-1', expected a time in s, 0 or more"),
        ("path,take_s\na,inf\n", ":2: column 'take_s' is 'inf', expected a number"),
    ],
)
def test_an_error_contains_its_line_and_the_expected_value(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "m.csv"
    file.write_text(text)
    with pytest.raises(ManifestError) as caught:
        read_manifest(file)
    assert str(caught.value).startswith(str(file) + message.format(folder=tmp_path))
    assert caught.value.exit_code == 2


def test_every_wrong_cell_is_named(tmp_path: Path) -> None:
    """Several in one row, in several rows, and the number of those that are not listed."""
    file = tmp_path / "m.csv"
    rows = ["a,hot,0,x", "b,20,100,y", "c,inf,1,z", "b,,,", "e,1"]
    file.write_text("path,temperature_c,rate_hz,unit\n" + "\n".join(rows))
    with pytest.raises(ManifestError) as caught:
        read_manifest(file)
    first = "column 'temperature_c' is 'hot', expected a number; column 'rate_hz' is '0', expected a number"
    assert str(caught.value).splitlines() == [
        f"{file}:2: {first} above 0",
        f"{file}:4: column 'temperature_c' is 'inf', expected a number",
        f"{file}:5: {tmp_path}/b is duplicated; expected one row per log",
        f"{file}:6: 2 cells, expected 4 as in the headings",
    ]
    file.write_text("path,rate_hz\n" + "\n".join(f"{row},0" for row in range(10)))
    with pytest.raises(ManifestError, match=r"m\.csv:9: .*\nand 2 more rows$"):
        read_manifest(file)


def test_a_binary_manifest_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "m.csv"
    file.write_bytes(b"PAR1\xff\xfe")
    with pytest.raises(ManifestError, match=r"m\.csv: can't be read"):
        read_manifest(file)
