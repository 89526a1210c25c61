"""Turns by a known angle: the scale that gravity does not show, in rad/s and in counts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.calibration import Calibration, calibrate
from imucal.calibration.frames import rotation_to
from imucal.calibration.known_turns import KnownAngle, known_angle, known_of
from imucal.calibration.turn_data import TurnData
from imucal.errors import ArgumentError, DataError
from imucal.noise import NoiseModel
from imucal.recording import Sensor
from tests.calibration.simulated import FACES, GRAVITY, Truth, ferraris, log, truth_inside, within_binomial

NOISE = NoiseModel.parse("N=2e-3 + B=3e-4"), NoiseModel.parse("N=1.2e-4 + B=2e-5")
QUIET = NoiseModel.parse("N=1e-4"), NoiseModel.parse("N=1e-5")


def true_scales(truth: Truth) -> FloatArray:
    """Return the true scale errors of a gyroscope in the frame of the result, in %."""
    R = rotation_to("kalibr", np.asarray(np.linalg.inv(truth.M_a), dtype=np.float64))
    return np.asarray(100 * (np.diag(truth.M_g @ R.T) - 1))


def scales(found: Calibration) -> FloatArray:
    assert found.gyroscope is not None
    return np.array([found.gyroscope.parameters[f"scale_{axis}"].value for axis in "xyz"], np.float64)


@pytest.mark.parametrize(
    ("text", "angle_deg", "deviation_deg"),
    [
        ("360deg", 360, 0.2),
        ("360", 360, 0.2),
        (" 720 ° ", 720, 0.2),
        ("90deg+-1deg", 90, 1),
        ("360deg +/- 0.05", 360, 0.05),
        ("360°±0.1°", 360, 0.1),
    ],
)
def test_an_angle_is_read(text: str, angle_deg: float, deviation_deg: float) -> None:
    expected = KnownAngle(angle=math.radians(angle_deg), deviation=math.radians(deviation_deg))
    assert known_angle(text) == expected


@pytest.mark.parametrize("text", ["", "full", "-360deg", "360rad", "20deg", "360deg+-0", "360deg+-90.1deg"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ArgumentError):
        known_angle(text)


def test_exact_turns_give_the_scale_to_a_hundredth_of_a_percent() -> None:
    for seed in range(8_900, 8_904):
        rng = np.random.default_rng(seed)
        truth = Truth.draw(rng)
        found = calibrate(ferraris(truth, QUIET, rng, tilt=0.01).recording(), gravity=GRAVITY, turns="360deg")
        np.testing.assert_allclose(scales(found), true_scales(truth), atol=0.02)


def test_intervals_include_the_error_of_the_angle() -> None:
    """Full turns that are wrong by 0.2°, as by hand."""
    hits = []
    for seed in range(8_910, 8_926):
        rng = np.random.default_rng(seed)
        truth = Truth.draw(rng)
        one = ferraris(truth, NOISE, rng, deviation=math.radians(0.2))
        inside = truth_inside(truth, one, calibrate(one.recording(), gravity=GRAVITY, turns="360deg"))
        hits.append([inside[f"g scale_{axis}"] for axis in "xyz"])
    assert within_binomial(np.array(hits), 0.93, 1.0)


def test_counts_that_are_only_turned_on_a_table_get_their_scale() -> None:
    """The IMU is lifted while its gyroscope is not recorded, so that no turn changes the attitude."""
    rng = np.random.default_rng(8_930)
    truth = Truth.draw(rng)
    one = ferraris(truth, QUIET, rng)
    counts = one.gyroscope * 3000
    rests = one.spans
    for k, (first, end) in enumerate(zip(rests[:-1, 1], rests[1:, 0], strict=True)):
        if k not in {6, 8, 10}:
            counts[first + 50 : end - 50] = np.nan
    found = calibrate(replace(one, gyroscope=counts).recording(), gravity=GRAVITY, turns="360deg")
    assert found.gyroscope is not None
    # Other turns may be needed for misalignments, but not for the scales.
    np.testing.assert_allclose(
        np.diag(found.gyroscope.C) * 3000, np.diag(np.linalg.inv(truth.M_g)), rtol=1e-3
    )


def test_turns_the_other_way_and_by_another_angle() -> None:
    """The sign follows from the gyroscope; half a turn on a table that is not level is known too."""
    rng = np.random.default_rng(8_940)
    truth = Truth.draw(rng)
    up = np.vstack([FACES, np.repeat(FACES[[1, 3, 0]], 2, axis=0)])
    yaws = rng.normal(0, 0.6, len(up) - 1)
    yaws[[6, 8, 10]] = [-math.pi, math.pi, -math.pi]
    one = log(truth, QUIET, up, rng, yaws=yaws)
    found = calibrate(one.recording(), gravity=GRAVITY, turns="180deg")
    assert [turn.known_deg for turn in found.turns if turn.known_deg is not None] == [-180.0, 180.0, -180.0]
    np.testing.assert_allclose(scales(found), true_scales(truth), atol=0.05)


def test_a_turn_that_was_stopped_early_is_not_used() -> None:
    """One of five full turns is short by 8°: it contradicts the others and is named."""
    rng = np.random.default_rng(8_950)
    truth = Truth.draw(rng)
    faces = FACES[[0, 2, 1, 4, 3, 5]]
    up = np.vstack([faces, np.repeat(FACES[[1, 3, 0, 1, 3]], 2, axis=0)])
    yaws = rng.normal(0, 0.6, len(up) - 1)
    yaws[6::2] = 2 * math.pi
    yaws[10] -= math.radians(8)
    found = calibrate(log(truth, NOISE, up, rng, yaws=yaws).recording(), gravity=GRAVITY, turns="360deg")
    assert [turn.used for turn in found.turns if turn.known_deg is not None] == [
        True,
        True,
        False,
        True,
        True,
    ]
    assert "turn-wrong" in {finding.code for finding in found.findings}
    np.testing.assert_allclose(scales(found), true_scales(truth), atol=0.15)


def test_without_a_turn_in_place_the_angle_is_refused() -> None:
    rng = np.random.default_rng(8_960)
    truth = Truth.draw(rng)
    with pytest.raises(DataError, match="in which it began"):
        calibrate(log(truth, NOISE, FACES, rng).recording(), gravity=GRAVITY, turns="360deg")


@pytest.mark.parametrize("kind", ["gaps", "zero", "none", "left out"])
def test_an_angle_that_cannot_be_used_is_never_ignored(kind: str) -> None:
    """Gaps in every turn, rates of zero, no gyroscope, or one that is left out."""
    rng = np.random.default_rng(8_970)
    one = ferraris(Truth.draw(rng), NOISE, rng)
    rates = one.gyroscope.copy()
    for first, end in zip(one.spans[:-1, 1], one.spans[1:, 0], strict=True):
        if kind == "gaps":
            rates[first + 50 : end - 50] = np.nan
        elif kind == "zero":
            rates[first:end] = one.gyroscope[: one.spans[0, 1]].mean(axis=0)
    recording = replace(one, gyroscope=rates).recording()
    if kind == "none":
        kept = tuple(series for series in recording.series if series.sensor is Sensor.ACCELEROMETER)
        recording = replace(recording, series=kept)
    if kind == "left out":
        with pytest.raises(ArgumentError, match="calibrate the gyroscope"):
            calibrate(recording, gravity=GRAVITY, turns="360deg", gyro=False)
        return
    if kind == "zero":
        found = calibrate(recording, gravity=GRAVITY, turns="360deg")
        assert found.verdict == "not-usable"
        return
    with pytest.raises(DataError, match="no gyroscope" if kind == "none" else "none can be used"):
        calibrate(recording, gravity=GRAVITY, turns="360deg")


def test_rates_of_zero_have_no_angle() -> None:
    """The IMU was shaken in place, and its gyroscope measured nothing."""
    data = TurnData(
        rates=np.zeros((1, 10, 3)),
        spans=np.array([[500, 510]]),
        share=np.zeros((1, 10)),
        rests=np.array([0]),
        up=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]),
        tau0=0.01,
        known=np.full(1, np.nan),
    )
    with pytest.raises(DataError, match=r"have 0° at 5\.0 s"):
        known_of(data, np.eye(3), known_angle("360deg"), said_si=False)
