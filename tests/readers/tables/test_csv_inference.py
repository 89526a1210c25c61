"""Units that no header contains: inferred, assumed with a warning, or refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.scales import infer_accel_unit, infer_gyro_unit
from imucal.units import G0
from tests.readers.tables.texts import N, lines, own_counts, own_plain, seconds, truth, xyz


def at_rest(size: float, *, integers: bool = False) -> FloatArray:
    """Return samples of an accelerometer at rest with a given size of gravity."""
    rows = np.random.default_rng(2).normal(scale=size * 1e-3, size=(500, 3)) + np.array([0, 0.1 * size, size])
    return np.asarray(np.round(rows) if integers else rows, dtype=np.float64)


@pytest.mark.parametrize(
    ("size", "unit"),
    [
        (9.81, "m/s^2"),
        (9.0, "m/s^2"),
        (10.3, "m/s^2"),
        (1.0, "g"),
        (0.93, "g"),
        (1000.0, "mg"),
        (930.0, "mg"),
    ],
)
def test_gravity_identifies_the_unit_of_the_accelerometer(size: float, unit: str) -> None:
    """The units differ by factors of ten, more than the scale errors of cheap sensors."""
    assert infer_accel_unit(at_rest(size)).unit == unit


@pytest.mark.parametrize("counts", [16384, 8192, 4096, 2048])
def test_integer_counts_of_gravity_give_the_scale(counts: int) -> None:
    found = infer_accel_unit(at_rest(counts, integers=True))
    assert found.unit == "count"
    assert found.scale == pytest.approx(G0 / counts)


@pytest.mark.parametrize(("size", "integers"), [(15000, True), (5.0, False), (0.2, False), (3000, True)])
def test_other_magnitudes_give_no_unit(size: float, integers: bool) -> None:  # noqa: FBT001 - a parameter of the case
    assert infer_accel_unit(at_rest(size, integers=integers)).unit is None


@pytest.mark.parametrize("step", [1 / 131, 1 / 65.5, 1 / 16.4, 2000 / 32768, 250 / 32768, 0.00875, 0.07])
@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 1.0), ("rad/s", np.pi / 180)])
def test_the_steps_of_a_known_converter_identify_the_unit_of_the_gyroscope(
    step: float, unit: str, factor: float
) -> None:
    counts = np.round(np.random.default_rng(3).normal(scale=6, size=(2000, 3)))
    # Logs print a limited number of digits.
    rows = np.array([float(f"{value:.7g}") for value in (counts * step * factor).ravel()]).reshape(-1, 3)
    found = infer_gyro_unit(rows, rate_hz=100.0, accel_unit="m/s^2")
    assert (found.unit, found.assumed) == (unit, False)


def noise(scale: float, mean: float = 0.0) -> FloatArray:
    return np.random.default_rng(4).normal(scale=scale, size=(5000, 3)) + mean


def moving(scale: float) -> FloatArray:
    """Return rates of a hand: a large range in small steps."""
    t = np.linspace(0, 60, 5000)[:, None]
    return scale * (3 * np.sin(t * [1.0, 1.3, 0.7]) + 1e-3 * noise(1.0))


@pytest.mark.parametrize(
    ("rows", "accel", "unit", "reason"),
    [
        (noise(1e-3), "m/s^2", "rad/s", "the log does not contain it; the accelerometer is in SI units"),
        (
            noise(1e-3),
            "g",
            None,
            (
                "its noise of 9.9e-05 per sqrt(Hz) fits a gyroscope in rad/s, and one in deg/s, "
                "which would have 1.7e-06 rad/s/sqrt(Hz)"
            ),
        ),
        (
            moving(1.0),
            "m/s^2",
            None,
            (
                "the median rate 3.68 is too fast for rad/s at rest, "
                "but the sensor may have moved, so it may be either"
            ),
        ),
        (
            noise(1e-3),
            None,
            None,
            (
                "its noise of 9.9e-05 per sqrt(Hz) fits a gyroscope in rad/s, and one in deg/s, "
                "which would have 1.7e-06 rad/s/sqrt(Hz)"
            ),
        ),
        (
            noise(1e-2, 0.7),
            "m/s^2",
            None,
            "the median rate 1.21 is too fast for rad/s at rest, so deg/s is likely",
        ),
        (
            noise(0.1),
            "m/s^2",
            None,
            "a noise of 0.0099 rad/s/sqrt(Hz) is more than any gyroscope has, so deg/s is likely",
        ),
        (np.round(noise(30.0)), "m/s^2", None, "the rates are integer counts of an unknown scale"),
    ],
)
def test_rad_per_s_is_assumed_only_next_to_an_si_accelerometer(
    rows: FloatArray, accel: str | None, unit: str | None, reason: str
) -> None:
    """Rate and noise must also be typical of a gyroscope, and the unit stays an assumption."""
    found = infer_gyro_unit(rows, rate_hz=100.0, accel_unit=accel, still=True)
    assert (found.unit, found.assumed, found.reason) == (unit, unit is not None, reason)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"gyro_unit": "deg/s"}, "deg/s as given"),
        ({"gyro_scale": 1e-4}, "0.0001 rad/s per count as given"),
        ({"gyro_unit": "rad/s", "accel_unit": "m/s^2"}, ""),
        ({}, ""),
    ],
)
def test_a_given_unit_that_contradicts_the_header_is_a_warning(
    given: dict[str, Any], expected: str, tmp_path: Path
) -> None:
    """The given unit is used, because headers can be wrong. If both agree there is no warning."""
    path, t = tmp_path / "log.csv", truth()
    names = "t (s),gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"
    path.write_text(lines(names, seconds(t), *xyz(t.gyro), *xyz(t.accel)), encoding="utf-8")
    findings = [finding for finding in read(path, ReadOptions(**given)).findings if "unit" in finding.code]
    text = f"The unit of the gyroscope is {expected}; the log has rad/s, from the column header."
    assert [finding.text for finding in findings] == [text] * bool(expected)
    assert all((f.level, f.code, f.axis) == ("warning", "unit-given", "gyro") for f in findings)


def test_an_assumed_unit_is_a_warning(tmp_path: Path) -> None:
    """The warning explains how to give the unit."""
    path = tmp_path / "log.csv"
    path.write_text(own_plain(truth()), encoding="utf-8")
    (finding,) = read(path, ReadOptions()).findings
    assert (finding.level, finding.code, finding.axis) == ("warning", "unit-assumed", "gyro")
    assert finding.text == (
        "The unit of the gyroscope is assumed to be rad/s: the log does not contain it; the accelerometer "
        "is in SI units."
    )
    assert (
        finding.advice
        == "Give its unit if this is wrong: deg/s instead of rad/s changes all results by a factor of 57."
    )
    assert read(path, ReadOptions(gyro_unit="rad/s")).findings == ()


def test_integer_counts_of_a_gyroscope_need_a_scale(tmp_path: Path) -> None:
    """Unlike gravity, no known quantity gives the scale."""
    path = tmp_path / "log.csv"
    path.write_text(own_counts(truth()), encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: the unit of the gyroscope is unknown: no header contains it, and the rates are integer "
        "counts of an unknown scale; expected a unit such as rad/s, deg/s, mdeg/s or deg/h; give its "
        "unit, or give the scale of its counts in rad/s per count"
    )
    recording = read(path, ReadOptions(gyro_scale=np.radians(1 / 131), accel_scale=G0 / 16384))
    assert recording.axis("accelerometer", "z").samples.mean() == pytest.approx(G0, rel=1e-3)


def test_an_accelerometer_without_plausible_gravity_needs_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(lines("time (s),ax,ay,az", seconds(truth()), *xyz(truth().accel * 0.5)), encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: the unit of the accelerometer is unknown: no header contains it, and median magnitude "
        "4.905 is not gravity in m/s^2, g or mg; expected a unit such as m/s^2, g, mg or cm/s^2; give its "
        "unit, or give the scale of its counts in m/s^2 per count"
    )
    assert read(path, ReadOptions(accel_unit="m/s^2")).series[0].n == N
