"""The table of parts: complete, plausible, made by the script, and found by name."""

import math
import tomllib

import pytest

import imucal
from imucal.errors import ChoiceError
from imucal.recording import Sensor
from imucal.sensors import Part, PartSensor, cautions, every_part, find_sensor
from tests.benchmarks.sensor_parts import SHIPPED, shipped_text
from tests.real_data import real_data

#: Lowest and highest N in SI: tactical modules to the noisiest chips.
N_RANGE = {Sensor.GYROSCOPE: (5e-7, 1e-3), Sensor.ACCELEROMETER: (1e-4, 6e-3)}
#: The same for B.
B_RANGE = {Sensor.GYROSCOPE: (1e-6, 3e-4), Sensor.ACCELEROMETER: (2e-5, 5e-3)}
#: Range times counts per unit, relative to 2^15, for outputs of 16 bits: modules do not use all counts.
COUNT_RANGE = (0.5, 1.01)


def test_the_file_is_made_by_the_script() -> None:
    """Byte for byte."""
    collection = tomllib.loads(real_data("parts", "parts.toml").read_text(encoding="utf-8"))
    assert SHIPPED.read_text(encoding="utf-8") == shipped_text(collection)


def test_no_figure_is_from_the_measured_sets() -> None:
    """Some of their licences forbid it; and texts are for users, without places of copies."""
    text = SHIPPED.read_text(encoding="utf-8").lower()
    for word in ("imu_utils @", "cc by", "file id", "http", "shared/", "measured.csv"):
        assert word not in text


def test_every_part_is_shipped() -> None:
    assert len(every_part()) == 68
    assert {part.confidence for part in every_part().values()} == {
        "manufacturer",
        "manufacturer front page",
        "secondary",
        "software default",
    }


@pytest.mark.parametrize("part", every_part().values(), ids=lambda part: part.name)
def test_values_are_plausible(part: Part) -> None:
    """N and B are of this kind of sensor, each has a printed figure, and each figure a source."""
    assert part.terms
    for own in part.sensors.values():
        for term in own.terms.values():
            low, high = {"N": N_RANGE, "B": B_RANGE}.get(term.symbol, {own.sensor: (0, 1)})[own.sensor]
            assert low < term.value < high
            assert term.value <= term.most
            assert term.in_unit(term.value) > 0
            assert term.maximum is None or 1 < term.maximum / term.value < 3
            figure = own.figures[term.origin]
            assert figure.si is not None
            factor = 1 / 0.664 if term.symbol == "B" else 1.0
            assert term.value == pytest.approx(figure.si * factor, rel=1e-3)
        assert all(figure.source and figure.printed for figure in own.figures.values())
        _check_steps(own)
    assert cautions(part)


def _check_steps(own: PartSensor) -> None:
    if len(own.lsb_per_unit) != len(own.full_scale):
        assert len(own.lsb_per_unit) <= 1
        return
    for full, counts in zip(own.full_scale, own.lsb_per_unit, strict=True):
        bits = 31 if counts * full > 1e6 else 15
        assert COUNT_RANGE[0] < full * counts / 2**bits < COUNT_RANGE[1]


def test_values_agree_with_the_printed_text() -> None:
    """Worked by hand from three data sheets."""
    chip = find_sensor("BMI088").sensors[Sensor.GYROSCOPE]
    assert chip.terms["N"].value == pytest.approx(math.radians(0.014), rel=1e-4)
    assert chip.steps[0] == pytest.approx(math.radians(1 / 262.144))
    assert chip.floor is None
    module = find_sensor("ADIS16448").sensors[Sensor.GYROSCOPE]
    assert module.terms["N"].value == pytest.approx(math.radians(0.66) / 60, rel=1e-4)
    assert module.terms["B"].value == pytest.approx(math.radians(14.5) / 3600 / 0.664, rel=1e-3)
    accel = find_sensor("MPU-6886").sensors[Sensor.ACCELEROMETER].terms["N"]
    assert accel.maximum == pytest.approx(170e-6 * 9.80665, rel=1e-4)
    assert accel.most == pytest.approx(3 * 100e-6 * 9.80665, rel=1e-4)


def test_a_maximum_is_no_typical_value() -> None:
    """The bias of Honeywell is no minimum of an Allan deviation, so it gives no B."""
    part = find_sensor("HG1700")
    white = part.sensors[Sensor.GYROSCOPE].terms["N"]
    assert (white.kind, white.most / white.value) == ("maximum", 2)
    assert part.term(Sensor.GYROSCOPE, "B") is None
    assert any("no minimum of an Allan deviation" in note for note in cautions(part))


def test_two_figures_of_one_data_sheet() -> None:
    """The headline of the MPU-6050 would call every unit bad."""
    white = find_sensor("MPU-6050").sensors[Sensor.GYROSCOPE].terms["N"]
    assert white.in_unit(white.value) == pytest.approx(0.005, rel=1e-3)
    assert white.in_unit(white.reference) == pytest.approx(0.011, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("bmi088", "BMI088"),
        ("mpu 6050", "MPU-6050"),
        ("MPU6000", "MPU-6050"),
        ("icm42688p", "ICM-42688-P"),
        ("ICM-42688", "ICM-42688-P"),
        ("realsense d435i", "BMI055"),
        ("Livox Mid-360", "ICM-40609-D"),
        ("vi sensor", "ADIS16448"),
    ],
)
def test_names_in_any_spelling(name: str, part: str) -> None:
    """Also aliases, and devices with one known part."""
    assert find_sensor(name).name == part


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("BMI08", "did you mean BMI088?"),
        ("adis16465", "did you mean ADIS16465-1 or ADIS16465-2 or ADIS16465-3?"),
        ("Radiolink PIX6", "contains BMI088 or ICM-42688-P"),
        ("RealSense L515", "of which no figures are known"),
        ("quartz", "imucal sensor --list"),
        ("", "imucal sensor --list"),
    ],
)
def test_an_unknown_name_has_a_way_on(name: str, words: str) -> None:
    with pytest.raises(ChoiceError, match=r"no part|contains") as raised:
        find_sensor(name)
    assert words in str(raised.value)
    assert raised.value.fixes[0].argument == "name"


def test_the_public_function() -> None:
    assert imucal.sensor("BMI088") is find_sensor("BMI088")
