"""Units inferred from samples: limits for gravity, counts, converter steps and gyroscope noise."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.evidence import GYRO_STEPS
from imucal.readers.scales import (
    _white_noise,
    infer_accel_unit,
    infer_gyro_unit,
    sample_rows,
)
from imucal.units import G0


def still(size: float) -> FloatArray:
    return np.array([[0.0, 0.0, size]] * 3)


@pytest.mark.parametrize(
    ("size", "unit", "scale"),
    [
        (1.199, "g", None),
        (1.201, None, None),
        (0.801, "g", None),
        (0.799, None, None),
        (G0 * 1.199, "m/s^2", None),
        (G0 * 0.799, None, None),
        (1199.5, "mg", None),
        (800.5, "mg", None),
        # Gravity in cm/s^2, and in mg with a scale error of less than 2 %.
        (981.0, None, None),
        (991.0, "mg", None),
        (799.5, None, None),
        # Counts may differ by five percent and must be integers.
        (2048 * 1.049 // 1, "count", G0 / 2048),
        (2048 * 1.051 // 1, None, None),
        (2048 * 0.951 // 1, "count", G0 / 2048),
        (2048 * 0.949 // 1, None, None),
        (2048.5, None, None),
        (4096.0, "count", G0 / 4096),
        (8192.0, "count", G0 / 8192),
        (16384.0, "count", G0 / 16384),
    ],
)
def test_gravity_identifies_the_unit(size: float, unit: str | None, scale: float | None) -> None:
    """The tolerance is fifteen percent for units and five for counts."""
    found = infer_accel_unit(still(size))
    assert (found.unit, found.scale, found.assumed) == (unit, scale, False)


@pytest.mark.parametrize(
    ("size", "reason"),
    [
        (9.5, "median magnitude 9.5 is gravity in m/s^2"),
        (0.5, "median magnitude 0.5 is not gravity in m/s^2, g or mg"),
        (2048.0, "median magnitude 2048 is gravity at 2048 counts per g"),
        (500.0, "integer counts of median magnitude 500, which is not 1 g in any usual range"),
        (
            5000.0,
            (
                "integer counts of median magnitude 5000, which is not 1 g in any usual range; "
                "a 16 bit sensor of 8 g range has 4096 counts per g"
            ),
        ),
        (
            30000.0,
            (
                "integer counts of median magnitude 3e+04, which is not 1 g in any usual range; "
                "a 16 bit sensor of 2 g range has 16384 counts per g"
            ),
        ),
    ],
)
def test_the_reason_contains_the_measured_gravity(size: float, reason: str) -> None:
    """For large counts it also contains the usual range."""
    assert infer_accel_unit(still(size)).reason == reason


def test_without_finite_samples_no_unit_is_inferred() -> None:
    nothing = np.zeros((0, 3))
    assert infer_accel_unit(nothing).reason == "there are no finite samples"
    assert infer_gyro_unit(nothing, rate_hz=None, accel_unit=None).reason == "there are no finite samples"


def test_known_steps_double_from_range_to_range() -> None:
    """Steps are in deg/s per count."""
    invensense = [1 / 262, 1 / 131, 2 / 131, 4 / 131, 8 / 131]
    bosch = [125 * 2**k / 32768 for k in range(6)]
    st = [0.004375, 0.00875, 0.0175, 0.035, 0.07, 0.14]
    assert pytest.approx([*invensense, *bosch, *st], rel=1e-12) == GYRO_STEPS[:-1]


def turning(step: float, n: int = 40) -> FloatArray:
    return np.array([[k % 7, k % 5, k % 3] for k in range(n)]) * step


@pytest.mark.parametrize(
    ("step", "unit"),
    [
        (0.07, "deg/s"),
        (0.07 * 1.00199, "deg/s"),
        (0.07 * 1.00201, None),
        (0.07 * 0.99801, "deg/s"),
        (0.07 * 0.99799, None),
        (np.radians(0.07), "rad/s"),
        (0.05, None),
    ],
)
def test_a_known_converter_step_identifies_the_unit(step: float, unit: str | None) -> None:
    """The tolerance is two in a thousand."""
    found = infer_gyro_unit(turning(step), rate_hz=None, accel_unit=None)
    assert (found.unit, found.assumed) == (unit, False)


def test_the_reason_contains_the_found_and_the_known_step() -> None:
    reason = "the rates come in steps of 0.00122173, a converter's 0.07 deg/s"
    assert infer_gyro_unit(turning(np.radians(0.07)), rate_hz=None, accel_unit=None).reason == reason


def test_white_noise_is_estimated_from_the_quietest_axis() -> None:
    """The estimate needs a hundred samples and a rate."""
    rows = np.array([[(-1.0) ** k * size for size in (1.0, 2.0, 0.5)] for k in range(100)])
    assert _white_noise(rows, 4.0) == pytest.approx(1.0 / 0.6745 / np.sqrt(2) / 2)
    assert _white_noise(rows[:99], 4.0) is None
    assert _white_noise(rows, None) is None


@pytest.mark.parametrize(
    ("rate", "swing", "reason"),
    [
        (0.399, 0.0, "the log does not contain it; the accelerometer is in SI units"),
        (0.401, 0.0, "the median rate 0.401 is too fast for rad/s at rest, so deg/s is likely"),
        (0.1, 0.000953, "the log does not contain it; the accelerometer is in SI units"),
        (
            0.1,
            0.000955,
            "a noise of 0.002 rad/s/sqrt(Hz) is more than any gyroscope has, so deg/s is likely",
        ),
    ],
)
def test_rate_and_noise_of_a_gyroscope_are_limited(rate: float, swing: float, reason: str) -> None:
    """The limits are 0.5 rad/s and 2e-3 rad/s/sqrt(Hz)."""
    rows = np.array([[rate, (-1.0) ** k * swing, (-1.0) ** k * swing] for k in range(100)])
    rows[:, 0] += np.array([(-1.0) ** k * swing for k in range(100)])
    found = infer_gyro_unit(rows, rate_hz=1.0, accel_unit="m/s^2", still=True)
    assert found.reason == reason
    assert found.assumed == (found.unit == "rad/s") == reason.startswith("the log does not contain it")


def test_integer_rates_are_counts_unless_all_are_zero() -> None:
    """Zeros do not show whether the rates are counts."""
    counts = infer_gyro_unit(np.ones((9, 3)), rate_hz=None, accel_unit="m/s^2")
    assert counts.reason == "the rates are integer counts of an unknown scale"
    assert infer_gyro_unit(np.zeros((9, 3)), rate_hz=None, accel_unit="m/s^2").unit == "rad/s"


def test_rows_are_sampled_from_four_places_of_a_long_log() -> None:
    """The limit is 20 000 rows, the last part is at the end, and rows that are not finite are omitted."""
    place = np.arange(40_000.0)
    found = sample_rows([place, place, place])
    assert found.shape == (20_000, 3)
    assert [int(found[k * 5_000, 0]) for k in range(4)] == [0, 10_000, 20_000, 30_000]
    short = np.arange(5_002.0)
    assert [int(v) for v in sample_rows([short, short, short])[::5_000, 2]] == [0, 2]
    gone = np.where(place == 1, np.nan, place)
    assert sample_rows([place[:4], gone[:4], place[:4]])[:, 0].tolist() == [0.0, 2.0, 3.0]
