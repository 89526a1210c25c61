"""The fields of errors, the sentence made from them, and how the command line prints them."""

import json
import pickle
from pathlib import Path

import pytest

from imucal import read
from imucal.errors import ChoiceError, DataError, Fix, MissingError, ReadError, joined
from tests.cli.run import run

RATE = Fix("give the sampling rate", "rate_hz", "HZ")
UNIT = Fix("give its unit", "gyro_unit", "UNIT")


def test_a_message_is_place_problem_and_fixes() -> None:
    """A problem of several lines ends with a table, so the fix starts a line."""
    assert str(DataError("no samples")) == "no samples"
    assert (
        str(DataError("no rate", place=Path("log.csv"), fix=RATE))
        == "log.csv: no rate; give the sampling rate"
    )
    fixes = [UNIT, Fix("correct the header"), Fix("", "columns", "TEXT"), RATE]
    assert str(ReadError("odd", fixes=fixes)) == (
        "odd; give its unit, correct the header, or give the sampling rate"
    )
    assert str(ReadError("found\n  a\n  b", fix=Fix("choose one"))) == "found\n  a\n  b\nchoose one"
    assert str(MissingError("no axis 'q'")) == "no axis 'q'"


def test_an_error_can_be_moved() -> None:
    """The class, the code and the fixes stay."""
    error = ReadError("cut off", place="/tmp/copy", fix=RATE, code="cut")  # noqa: S108 - only a name
    moved = error.at("https://host/log")
    assert (type(moved), moved.place, moved.code, moved.fixes) == (
        ReadError,
        "https://host/log",
        "cut",
        (RATE,),
    )
    assert error.place == "/tmp/copy"  # noqa: S108
    inner = DataError("no samples", place="topic /imu")
    assert inner.within("log").place == "log: topic /imu"
    assert inner.within("log").within("log").place == "log: topic /imu"
    assert DataError("no samples").within("log").place == "log"


def test_joined_errors_name_each_problem_once() -> None:
    """With the places within the common one; they survive pickling."""
    rate = ChoiceError("no rate", place="log", fix=RATE)
    unit = ChoiceError("no unit", place="log: topic /imu", fix=UNIT)
    both = joined("log", [rate, unit, rate])
    assert str(both) == "log: no rate; give the sampling rate; also, topic /imu: no unit; give its unit"
    assert [part.place for part in both.parts()] == ["log", "log: topic /imu"]
    assert [part.fixes for part in both.parts()] == [(RATE,), (UNIT,)]
    assert str(joined("log", [both, unit])) == str(both)
    assert str(pickle.loads(pickle.dumps(both))) == str(both)  # noqa: S301 - our own object
    assert str(both.at("url")).startswith("url: no rate; ")
    assert str(joined("log", [unit, rate])) == (
        "log: topic /imu: no unit; give its unit; also, no rate; give the sampling rate"
    )


@pytest.fixture
def counts(tmp_path: Path) -> Path:
    """Return a table of counts without time."""
    rows = "\n".join(f"{i % 7},{i % 5},{i % 3}" for i in range(300))
    path = tmp_path / "log.csv"
    path.write_text(f"gx,gy,gz\n{rows}\n", encoding="utf-8")
    return path


def test_a_reader_asks_for_arguments(counts: Path) -> None:
    """For all that is missing at once."""
    with pytest.raises(ChoiceError) as caught:
        read(counts)
    asked = [[fix.argument for fix in part.fixes] for part in caught.value.parts()]
    assert asked == [["rate_hz"], ["gyro_unit", "gyro_scale"]]
    assert caught.value.place == str(counts)


def test_json_has_the_fields_of_an_error(counts: Path) -> None:
    """The argument is spelled as an option."""
    done = run("fit", counts.name, "--no-report", "--json", cwd=counts.parent)
    error = json.loads(done.stdout)["error"]
    assert (error["type"], error["place"], error["exit_code"]) == ("ChoiceError", "log.csv", 3)
    assert error["fixes"] == [
        {"text": "give the sampling rate", "argument": "rate_hz", "value": "HZ", "option": "--rate HZ"}
    ]
    (unit,) = error["also"]
    assert [fix["option"] for fix in unit["fixes"]] == ["--gyro-unit UNIT", "--gyro-scale X"]
    assert unit["problem"].startswith("the unit of the gyroscope is unknown")


def test_a_file_of_times_alone_has_a_code(tmp_path: Path) -> None:
    """With a rate the file can be left out."""
    path = tmp_path / "times.csv"
    path.write_text("time\n" + "\n".join(f"{0.01 * i:.2f}" for i in range(50)) + "\n", encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert caught.value.code == "only-times"
    assert [fix.argument for fix in caught.value.fixes] == ["", "rate_hz"]
