"""The remedies in error messages work on the file that caused the error."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ChoiceError, ImucalError
from imucal.readers import read
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.tables.texts import N, lines, truth, xyz

SI = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"
PLAIN = SI.replace(" (rad/s)", "").replace(" (m/s^2)", "")
UNITS: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def sensors() -> list[list[str]]:
    return [*xyz(truth().gyro), *xyz(truth().accel)]


def refused(path: Path, **options: Any) -> str:  # noqa: ANN401 - options of any kind
    """Return the error message of a log that can't be read without options."""
    with pytest.raises(ChoiceError) as caught:
        read(path, **options)
    return str(caught.value)


def problems(path: Path, **options: Any) -> tuple[ImucalError, ...]:  # noqa: ANN401 - options of any kind
    """Return the errors of everything that a log needs to be read."""
    with pytest.raises(ChoiceError) as caught:
        read(path, **options)
    return caught.value.parts()


def is_truth(recording: Recording) -> None:
    """Check that each axis has the samples that were written."""
    for sensor, values in (("gyroscope", truth().gyro), ("accelerometer", truth().accel)):
        for index, axis in enumerate("xyz"):
            samples = recording.axis(sensor, axis).samples
            np.testing.assert_allclose(samples, values[:, index], rtol=1e-12)


@pytest.mark.parametrize(
    ("step", "name"),
    [
        *((step, "time") for step in (100, 1000, 1, 20, 2, 1e-5, 5e-6, 3e4, 5e11)),
        *((step, name) for step in (100, 2, 5e-6) for name in ("Timestamp", "t")),
    ],
)
def test_each_proposed_time_unit_gives_the_reported_rate(step: float, name: str, tmp_path: Path) -> None:
    """The option, the unit in the header and the rate have the same effect."""
    path = tmp_path / "log.csv"
    times = [step * i for i in range(N)]
    path.write_text(lines(f"{name},{SI}", times, *sensors()), encoding="utf-8")
    for unit, ns in (("s", 1e9), ("ms", 1e6), ("us", 1e3), ("ns", 1)):
        rate = 1e9 / (step * ns)
        if not 1e-6 < rate < 1e7:
            continue
        recording = read(path, time_unit=unit)
        is_truth(recording)
        assert recording.series[0].rate_hz == pytest.approx(rate, rel=1e-3)
    if step in {2, 20, 3e4}:
        # Only one unit gives the rate of an IMU.
        assert 1 <= read(path).series[0].rate_hz <= 20_000
        return
    message = refused(path)
    proposals = re.findall(r"([\d.e+-]+) Hz in (s|ms|us|ns)\b", message)
    assert 1 <= len(proposals) <= 3
    for rate, unit in proposals:
        assert read(path, time_unit=unit).series[0].rate_hz == pytest.approx(float(rate), rel=1e-3)
        assert read(path, rate_hz=float(rate)).series[0].rate_hz == pytest.approx(float(rate), rel=1e-3)
    column = re.search(r"such as (\w+),", message)
    # A header is proposed for plausible rates; an unusual rate must be given as an option.
    assert (column is None) == all(not 1 <= float(rate) <= 20_000 for rate, _ in proposals)
    if column is None:
        return
    named = tmp_path / "named.csv"
    named.write_text(path.read_text(encoding="utf-8").replace(name, column[1], 1), encoding="utf-8")
    is_truth(read(named))


def test_a_given_rate_that_fits_no_unit_replaces_the_time(tmp_path: Path) -> None:
    """A finding reports that the time column is unused."""
    path = tmp_path / "log.csv"
    path.write_text(lines(f"time,{SI}", [100 * i for i in range(N)], *sensors()), encoding="utf-8")
    recording = read(path, rate_hz=123.0)
    assert recording.series[0].rate_hz == 123.0
    assert [finding.code for finding in recording.findings] == ["time-unused"]
    is_truth(recording)


def test_a_time_unit_for_a_date_is_refused(tmp_path: Path) -> None:
    """A date has no unit. Unknown units are refused too."""
    path = tmp_path / "log.csv"
    stamps = [f"2026-11-22 10:00:{i // 10:02d}.{i % 10}" for i in range(N)]
    path.write_text(lines(f"time,{SI}", stamps, *sensors()), encoding="utf-8")
    assert "the time unit ms does not apply: the gyroscope has the time time" in refused(path, time_unit="ms")
    with raises(ChoiceError, "'week'", place="log.csv", argument="time_unit"):
        read(path, time_unit="week")
    is_truth(read(path))


#: Header, order of the columns, options of writing, and the columns text.
TABLES: dict[str, tuple[str, Callable[..., list[Any]], dict[str, Any], str]] = {
    "no header": ("", lambda t, g, a: [t, *a, *g], {}, "t=0,g=4:7,a=1:4"),
    "no header, blanks": ("", lambda t, g, a: [t, *g, *a], {"mark": " "}, "t=0,g=1:4,a=4:7"),
    "no header, no time": ("", lambda _t, g, a: [*g, *a], {}, "g=0:3,a=3:6"),
    "names that say nothing": ("foo,a1,b2,c3,d4,e5,f6", lambda t, g, a: [t, *g, *a], {}, "t=0,g=1:4,a=4:7"),
    "names of the time only": (
        "c1,c2,c3,time (s),c4,c5,c6",
        lambda t, g, a: [*g, t, *a],
        {},
        "t=3,g=0:3,a=4:7",
    ),
    "too few names": ("time,gx,gy,gz,ax,ay", lambda t, g, a: [t, *g, *a], {}, "t=0,g=1:4,a=4:7"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_columns_text_of_the_listed_columns_works(name: str, tmp_path: Path) -> None:
    """The error lists names or first values, and the form of a columns text."""
    header, order, options, columns = TABLES[name]
    path = tmp_path / "log.csv"
    t, (gx, gy, gz, ax, ay, az) = [f"{0.01 * i:.2f}" for i in range(N)], sensors()
    path.write_text(lines(header, *order(t, (gx, gy, gz), (ax, ay, az)), **options), encoding="utf-8")
    message = refused(path)
    first = header.split(",")[2] if name.startswith("names") else f"{truth().gyro[0, 1]:.6g}"
    assert re.search(r"\b2 (\S+ )?= [^,]+, ", message)
    assert f" {first}" in message
    assert f"in a columns text {FORM}" in message
    is_truth(read(path, columns=columns, rate_hz=None if "t=" in columns else 100.0, **UNITS))


FORM = "of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"


def proposed(message: str) -> str:
    """Return the columns text that a message proposes."""
    match = re.search(r"in a columns text such as (\S+) \(numbers", message)
    assert match is not None, message
    return match[1]


def test_the_columns_text_of_a_log_of_one_axis_works(tmp_path: Path) -> None:
    """The error proposes a form with one axis."""
    path = tmp_path / "log.csv"
    path.write_text(lines("", [f"{0.01 * i:.2f}" for i in range(N)], sensors()[2]), encoding="utf-8")
    assert "in a columns text of the form t=TIME,gz=Z (names" in refused(path)
    recording = read(path, columns="t=0,gz=1", gyro_unit="rad/s")
    np.testing.assert_array_equal(recording.axis("gyroscope", "z").samples, truth().gyro[:, 2])


@pytest.mark.parametrize("wrong", ["g=1:3", "g=gx+gy+gq", "t=0", "gyro=1:4", "g=4:9,a=0", "g=1:4,a=90:93"])
def test_a_correct_columns_text_is_proposed_for_a_wrong_one(wrong: str, tmp_path: Path) -> None:
    """The proposal uses the columns with recognised names."""
    path = tmp_path / "log.csv"
    t = [f"{0.01 * i:.2f}" for i in range(N)]
    path.write_text(lines(f"time (s),{PLAIN}", t, *sensors()), encoding="utf-8")
    message = refused(path, columns=wrong) if wrong != "gyro=1:4" else ""
    columns = proposed(message) if message else "t=0,g=1:4,a=4:7"
    assert columns == "t=0,g=1:4,a=4:7"
    is_truth(read(path, columns=columns, **UNITS))


def test_a_table_without_three_numbers_gets_no_suggestion(tmp_path: Path) -> None:
    """An example that can't work would mislead."""
    path = tmp_path / "log.csv"
    path.write_text(lines("time,lat,lon,alt", list(range(N)), *xyz(truth().gyro)), encoding="utf-8")
    assert "in a columns text of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names" in refused(path)


@pytest.mark.parametrize(
    "shape", ["n23", "2n3", "1n6", "n6", "6n", "n7"], ids=lambda shape: f"array of {shape}"
)
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_the_error_contains_the_shape_of_an_array(shape: str, suffix: str, tmp_path: Path) -> None:
    """The error also contains the form of a columns text."""
    both = np.stack([truth().gyro, truth().accel], axis=1)
    flat = both.reshape(-1, 6)
    array = {
        "n23": both,
        "2n3": both.swapaxes(0, 1),
        "1n6": flat[None],
        "n6": flat,
        "6n": flat.T,
        "n7": np.column_stack([0.01 * np.arange(N), flat]),
    }[shape]
    path = tmp_path / f"log{suffix}"
    if suffix == ".npy":
        np.save(path, array)
    else:
        np.savez(path, imu=array)
    message = refused(path)
    assert str(array.shape) in message
    assert FORM in message
    columns = "t=0,g=1:4,a=4:7" if shape == "n7" else "g=0:3,a=3:6"
    is_truth(read(path, columns=columns, rate_hz=None if "t=" in columns else 100.0, gyro_unit="rad/s"))


def test_an_array_that_is_too_wide_is_refused(tmp_path: Path) -> None:
    """The error asks the user to save only the sensor columns."""
    flat = np.column_stack([truth().gyro, truth().accel])
    wide = np.column_stack([flat, np.zeros((N, 70))])
    path = tmp_path / "log.npy"
    np.save(path, wide)
    with pytest.raises(Exception, match=r"found array \(400, 76\).*save only those columns"):
        read(path)
    np.save(path, wide[:, :6])
    assert FORM in refused(path)
    is_truth(read(path, columns="g=0:3,a=3:6", rate_hz=100.0, gyro_unit="rad/s"))


@pytest.mark.parametrize("write", ["csv", "npy", "jsonl"])
def test_one_refusal_lists_everything_missing(write: str, tmp_path: Path) -> None:
    """The error lists columns first, then rate and unit. With all of them given, the log is read."""
    path = tmp_path / f"log.{write}"
    both = np.column_stack([truth().deg, truth().g])
    if write == "csv":
        path.write_text(lines("", *both.T.tolist()), encoding="utf-8")
    elif write == "npy":
        np.save(path, both)
    else:
        path.write_text("".join(f'{{"values": {row}}}\n' for row in both.tolist()), encoding="utf-8")
    assert FORM in refused(path)
    columns = "g=values[0]+values[1]+values[2],a=values[3]+values[4]+values[5]"
    columns = columns if write == "jsonl" else "g=0:3,a=3:6"
    rate, unit = problems(path, columns=columns)
    assert [rate.fixes[0].argument, unit.fixes[0].argument] == ["rate_hz", "gyro_unit"]
    is_truth(read(path, columns=columns, rate_hz=100.0, gyro_unit="deg/s"))


def test_a_unit_behind_one_axis_applies_to_all_three(tmp_path: Path) -> None:
    """In wx(rad/s), wy, wz all have one unit; xRate (rad/s), yRate (deg/s) contradict each other."""
    path = tmp_path / "log.csv"
    t = [f"{0.01 * i:.2f}" for i in range(N)]
    path.write_text(lines("t_s,wx(rad/s),wy,wz,ax(m/s^2),ay,az", t, *sensors()), encoding="utf-8")
    is_truth(read(path))
    path.write_text(lines("t_s,wx(rad/s),wy(deg/s),wz,ax,ay,az", t, *sensors()), encoding="utf-8")
    assert "the axes of the gyroscope have different units" in refused(path)


def test_each_proposal_works_with_the_requested_rate_and_unit(tmp_path: Path) -> None:
    """The log has two IMUs and no time."""
    path = tmp_path / "log.csv"
    header = ",".join(f"imu{i}_{sensor}{axis}" for i in (1, 2) for sensor in "ga" for axis in "xyz")
    both = np.column_stack([truth().deg, truth().g]).T.tolist()
    path.write_text(lines(header, *both, *both), encoding="utf-8")
    (columns_text,) = problems(path)
    assert columns_text.fixes[0].argument == "columns"
    ready = re.search(r"such as (\S+) or (\S+) \(numbers", columns_text.sentence)
    assert ready is not None
    for columns in ready.groups():
        rate, unit = problems(path, columns=columns)
        assert [rate.fixes[0].argument, unit.fixes[0].argument] == ["rate_hz", "gyro_unit"]
        is_truth(read(path, columns=columns, rate_hz=100.0, gyro_unit="deg/s"))
