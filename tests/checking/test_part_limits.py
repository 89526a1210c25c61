"""Limits that name a part: multiples of the figure of its data sheet."""

import pytest

from imucal.checking import check, parse_limits
from imucal.errors import LimitsError
from imucal.sensors import find_sensor
from tests.report.synthetic import consumer_report


def test_a_limit_is_a_multiple_of_the_figure() -> None:
    """For a sensor or one axis, min and max; the alternative figure is used if there is one."""
    text = """
        gyroscope.N = { sensor = "BMI088", min = 0.2, max = 1.5 }
        gyro_x.N = { sensor = "mpu6050", max = 2 }
        accel_z.B = { sensor = "ADIS16448", max = 1 }
    """
    limits = parse_limits(text).limits
    assert [(limit.unit, limit.factor) for limit in limits] == [
        ("x BMI088", 0.00024435),
        ("x BMI088", 0.00024435),
        ("x MPU-6050", 0.000192),
        ("x ADIS16448", 0.003692),
    ]
    row = next(row for row in check(consumer_report(), parse_limits(text)).rows if row.side == "max")
    assert row.measured is not None
    value = consumer_report().axes[0]["N"].value
    assert value is not None
    assert row.measured.value == pytest.approx(value / find_sensor("BMI088").terms[0].value)


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ('gyroscope.N = { sensor = "BMI08", max = 1.5 }', "gyroscope.N.sensor", "did you mean BMI088?"),
        ('gyro_x.B = { sensor = "BMI088", max = 1 }', "gyro_x.B.sensor", "expected one of N"),
        ('accel_x.N = { sensor = "HG9900", max = 1 }', "accel_x.N.sensor", "expected a limit without a part"),
        (
            'gyroscope.N = { sensor = "BMI088", max = 1, unit = "deg/h" }',
            "gyroscope.N.unit",
            "expected no unit",
        ),
        ("gyroscope.N = { sensor = 3, max = 1 }", "gyroscope.N.sensor", "found 3, expected a text"),
        ('gyroscope.mean = { sensor = "BMI088", max = 1 }', "gyroscope.mean.sensor", "gives no mean"),
        ('gyroscope.N = { sensor = "Radiolink PIX6", max = 1 }', "gyroscope.N.sensor", "name the part"),
        ('gyroscope.N = { sensor = "BMI088" }', "gyroscope.N", "neither min nor max"),
    ],
)
def test_errors_name_the_key(text: str, key: str, words: str) -> None:
    with pytest.raises(LimitsError) as raised:
        parse_limits(text)
    assert raised.value.place == f"limits: {key}"
    assert words in str(raised.value)
