"""Frames: the conventions, the truth in each of them, and intervals that cover."""

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.calibration.document import Intrinsics, schema, to_document
from imucal.calibration.frames import FRAMES, Frame, rotation_to
from imucal.calibration.parameters import inverse
from imucal.errors import ArgumentError
from imucal.noise import NoiseModel
from imucal.recording import AXES, Sensor
from imucal.report.typed_json import to_json
from tests.calibration.simulated import (
    FACES,
    GRAVITY,
    Log,
    Truth,
    attitudes,
    log,
    truth_inside,
    within_binomial,
)
from tests.calibration.test_calibrate import MODELS, NOISE

#: Accelerometer noise that decides the errors of the gyroscope's directions.
ROUGH = NoiseModel.parse("N=2e-2 + B=5e-3"), NoiseModel.parse("N=5e-5")


def skewed(rng: np.random.Generator) -> Truth:
    """Return an IMU with misalignments of 3 %, so that the frames differ by degrees."""
    truth = Truth.draw(rng)
    truth.M_a[np.tril_indices(3, -1)] *= 3
    return truth


def drawn(seed: int, noise: tuple[NoiseModel, NoiseModel] = NOISE, count: int = 14) -> tuple[Truth, Log]:
    rng = np.random.default_rng(seed)
    truth = skewed(rng)
    return truth, log(truth, noise, attitudes(count, rng), rng, latitude=47.4)


def test_conventions_and_proper_rotations() -> None:
    """Triangles, symmetry, the smallest distance to the axes; gains and units change nothing."""
    rng = np.random.default_rng(8600)
    M = skewed(rng).M_a
    axes = M / np.linalg.norm(M, axis=1)[:, None]
    for frame in FRAMES:
        R = rotation_to(frame, inverse(M))
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0)
        # From any frame, and in any unit.
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turned *= np.linalg.det(turned)
        gains = np.diag([415.0, 2.0, 32768.0])
        from_turned = rotation_to(frame, inverse(gains @ M @ turned.T))
        np.testing.assert_allclose(from_turned @ turned, R, atol=1e-12)
    own = {frame: axes @ rotation_to(frame, inverse(M)).T for frame in FRAMES}
    np.testing.assert_allclose(np.triu(own["kalibr"], 1), 0, atol=1e-15)
    np.testing.assert_allclose(np.tril(own["imu-tk"], -1), 0, atol=1e-15)
    np.testing.assert_allclose(own["nearest"], own["nearest"].T, atol=1e-15)
    distance = {frame: np.linalg.norm(matrix - np.eye(3)) for frame, matrix in own.items()}
    assert distance["nearest"] < 0.8 * min(distance["kalibr"], distance["imu-tk"])
    for _ in range(50):
        vector = rng.normal(0, 0.01, 3)
        other = np.eye(3) + np.cross(np.eye(3), vector)
        other = np.linalg.svd(other)[0] @ np.linalg.svd(other)[2]
        assert np.linalg.norm(own["nearest"] @ other - np.eye(3)) > distance["nearest"]


@pytest.mark.parametrize("name", FRAMES)
def test_slopes_are_those_of_a_larger_step(name: str) -> None:
    """Central differences of 1e-3, whose error is 1e-6."""
    C = inverse(skewed(np.random.default_rng(8601)).M_a)
    frame = Frame.of(name, C)
    for k, (i, j) in enumerate(zip(*np.tril_indices(3), strict=True)):
        step = np.zeros((3, 3))
        step[i, j] = 1e-3
        high, low = (rotation_to(name, c) @ c for c in (C + step, C - step))
        np.testing.assert_allclose(frame.derivatives[:, :, k], (high - low) / 2e-3, atol=2e-6)


def test_every_frame_is_the_same_imu() -> None:
    """C, G and the corrected log differ by one rotation; the document fits its schema and is read back."""
    _, one = drawn(8602)
    recording = one.recording()
    results = {f: imucal.calibrate(recording, MODELS, 47.4, gravity=GRAVITY, frame=f) for f in FRAMES}
    first = results["kalibr"]
    assert first.gyroscope is not None
    for frame, found in results.items():
        document = to_json(to_document(found))
        jsonschema.validate(document, schema())
        assert document["frame"] == found.frame == frame
        R = rotation_to(frame, first.accelerometer.C)
        assert (frame == "kalibr") == (np.abs(R - np.eye(3)).max() < 1e-12)
        np.testing.assert_allclose(found.accelerometer.C, R @ first.accelerometer.C, atol=1e-12)
        assert found.gyroscope is not None
        np.testing.assert_allclose(found.gyroscope.C, R @ first.gyroscope.C, atol=1e-12)
        np.testing.assert_allclose(found.gyroscope.G, first.gyroscope.G @ R.T, atol=1e-9)
        for sensor in Sensor:
            old, new = (
                np.column_stack(
                    [imucal.apply(r, recording).axis(sensor.short, axis).samples for axis in AXES]
                )
                for r in (first, found)
            )
            np.testing.assert_allclose(new, old @ R.T, atol=1e-6)
        np.testing.assert_allclose(
            R @ first.accelerometer.suggestion.down, found.accelerometer.suggestion.down
        )
        back = Intrinsics.of(found).in_frame("kalibr")
        np.testing.assert_allclose(back.C_a, first.accelerometer.C, atol=1e-12)
    names = [n for n in results["imu-tk"].accelerometer.parameters if n.startswith("mis")]
    assert names == ["misalignment_xy", "misalignment_xz", "misalignment_yz"]
    assert results["imu-tk"].accelerometer.suggestion.parameter in {*names, "scale_x", "scale_y", "scale_z"}


def test_six_faces_have_the_same_diagonal_in_every_frame() -> None:
    """Without misalignment all frames are one."""
    rng = np.random.default_rng(8603)
    one = log(skewed(rng), NOISE, FACES, rng)
    for frame in FRAMES:
        found = imucal.calibrate(one.recording(), MODELS, gravity=GRAVITY, frame=frame)
        assert np.abs(found.accelerometer.C - np.diag(np.diag(found.accelerometer.C))).max() == 0
        unknown = [n for n, p in found.accelerometer.parameters.items() if p.status == "not-observable"]
        assert [n[:4] for n in unknown] == ["misa"] * 3


def test_raw_counts_in_another_frame() -> None:
    """Axes of different scales: the directions alone fix the frame."""
    truth, one = drawn(8604)
    series = tuple(
        s
        if s.sensor is Sensor.GYROSCOPE
        else imucal.AxisSeries(
            sensor=s.sensor,
            axis=s.axis,
            samples=s.samples * 100.0 * (1 + 3 * AXES.index(s.axis)),
            clock=s.clock,
        )
        for s in one.recording().series
    )
    counts = imucal.Recording(source=one.recording().source, series=series)
    plain_, raw = (imucal.calibrate(r, gravity=GRAVITY, frame="nearest") for r in (one.recording(), counts))
    names = [n for n in plain_.accelerometer.parameters if n.startswith("mis")]
    for name in names:
        own, other = (r.accelerometer.parameters[name].value for r in (plain_, raw))
        assert own == pytest.approx(other, abs=0.01)
    M = rotation_to("nearest", inverse(truth.M_a))
    assert plain_.accelerometer.parameters["misalignment_zx"].value == pytest.approx(
        np.degrees((truth.M_a @ M.T)[2, 0] / (truth.M_a @ M.T)[2, 2]), abs=0.1
    )


def test_a_wrong_frame_is_refused() -> None:
    """The message lists the frames."""
    with pytest.raises(ArgumentError, match="'ned'"):
        imucal.calibrate(drawn(8605)[1].recording(), frame="ned")


@pytest.mark.parametrize("frame", FRAMES)
def test_the_truth_is_in_the_intervals(frame: str) -> None:
    """Thirty parameters of ten logs, whose accelerometer noise decides the directions."""
    hits = []
    for seed in range(730_000, 730_010):
        truth, one = drawn(seed, ROUGH)
        models = {f"{s.short}_{axis}": ROUGH[s is Sensor.GYROSCOPE] for s in Sensor for axis in AXES}
        found = imucal.calibrate(one.recording(), models, 47.4, gravity=GRAVITY, frame=frame)
        hits.append(list(truth_inside(truth, one, found).values()))
        assert len(hits[-1]) == 30
    assert within_binomial(np.array(hits), 0.92, 0.99)


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
def test_coverage_in_every_frame(frame: str) -> None:
    """Two hundred logs: the errors of the frame and of the turns are correlated."""
    hits = []
    models = {f"{s.short}_{axis}": ROUGH[s is Sensor.GYROSCOPE] for s in Sensor for axis in AXES}
    for seed in range(731_000, 731_200):
        truth, one = drawn(seed, ROUGH)
        found = imucal.calibrate(one.recording(), models, 47.4, gravity=GRAVITY, frame=frame)
        hits.append(list(truth_inside(truth, one, found).values()))
        assert len(hits[-1]) == 30
    assert within_binomial(np.array(hits), 0.93, 0.98)
