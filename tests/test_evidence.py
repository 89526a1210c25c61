"""Evidence about units and sensors: gravity, steps of values, and samples marked on all axes."""

import numpy as np
import pytest

from imucal.evidence import GYRO_STEPS, gravity_unit, gyroscope_step_unit, share_together, value_step
from imucal.units import G0


@pytest.mark.parametrize(
    ("length", "unit"),
    [
        (G0, "m/s^2"),
        (G0 * 1.199, "m/s^2"),
        (G0 * 1.201, None),
        (G0 * 0.801, "m/s^2"),
        (G0 * 0.799, None),
        (1.0, "g"),
        (1000.0, "mg"),
        (1e6, "ug"),
        (0.0, None),
        (float("inf"), None),
    ],
)
def test_a_length_is_gravity_in_one_unit(length: float, unit: str | None) -> None:
    """The tolerance of a fifth is the scale of an uncalibrated accelerometer."""
    assert gravity_unit(length) == unit


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([0.0, 0.5, 1.0, 2.5], 0.5),
        ([0.0, 0.5], 0.5),
        ([0.5, 0.5], None),
        # Values that differ only by rounding are equal.
        ([0.0, 1e-7, 1.0, 2.0], 1.0),
        # All neighbours must be multiples.
        ([*(0.5 * k for k in range(1, 60)), 29.5 + 0.8], None),
        # A wide gap is not compared: decimals of large multiples are rounded.
        ([*(0.5 * k for k in range(1, 60)), 29.5 + 20.3], 0.5),
    ],
)
def test_the_step_of_values_divides_their_differences(values: list[float], step: float | None) -> None:
    found = value_step(np.array(values))
    assert found == (None if step is None else pytest.approx(step, rel=1e-6))


def test_values_of_continuous_noise_have_no_step() -> None:
    assert value_step(np.random.default_rng(61001).normal(size=3000)) is None


@pytest.mark.parametrize("step", GYRO_STEPS)
@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 1.0), ("rad/s", np.pi / 180)])
def test_steps_of_a_usual_converter_give_the_unit(step: float, unit: str, factor: float) -> None:
    """Every axis must have the step, within two in a thousand."""
    near = step * factor * 1.0019
    found = gyroscope_step_unit([near, step * factor, step * factor])
    assert found is not None
    assert found[0] == unit
    # Bosch's and InvenSense's steps differ by half a thousandth.
    assert found[1] == pytest.approx(step, rel=2e-3)
    assert gyroscope_step_unit([near, step * factor, None]) is None
    assert gyroscope_step_unit([near, step * factor, 1.3 * step * factor]) is None


def test_no_steps_give_no_unit() -> None:
    assert gyroscope_step_unit([]) is None


def test_marks_on_all_axes_count_only_if_chance_does_not_explain_them() -> None:
    """A sensor slower than its log repeats all axes at once; coarse axes repeat each by itself."""
    rng = np.random.default_rng(61002)
    held = rng.random(4000) < 0.2
    assert share_together([held, held, held]) == pytest.approx(held.mean())
    alone = [rng.random(4000) < 0.6 for _ in range(3)]
    assert share_together(alone) == 0.0
    assert share_together([held | one for one in alone]) == 0.0
    rare = np.zeros(4000, dtype=bool)
    rare[:19] = True
    assert share_together([rare] * 3) == 0.0
    rare[:20] = True
    assert share_together([rare] * 3) == 0.005
