"""calibrate: from a recording to the result, its findings, and its application."""

import pickle
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import imucal
from imucal import calibrate
from imucal.calibration import Calibration
from imucal.calibration.checks import worse_than_before
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.pipeline import characterize
from imucal.recording import AXES, Recording, Sensor, Temperature
from tests.calibration.simulated import FACES, GRAVITY, RATE, Log, Truth, attitudes, held, log, truth_inside
from tests.real_data import real_data

NOISE = NoiseModel.parse("N=2e-3 + B=5e-4 + K=5e-5"), NoiseModel.parse("N=1.5e-4 + B=2e-5 + K=2e-6")
MODELS = {f"{s.short}_{axis}": NOISE[s is Sensor.GYROSCOPE] for s in Sensor for axis in AXES}


def drawn(seed: int, count: int = 14, up: np.ndarray | None = None) -> tuple[Truth, Log]:
    rng = np.random.default_rng(seed)
    truth = Truth.draw(rng)
    return truth, log(truth, NOISE, attitudes(count, rng) if up is None else up, rng, latitude=47.4)


@pytest.fixture(scope="module")
def good() -> tuple[Truth, Log, Calibration]:
    truth, one = drawn(8000, 18)
    return truth, one, calibrate(one.recording(), noise=MODELS, gravity=GRAVITY, latitude=47.4)


def codes(result: Calibration) -> set[str]:
    return {finding.code for finding in result.findings}


def poses(name: str) -> Recording:
    path = real_data("..", "poses", name)
    return (
        imucal.read(path, rate_hz=100.0)
        if "mikoff" in name
        else imucal.read(path, accel_scale=1.0, gyro_scale=1.0)
    )


def test_a_good_log_gives_the_truth(good: tuple[Truth, Log, Calibration]) -> None:
    """All parameters within twice their interval, no warning."""
    truth, one, found = good
    assert found.verdict == "good"
    assert found.accelerometer.model == "full"
    assert len(found.rests) == 18
    assert all(turn.used for turn in found.turns)
    assert found.gyroscope is not None
    for axis in range(3):
        name = AXES[axis]
        for result, M, b in (
            (found.accelerometer, truth.M_a, one.b_a),
            (found.gyroscope, truth.M_g, one.b_g),
        ):
            scale, bias = result.parameters[f"scale_{name}"], result.parameters[f"bias_{name}"]
            assert scale.value == pytest.approx(100 * (M[axis, axis] - 1), abs=2 * (scale.half_width or 0))
            assert bias.value == pytest.approx(b[axis], abs=2 * (bias.half_width or 0))
            assert scale.unit == "%"
    skew = found.accelerometer.parameters["misalignment_zx"]
    assert skew.value == pytest.approx(
        np.degrees(truth.M_a[2, 0] / truth.M_a[2, 2]), abs=2 * (skew.half_width or 0)
    )
    assert found.accelerometer.covariance.shape == (9, 9)


def test_apply_removes_the_errors(good: tuple[Truth, Log, Calibration]) -> None:
    """Gravity has its length, rates at rest are zero."""
    _, one, found = good
    corrected = imucal.apply(found, one.recording())
    f = np.column_stack([corrected.axis("accel", axis).samples for axis in AXES])
    w = np.column_stack([corrected.axis("gyro", axis).samples for axis in AXES])
    norms = [np.linalg.norm(f[a:b].mean(axis=0)) for a, b in one.spans]
    np.testing.assert_allclose(norms, GRAVITY, atol=5e-3)
    assert max(np.abs(w[a:b].mean(axis=0)).max() for a, b in one.spans) < 5e-4
    np.testing.assert_allclose(f, one.f, atol=0.1)


def test_raw_counts_give_the_same_calibration(good: tuple[Truth, Log, Calibration]) -> None:
    """Offset-binary counts: the matrices differ by the scales, the corrected log does not."""
    _, one, found = good
    raw = calibrate(raw_counts(one).recording(), gravity=GRAVITY, latitude=47.4)
    assert raw.accelerometer.parameters["scale_x"].unit == "raw/(m/s^2)"
    np.testing.assert_allclose(raw.accelerometer.C * 400, found.accelerometer.C, atol=2e-3)
    assert raw.gyroscope is not None
    assert found.gyroscope is not None
    np.testing.assert_allclose(raw.gyroscope.C * 4000, found.gyroscope.C, atol=5e-3)


def test_without_a_gyroscope_only_the_accelerometer_is_calibrated() -> None:
    """With `gyro=False`, or if there is none."""
    _, one = drawn(8001)
    recording = one.recording()
    alone = replace(recording, series=tuple(s for s in recording.series if s.sensor is Sensor.ACCELEROMETER))
    for result in (calibrate(recording, gyro=False), calibrate(alone)):
        assert result.gyroscope is None
        assert result.turns == ()
    with pytest.raises(DataError, match="no accelerometer"):
        calibrate(replace(recording, series=recording.series[:3]))


def test_six_faces_report_what_is_missing() -> None:
    """A diagonal model, a finding, and the attitude to add."""
    _, one = drawn(8002, up=FACES)
    found = calibrate(one.recording(), noise=MODELS, gravity=GRAVITY)
    assert found.accelerometer.model == "diagonal"
    missing = found.accelerometer.parameters["misalignment_yx"]
    assert (missing.value, missing.status) == (None, "not-observable")
    finding = next(f for f in found.findings if f.code == "not-observable" and f.axis == "accel")
    assert "misalignment yx" in finding.text
    assert "Add a rest with down" in finding.advice


@pytest.mark.parametrize("count", [1, 4])
def test_too_few_rests_cannot_be_calibrated(count: int) -> None:
    """The message asks for more attitudes."""
    _, one = drawn(8003, up=FACES[:count])
    with pytest.raises(DataError, match=f"found {count}, expected at least 6"):
        calibrate(one.recording())


def test_one_attitude_cannot_be_calibrated() -> None:
    """Eight rests with the same side down."""
    _, one = drawn(8004, up=np.tile(FACES[0], (8, 1)) + np.random.default_rng(3).normal(0, 0.01, (8, 3)))
    with pytest.raises(DataError, match=r"same attitude|found 1 of"):
        calibrate(one.recording())


def test_gravity_and_latitude_are_asked_for() -> None:
    """Without them all scales share an error; with them they do not."""
    _, one = drawn(8005)
    unknown, known = calibrate(one.recording()), calibrate(one.recording(), latitude=45.0)
    assert "gravity-unknown" in codes(unknown)
    assert "gravity-unknown" not in codes(known)
    wide, narrow = (c.accelerometer.parameters["scale_x"].half_width or 0 for c in (unknown, known))
    assert wide == pytest.approx(100 * 1.96 * 0.015 / GRAVITY, rel=0.1)
    assert narrow < 0.3 * wide


def test_a_rest_that_moved_is_excluded() -> None:
    """A creep of half a degree in one rest."""
    _, one = drawn(8006)
    moved = one.accelerometer.copy()
    first, end = one.spans[4]
    moved[first:end, int(np.argmin(np.abs(one.f[first])))] += np.linspace(0, 0.08, end - first)
    found = calibrate(replace(one, accelerometer=moved).recording(), noise=MODELS)
    assert [k for k, rest in enumerate(found.rests) if not rest.used] == [4]
    assert found.rests[4].why == "moved"
    assert "rest-moved" in codes(found)


def test_rests_that_moved_and_are_used_all_the_same_are_counted() -> None:
    """At most a third is excluded; the finding does not hide the others."""
    _, one = drawn(8016)
    moved = one.accelerometer.copy()
    for first, end in one.spans[: len(one.spans) // 2]:
        moved[first:end, int(np.argmin(np.abs(one.f[first])))] += np.linspace(0, 0.08, end - first)
    found = calibrate(replace(one, accelerometer=moved).recording(), noise=MODELS)
    used = sum(rest.used for rest in found.rests)
    assert used == len(found.rests) - len(found.rests) // 3
    (text,) = (finding.text for finding in found.findings if finding.code == "rest-moved")
    assert re.search(r"\d+ more rests? also moved but (is|are) used", text), text


@pytest.mark.parametrize(("noise", "level"), [(MODELS, "warning"), (None, "info")])
def test_nine_rests_with_a_report_are_a_warning(noise: dict[str, NoiseModel] | None, level: str) -> None:
    """A wrong report can't be noticed; without one the intervals are wide."""
    _, one = drawn(8017, 9)
    found = calibrate(one.recording(), noise=noise, latitude=45.0)
    levels = {finding.code: finding.level for finding in found.findings}
    assert levels["unchecked"] == level


def test_lost_and_clipped_turns_are_named() -> None:
    """A gap in one turn, a clipped axis in another."""
    _, one = drawn(8007, 16)
    gyroscope = one.gyroscope.copy()
    a, b = one.spans[3, 1], one.spans[4, 0]
    gyroscope[(a + b) // 2 : (a + b) // 2 + 5] = np.nan
    a, b = one.spans[8, 1], one.spans[9, 0]
    axis = int(np.argmax(np.abs(gyroscope[a:b]).max(axis=0)))
    limit = 0.8 * np.abs(gyroscope[a:b, axis]).max()
    # No other turn may reach the range, as in a real log.
    gyroscope[:, axis] = np.clip(gyroscope[:, axis], -limit, limit)
    found = calibrate(replace(one, gyroscope=gyroscope).recording(), noise=MODELS)
    assert found.turns[3].why == "gap"
    assert found.turns[8].why == "clipped"
    assert {"turn-gap", "clipped"} <= codes(found)


def test_noise_of_another_unit_is_noticed() -> None:
    """Models with ten times the noise."""
    _, one = drawn(8008)
    other = {name: NoiseModel.parse("N=2e-2" if name[0] == "a" else "N=1.5e-3") for name in MODELS}
    assert "noise-differs" in codes(calibrate(one.recording(), noise=other))
    assert "noise-differs" not in codes(calibrate(one.recording(), noise=MODELS))
    with pytest.raises(DataError, match="no noise model of accel_x"):
        calibrate(one.recording(), noise={})


def test_a_changing_temperature_is_reported() -> None:
    """More than 2 K."""
    recording = drawn(8009)[1].recording()
    clock = recording.series[0].clock
    warm = Temperature(samples=np.linspace(20.0, 25.0, clock.n), clock=clock)
    found = calibrate(replace(recording, temperature=warm), noise=MODELS)
    assert found.temperature == pytest.approx((22.5, 20.0, 25.0))
    assert "warming" in codes(found)


def test_a_report_gives_the_noise() -> None:
    """Ten minutes of a static log."""
    rng = np.random.default_rng(8010)
    _, one = drawn(8011)
    series = tuple(
        imucal.AxisSeries.from_samples(
            NOISE[sensor is Sensor.GYROSCOPE].simulate(60_000, rate_hz=RATE, rng=rng),
            rate_hz=RATE,
            sensor=sensor,
            axis=axis,
        )
        for sensor in Sensor
        for axis in AXES
    )
    report = characterize(replace(one.recording(), series=series))
    found = calibrate(one.recording(), noise=report, gravity=GRAVITY)
    assert found.noise["accel"].origin == "report"
    assert found.noise["accel"].ratio == pytest.approx(1.0, abs=0.05)
    assert "noise-differs" not in codes(found)


def test_xsens_certificate() -> None:
    """Raw counts of an Xsens MTi: gains within 0.25 % and cosines within 0.01 of the factory certificate."""
    found = calibrate(poses("imu_tk_xsens_mti.csv.gz"), gravity=9.81744)
    assert len(found.rests) >= 40
    assert found.gyroscope is not None
    for result, gains in ((found.accelerometer, (415, 413, 415)), (found.gyroscope, (4778, 4758, 4766))):
        # The length of a row is the gain along the sensitive axis.
        np.testing.assert_allclose(np.linalg.norm(result.M, axis=1), gains, rtol=0.0025)
    used = np.array([rest.residual for rest in found.rests if rest.used])
    assert np.sqrt(np.mean(used**2)) < 2e-3
    turns = np.array([turn.residual_deg for turn in found.turns if turn.used])
    assert turns.std() < 0.15


def test_mikoff_published_values_are_inside() -> None:
    """An MPU-9150 in a hand: published scale errors and biases lie in the intervals."""
    found = calibrate(poses("mikoff_mpu9150_1.csv.gz"), gravity=9.81)
    published = {"scale": (0.363, 0.315, 0.647), "bias": (0.103, 0.097, 0.344)}
    for kind, values in published.items():
        for axis, value in zip(AXES, values, strict=True):
            parameter = found.accelerometer.parameters[f"{kind}_{axis}"]
            assert parameter.low is not None
            assert parameter.high is not None
            assert parameter.low < value < parameter.high


def test_a_log_held_in_a_hand_all_the_time_cannot_be_calibrated() -> None:
    """A rotation without rests."""
    log_path = real_data("real", "mpu6050", "imu_90_x_rot.csv")
    with pytest.raises(DataError, match="put the IMU down"):
        calibrate(imucal.read(log_path, accel_scale=9.80665 / 16384, gyro_scale=np.radians(1 / 131)))


@pytest.mark.parametrize("kind", ["g", "short", "hand"])
def test_an_error_names_the_argument_that_helps(kind: str) -> None:
    """The fix survives pickling, as between processes; with the argument the log is calibrated."""
    rng = np.random.default_rng(8020)
    one = log(Truth.draw(rng), NOISE, attitudes(14, rng), rng, rest_s=1.0 if kind == "short" else 4.0)
    if kind == "g":
        one = replace(one, accelerometer=one.accelerometer / GRAVITY)
    if kind == "hand":
        gyroscope = one.gyroscope.copy()
        for k, (first, end) in enumerate(one.spans):
            gyroscope[first:end] += (0.0005 if k < 5 else 0.005) * np.sin(0.4 * np.arange(end - first))[
                :, None
            ]
        one = replace(one, gyroscope=gyroscope)
    with pytest.raises(DataError) as caught:
        calibrate(one.recording())
    error = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - our own object
    assert str(error) == str(caught.value)
    helps: dict[str, tuple[tuple[str, str], dict[str, Any]]] = {
        "g": (("accel_unit", "g"), {}),
        "short": (("rest_at_least", "0.4s"), {"rest_at_least": "0.4s"}),
        "hand": (("in_hand", ""), {"in_hand": True}),
    }
    remedy, arguments = helps[kind]
    assert remedy in [(fix.argument, fix.value) for fix in error.fixes]
    if arguments:
        assert len(calibrate(one.recording(), **arguments).rests) >= 12


def raw_counts(one: Log) -> Log:
    """Return offset-binary counts: 400 per m/s² and 4000 per rad/s."""
    return replace(one, accelerometer=400 * one.accelerometer + 32768, gyroscope=4000 * one.gyroscope + 32000)


def scaled(models: dict[str, NoiseModel], accel: float, gyro: float) -> dict[str, NoiseModel]:
    """Return models in another unit; each has terms of one parameter."""
    return {
        name: NoiseModel.parse(
            " + ".join(
                f"{t.symbol}={t.coefficient * (accel if name[0] == 'a' else gyro)!r}" for t in model.terms
            )
        )
        for name, model in models.items()
    }


def test_noise_in_si_serves_a_log_in_counts() -> None:
    """The intervals are those of noise in counts, and of the log in SI, to 2 %; a finding has the scale."""
    _, one = drawn(8021, 18)
    counts = raw_counts(one).recording()
    place: dict[str, Any] = {"gravity": GRAVITY, "latitude": 47.4}
    si = calibrate(counts, noise=MODELS, **place)
    (texts := [f.text for f in si.findings if f.code == "noise-scaled"]).sort()
    assert re.search(r"accel .* multiplied by (39\d|40\d)\.?\d*,", texts[0])
    assert re.search(r"gyro .* multiplied by (39|40)\d\d,", texts[1])
    assert {"noise-differs", "beyond-noise"} & codes(si) == set()
    own, plain = (
        calibrate(counts, scaled(MODELS, 400, 4000), **place),
        calibrate(one.recording(), MODELS, **place),
    )
    assert not {"noise-scaled", "noise-differs"} & codes(own)
    for sensor, factor in (("accelerometer", 400), ("gyroscope", 4000)):
        found, expected, reference = (getattr(result, sensor).parameters for result in (si, own, plain))
        for name, one_parameter in found.items():
            half = one_parameter.half_width
            assert half == pytest.approx(expected[name].half_width, rel=0.03), name
            unit = 1.0 if name.startswith("mis") else factor / (100 if name.startswith("scale") else 1)
            assert half == pytest.approx(reference[name].half_width * unit, rel=0.03), name


def test_noise_in_counts_is_refused_for_a_log_in_si() -> None:
    """The scale of the counts is unknown; each sensor has its own message. Models 100 times too quiet too."""
    _, one = drawn(8022)
    for accel, gyro, said in (
        (
            400,
            4000,
            r"has 4e\+02 times the noise of the rests \(accel\); .* right --accel-unit or --accel-scale$",
        ),
        (1, 4000, r"has 4e\+03 times the noise of the rests \(gyro\); .* --gyro-scale$"),
        (0.01, 1, r"has 0\.0[01]\d* times .* calibrate without --noise$"),
    ):
        with pytest.raises(DataError, match=said):
            calibrate(one.recording(), noise=scaled(MODELS, accel, gyro), gravity=GRAVITY)
    # Counts of another range: neither SI nor the unit of this log.
    with pytest.raises(DataError, match=r"times the noise of the rests"):
        calibrate(raw_counts(one).recording(), noise=scaled(MODELS, 16_000, 1), gravity=GRAVITY)


def test_counts_without_a_usable_turn_keep_the_gyroscope_out() -> None:
    """Without a turn the scale of the gyroscope is unknown; the accelerometer alone is calibrated."""
    _, one = drawn(8023)
    counts = raw_counts(one)
    gyroscope = counts.gyroscope.copy()
    for (_, end), (first, _) in pairwise(counts.spans):
        gyroscope[(end + first) // 2] = np.nan
    counts = replace(counts, gyroscope=gyroscope)
    with pytest.raises(DataError, match=r"times the noise of the rests \(gyro\)"):
        calibrate(counts.recording(), noise=MODELS, gravity=GRAVITY)
    alone = calibrate(counts.recording(), noise=MODELS, gravity=GRAVITY, gyro=False)
    assert codes(alone) == {"noise-scaled"}


def test_few_rests_in_a_shaky_hand_are_calibrated() -> None:
    """Nine short rests, two of them in one attitude; the rests do not determine much."""
    rng = np.random.default_rng(9_100_040)
    truth = Truth.draw(rng)
    one = held(log(truth, NOISE, attitudes(20, rng), rng, latitude=47.4), truth, rng)
    found = calibrate(one.recording(), latitude=47.4, in_hand=True)
    used = np.array([rest.residual for rest in found.rests if rest.used])
    before = np.array([rest.before for rest in found.rests if rest.used])
    assert np.std(used) < np.std(before)


def test_a_wrong_rate_is_named() -> None:
    """Three equal scale errors of a log without stamps: the rate that explains them."""
    rng = np.random.default_rng(8_801)
    truth = Truth.draw(rng)
    truth.M_g[:] = np.eye(3)
    one = log(truth, NOISE, attitudes(14, rng), rng)
    found = calibrate(one.recording(rate_hz=1.1 * RATE), gravity=GRAVITY)
    (finding,) = (each for each in found.findings if each.code == "rate-suspect")
    assert "--rate 100" in finding.advice


def test_zeroed_and_dead_rates_are_named() -> None:
    """Firmware that subtracts the mean rate of a rest, and one that cuts small rates off."""
    rng = np.random.default_rng(8_802)
    truth = Truth.draw(rng)
    one = log(truth, NOISE, attitudes(14, rng), rng)
    zeroed, dead = one.gyroscope.copy(), one.gyroscope - truth.b_g
    for first, end in one.spans:
        zeroed[first:end] -= zeroed[first:end].mean(axis=0)
    dead[np.abs(dead) < 0.02] = 0.0
    for gyroscope, code in ((zeroed, "zeroed"), (dead, "dead-band")):
        found = calibrate(replace(one, gyroscope=gyroscope).recording(), gravity=GRAVITY)
        assert code in codes(found)
    assert not {"zeroed", "dead-band", "rate-suspect"} & codes(calibrate(one.recording(), gravity=GRAVITY))


def test_one_sided_attitudes_widen_the_bias_of_the_gyroscope() -> None:
    """No rest below the horizon: the mean rate is shared by bias and g-sensitivity."""
    inside = []
    for seed in range(8_810, 8_816):
        rng = np.random.default_rng(seed)
        truth = Truth.draw(rng)
        truth.G[:] = rng.normal(0, 2e-4, (3, 3))
        up = rng.normal(size=(14, 3))
        up[:, 2] = np.abs(up[:, 2]) + 0.3
        one = log(truth, NOISE, up / np.linalg.norm(up, axis=1)[:, None], rng)
        found = calibrate(one.recording(), gravity=GRAVITY)
        hits = truth_inside(truth, one, found)
        inside += [hits[f"g bias_{axis}"] for axis in "xyz"]
    assert np.mean(inside) > 0.8


def test_the_only_rest_of_an_attitude_is_kept_if_it_moved() -> None:
    """Six faces, one of them touched: its movement is an uncertainty of its mean, and is reported."""
    rng = np.random.default_rng(8_830)
    truth = Truth.draw(rng)
    one = log(truth, NOISE, attitudes(6, rng), rng, rest_s=20.0)
    touched = one.accelerometer.copy()
    first, end = one.spans[2]
    touched[(first + end) // 2 : end, int(np.argmin(np.abs(one.f[first])))] += 5e-3
    found = calibrate(replace(one, accelerometer=touched).recording(), gravity=GRAVITY)
    assert all(rest.used for rest in found.rests)
    assert "rest-moved" in codes(found)


def test_a_calibration_that_makes_the_log_worse_is_an_error() -> None:
    """Gravity at the rests before and after, and the turns before and after."""
    _, one = drawn(8_840)
    good = calibrate(one.recording(), gravity=GRAVITY)
    rests = tuple(replace(rest, before=rest.residual / 10, residual=0.05) for rest in good.rests)
    turns = tuple(replace(turn, before_deg=(0.01, 0.01)) if turn.before_deg else turn for turn in good.turns)
    assert good.gyroscope is not None
    unexplained = replace(good.gyroscope, p=1e-3)
    worse = list(worse_than_before(replace(good, rests=rests, turns=turns, gyroscope=unexplained)))
    assert {(finding.level, finding.axis) for finding in worse} == {("error", "accel"), ("error", "gyro")}
    # Directions of gravity that are wrong by as much explain the turns.
    explained = replace(good, turns=turns, gyroscope=replace(good.gyroscope, p=0.5))
    assert not list(worse_than_before(explained))
    assert not list(worse_than_before(good))


@pytest.mark.parametrize(("frequency_hz", "amplitude"), [(20.0, 0.5), (50.3, 0.5)])
def test_a_vibration_is_named_if_there_are_no_rests(frequency_hz: float, amplitude: float) -> None:
    """A vertical vibration is on another axis in each attitude, so that no window looks quiet."""
    rng = np.random.default_rng(8_811)
    one = log(Truth.draw(rng), NOISE, attitudes(12, rng), rng)
    seconds = np.arange(len(one.f)) / RATE
    up = one.f / np.linalg.norm(one.f, axis=1)[:, None]
    wave = amplitude * np.sin(2 * np.pi * frequency_hz * seconds)[:, None] * up
    shaken = replace(one, accelerometer=one.accelerometer + wave)
    with pytest.raises(DataError, match="it vibrates at about") as error:
        calibrate(shaken.recording(), gravity=GRAVITY)
    match = re.search(r"about ([\d.]+) Hz", str(error.value))
    assert match is not None
    # Above half the rate it is folded.
    assert float(match[1]) == pytest.approx(min(frequency_hz, RATE - frequency_hz), abs=0.5)


def test_without_rests_a_moving_imu_does_not_vibrate() -> None:
    rng = np.random.default_rng(8_812)
    one = log(Truth.draw(rng), NOISE, attitudes(12, rng), rng)
    moved = replace(
        one, accelerometer=one.accelerometer + np.cumsum(rng.normal(0, 0.05, one.accelerometer.shape), axis=0)
    )
    with pytest.raises(DataError) as error:
        calibrate(moved.recording(), gravity=GRAVITY)
    assert "vibrates" not in str(error.value)
