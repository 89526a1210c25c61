"""A diagnosis passes clean moving logs, and names what is wrong with damaged ones."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, Fix
from imucal.findings import Finding
from imucal.health import Diagnosis, Row, diagnose
from imucal.health.axes import ORDERS
from imucal.recording import Recording, Temperature
from imucal.screening.faults import signed_axes
from tests.health.simulated import GRAVITY, Imu, Samples, sampled, swaying, turns_and_rests, walking

#: The rows of each diagnosis, in this order.
CODES = (
    "rate",
    "gaps",
    "stamps",
    "clocks-differ",
    "accelerometer-unit",
    "gyroscope-unit",
    "no-gravity",
    "up",
    "axes",
    "sensor-delay",
    "saturated",
    "axis-missing",
    "not-finite",
    "stuck",
    "held-samples",
    "interpolated-samples",
    "spikes",
    "duplicate-axes",
    "roll-off",
    "tone",
    "temperature",
)


def row_of(diagnosis: Diagnosis, code: str) -> Row:
    return next(row for row in diagnosis.rows if row.code == code)


@pytest.fixture(scope="module")
def clean() -> Samples:
    rng = np.random.default_rng(11)
    return sampled(turns_and_rests(rng, turns=8, lever_m=0.02, carried_m=0.0), rng)


@pytest.fixture(scope="module")
def recording(clean: Samples) -> Recording:
    return clean.recording()


def test_a_clean_log_passes(recording: Recording) -> None:
    diagnosis = diagnose(recording, expect="z-up")
    assert tuple(row.code for row in diagnosis.rows) == CODES
    assert diagnosis.status == "pass", diagnosis
    for code in ("accelerometer-unit", "gyroscope-unit", "no-gravity", "up", "axes", "sensor-delay"):
        assert row_of(diagnosis, code).status == "pass"
    assert "only the one" in row_of(diagnosis, "axes").found


def test_a_walk_tells_no_axes() -> None:
    rng = np.random.default_rng(3)
    diagnosis = diagnose(sampled(walking(rng), rng).recording())
    assert tuple(row.code for row in diagnosis.rows) == CODES
    assert diagnosis.status == "pass", diagnosis
    for code in ("axes", "sensor-delay", "roll-off", "tone", "temperature", "stamps"):
        assert row_of(diagnosis, code).status == "unknown"
        assert row_of(diagnosis, code).advice


def test_sway_without_rests_tells_the_axes() -> None:
    rng = np.random.default_rng(4)
    row = row_of(diagnose(sampled(swaying(rng), rng).recording()), "axes")
    assert row.status == "pass"


def test_each_of_48_orders_is_named() -> None:
    rng = np.random.default_rng(12)
    short = sampled(turns_and_rests(rng, turns=4, carried_m=0.0), rng, Imu(rate_hz=100.0))
    for order in ORDERS:
        row = row_of(diagnose(short.mapped(order).recording()), "axes")
        axes = [int(np.abs(line).argmax()) for line in order]
        names = [
            f"{'-' if line[axis] < 0 else ''}{'xyz'[axis]}" for line, axis in zip(order, axes, strict=True)
        ]
        assert row.values["mapping"] == f"x={names[0]} y={names[1]} z={names[2]}"
        assert (row.status == "pass") == np.array_equal(order, np.eye(3))


def test_turns_about_one_axis_leave_several_orders() -> None:
    rng = np.random.default_rng(5)
    row = row_of(diagnose(sampled(turns_and_rests(rng, turns=1), rng).recording()), "axes")
    assert row.status == "unknown"
    assert float(row.values["possible"] or 0) > 1


@pytest.mark.parametrize(("order", "status"), [(ORDERS[0], "unknown"), (ORDERS[7], "fail")])
def test_two_orders_that_fit_are_both_named(order: FloatArray, status: str) -> None:
    """Two turns of gravity leave the sign of one axis open; the third turn was about the vertical."""
    rng = np.random.default_rng([78, 0])
    samples = sampled(turns_and_rests(rng, turns=3, carried_m=0.0), rng, Imu(rate_hz=100.0))
    row = row_of(diagnose(samples.mapped(order).recording()), "axes")
    assert (row.status, row.values["possible"]) == (status, 2.0)
    names = str(row.values["allowed"]).split(", ")
    axes = signed_axes(order)
    assert " ".join(f"{axis}={name}" for axis, name in zip("xyz", axes, strict=True)) in names
    assert f"the gyroscope's x, y, z are {', '.join(axes)} or " in row.found or (
        f" or {', '.join(axes)} of the accelerometer" in row.found
    )


@pytest.mark.parametrize("delay_ms", [-20.0, 6.0])
def test_a_delay_is_found(delay_ms: float) -> None:
    rng = np.random.default_rng(6)
    motion = turns_and_rests(rng, lever_m=0.0, carried_m=0.0)
    row = row_of(diagnose(sampled(motion, rng, delay_s=delay_ms / 1e3).recording()), "sensor-delay")
    assert row.status in {"warn", "fail"}
    assert row.values["delay_s"] == pytest.approx(delay_ms / 1e3, abs=5e-4)


@pytest.mark.parametrize(
    ("factor", "fix"), [(180 / math.pi, Fix("", "gyro_unit", "deg/s")), (1e3, Fix("", "gyro_unit", "mrad/s"))]
)
def test_the_unit_of_the_gyroscope_is_named(clean: Samples, factor: float, fix: Fix) -> None:
    row = row_of(diagnose(replace(clean, gyroscope=clean.gyroscope * factor).recording()), "gyroscope-unit")
    assert (row.status, row.fix) == ("fail", fix)


def test_a_gyroscope_of_half_the_rate_fails(clean: Samples) -> None:
    row = row_of(diagnose(replace(clean, gyroscope=clean.gyroscope / 2).recording()), "gyroscope-unit")
    assert row.status == "fail"
    assert row.values["scale"] == pytest.approx(2, rel=0.05)


@pytest.mark.parametrize(("factor", "unit"), [(1 / GRAVITY, "g"), (1e3 / GRAVITY, "mg")])
def test_the_unit_of_the_accelerometer_is_named(clean: Samples, factor: float, unit: str) -> None:
    diagnosis = diagnose(replace(clean, accelerometer=clean.accelerometer * factor).recording())
    row = row_of(diagnosis, "accelerometer-unit")
    assert (row.status, row.fix) == ("fail", Fix("", "accel_unit", unit))
    assert row.values["finding"] == "unit-suspect"
    assert row_of(diagnosis, "axes").status == "pass"


def test_removed_gravity_fails(clean: Samples) -> None:
    length = np.linalg.norm(clean.accelerometer, axis=1, keepdims=True)
    linear = clean.accelerometer * (1 - GRAVITY / length)
    diagnosis = diagnose(replace(clean, accelerometer=linear).recording())
    assert row_of(diagnosis, "no-gravity").status == "fail"
    assert row_of(diagnosis, "axes").status == "unknown"


def test_the_axis_that_is_up_is_compared(clean: Samples, recording: Recording) -> None:
    assert row_of(diagnose(recording), "up").status == "unknown"
    assert row_of(diagnose(recording, expect="x-down"), "up").status == "fail"
    inverted = replace(clean, accelerometer=-clean.accelerometer).recording()
    row = row_of(diagnose(inverted, expect="z-up"), "up")
    assert row.status == "fail"
    assert "inverted" in row.advice


def test_an_unknown_direction_is_refused(recording: Recording) -> None:
    with pytest.raises(ChoiceError) as error:
        diagnose(recording, expect="up")
    assert error.value.fixes[0].argument == "expect"


def test_clipping_fails(clean: Samples) -> None:
    clipped = np.clip(clean.gyroscope, -1, 1)
    row = row_of(diagnose(replace(clean, gyroscope=clipped).recording()), "saturated")
    assert row.status == "fail"
    assert "it is saturated" in row.found


def test_damaged_samples_fail(clean: Samples) -> None:
    gyroscope = clean.gyroscope
    fast = int(np.abs(np.diff(gyroscope[:, 1])).argmax())
    stuck, spiked, between = gyroscope.copy(), gyroscope.copy(), gyroscope.copy()
    stuck[fast - 200 : fast + 200, 1] = gyroscope[fast, 1]
    spiked[100::900, 0] += 3
    between[2:-1:4] = (between[1:-2:4] + between[3::4][: len(between[1:-2:4])]) / 2
    damages = {
        "stuck": (stuck, "fail"),
        "spikes": (spiked, "warn"),
        "interpolated-samples": (between, "fail"),
        "held-samples": (gyroscope[np.arange(len(gyroscope)) // 2 * 2], "fail"),
        "duplicate-axes": (gyroscope[:, [0, 0, 2]], "fail"),
        "axis-missing": (gyroscope * [1, 1, 0], "fail"),
    }
    for code, (damaged, status) in damages.items():
        row = row_of(diagnose(replace(clean, gyroscope=damaged).recording()), code)
        assert row.status == status, code


def test_a_missing_axis_fails(recording: Recording) -> None:
    diagnosis = diagnose(replace(recording, series=recording.series[:-1]))
    assert tuple(row.code for row in diagnosis.rows) == CODES
    assert row_of(diagnosis, "axis-missing").status == "fail"
    assert "accel_z" in row_of(diagnosis, "axis-missing").found


def test_findings_of_the_reader_are_rows(recording: Recording) -> None:
    jump = Finding("warning", "clock-jump", "The clock was set once.")
    late = Finding("info", "delay", "Messages were recorded 3 ms after their time stamps.")
    diagnosis = diagnose(replace(recording, findings=(jump, late)))
    stamps = row_of(diagnosis, "stamps")
    assert (stamps.status, stamps.values["finding"]) == ("fail", "clock-jump")
    clocks = row_of(diagnosis, "clocks-differ")
    assert (clocks.status, clocks.values["finding"]) == ("pass", "delay")


def test_gaps_fail(recording: Recording) -> None:
    keep = np.ones(recording.series[0].n, dtype=np.bool_)
    keep[1000:1100] = False
    row = row_of(
        diagnose(replace(recording, series=tuple(s.keeping(keep) for s in recording.series))), "gaps"
    )
    assert row.status == "fail"
    assert row.values["longest_s"] == pytest.approx(0.5)


def test_vibration_at_rest_warns() -> None:
    rng = np.random.default_rng(8)
    motion = turns_and_rests(rng, turns=4, rest_s=(20.0, 25.0))
    quiet, loud = (
        diagnose(sampled(motion, rng, Imu(rate_hz=400.0), vibration=size).recording())
        for size in ((0.0, 0.0), (3e-3, 0.05))
    )
    assert row_of(quiet, "tone").status == "pass"
    assert row_of(quiet, "roll-off").status == "pass"
    assert row_of(loud, "tone").status == "warn"
    assert "alias" in row_of(loud, "tone").found


def test_a_warming_imu_warns(recording: Recording) -> None:
    clock = recording.series[0].clock
    for span, status in ((2.0, "pass"), (20.0, "warn")):
        temperature = Temperature(samples=np.linspace(30, 30 + span, clock.n), clock=clock)
        assert row_of(diagnose(replace(recording, temperature=temperature)), "temperature").status == status


def test_a_short_log_has_all_rows(recording: Recording) -> None:
    for seconds in (0.02, 0.5, 2.0):
        diagnosis = diagnose(recording.between(0, seconds))
        assert tuple(row.code for row in diagnosis.rows) == CODES
