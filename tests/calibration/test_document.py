"""calibration.json: the entries that other commands read, and errors for damaged files."""

import json
from pathlib import Path
from typing import Any

import pytest

import imucal
from imucal.calibration import Calibration
from imucal.calibration.document import from_document, load_intrinsics, to_document
from imucal.errors import ReadError
from tests.cli.run import SAMPLE_LOGS


@pytest.fixture(scope="module")
def found() -> Calibration:
    """Return the calibration of the sample log."""
    return imucal.calibrate(imucal.read(SAMPLE_LOGS / "poses.mcap"), latitude=47.4)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (
            "schema",
            "imucal/calibration/9",
            'the schema is "imucal/calibration/9", expected "imucal/calibration/1"',
        ),
        ("verdict", "fine", 'verdict: found "fine", expected "good" or "check" or "not-usable"'),
        ("frame", 1, 'frame: found 1, expected "kalibr" or "imu-tk" or "nearest"'),
        ("accelerometer.C", [1, 2, 3], "accelerometer.C[0]: found 1, expected a list"),
        ("accelerometer.b", [1, 2], "accelerometer.b: found [1, 2], expected a list of 3"),
        ("gyroscope.scaled", 1, "gyroscope.scaled: found 1, expected true or false"),
        ("gravity.value", None, "gravity.value: found null, expected a number"),
        (
            "accelerometer.parameters.scale_x.value",
            "2",
            'accelerometer.parameters.scale_x.value: found "2", expected a number',
        ),
        ("rests", [{}], "rests[0]: found no keys, expected the key 'mean_accel'"),
        ("turns", 3, "turns: found 3, expected a list"),
        (
            "findings",
            [{"level": "warning", "code": "x"}],
            "findings[0]: found level, code, expected the key 'text'",
        ),
    ],
)
def test_a_damaged_value_is_refused_at_its_place(
    found: Calibration, place: str, value: object, message: str
) -> None:
    document: Any = json.loads(json.dumps(to_document(found)))
    *keys, last = place.split(".")
    inner = document
    for key in keys:
        inner = inner[key]
    inner[last] = value
    with pytest.raises(ReadError) as caught:
        from_document(document, file="c.json")
    assert str(caught.value) == f"c.json: {message}; run 'imucal calibrate' again"


def test_parameters_may_be_missing(found: Calibration, tmp_path: Path) -> None:
    """A file of another program can be exported without them."""
    document: Any = json.loads(json.dumps(to_document(found)))
    document["accelerometer"]["parameters"] = document["gyroscope"]["parameters"] = {}
    (tmp_path / "calibration.json").write_text(json.dumps(document), encoding="utf-8")
    intrinsics = load_intrinsics(tmp_path)
    assert intrinsics.weak == ()
    assert intrinsics.si


def test_an_unreadable_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "calibration.json").write_text("{", encoding="utf-8")
    with pytest.raises(ReadError, match="can't be read") as caught:
        load_intrinsics(tmp_path)
    assert caught.value.place == str(tmp_path / "calibration.json")
