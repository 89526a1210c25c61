"""Simulated rests and the plan of a log: known truth, and intervals as a calibration gives them."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.calibration.known_log import plan_rests, simulate_rests
from imucal.errors import ArgumentError
from imucal.noise import NoiseModel
from imucal.recording import AXES, Sensor
from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run

NOISE = NoiseModel.parse("N=1.5e-4 + B=2e-5"), NoiseModel.parse("N=2e-3 + B=5e-4")
MODELS = {f"{s.short}_{axis}": m for s, m in zip(Sensor, NOISE, strict=True) for axis in AXES}
GRAVITY = 9.80665


def test_the_truth_is_in_the_intervals() -> None:
    """Of twelve logs about 95 % of 30 parameters each; the intervals are as wide as planned."""
    inside, ratios = [], []
    plan = plan_rests(MODELS, 18, rest_s=3.0, rate_hz=50.0, latitude=45.0)
    for seed in range(8500, 8512):
        recording, truth = simulate_rests(NOISE, 18, rest_s=3.0, rate_hz=50.0, seed=seed)
        found = imucal.calibrate(recording, noise=MODELS, gravity=GRAVITY)
        assert found.gyroscope is not None
        assert len(found.rests) == 18
        assert {turn.why for turn in found.turns} <= {"", "wrong"}
        for result, M, b in (
            (found.accelerometer, truth.M_a, truth.b_a),
            (found.gyroscope, truth.M_g, truth.b_g),
        ):
            for name, one in result.parameters.items():
                if name.startswith("g_") or one.low is None or one.high is None:
                    continue
                kind, _, place = name.partition("_")
                i, j = (AXES.index(letter) for letter in (place[0], place[-1]))
                true = {
                    "scale": 100 * (M[i, i] - 1),
                    "misalignment": np.degrees(M[i, j] / M[i, i]),
                    "bias": b[i],
                }[kind]
                inside.append(one.low <= true <= one.high)
        for name in ("misalignment_yx", "bias_z"):
            own, expected = found.accelerometer.parameters[name], plan.accelerometer[name]
            ratios.append((own.half_width or 0.0) / (expected.half_width or 1.0))
    # 12 logs of 21 parameters, correlated within a log.
    assert 0.88 <= np.mean(inside) <= 1.0
    assert 0.7 < np.median(ratios) < 1.4


def test_turns_carry_gravity_exactly() -> None:
    """Without noise and errors the rate explains every direction."""
    quiet = NoiseModel.parse("N=1e-6"), NoiseModel.parse("N=1e-6")
    recording, truth = simulate_rests(quiet, 9, rest_s=2.0, rate_hz=100.0, seed=8520)
    found = imucal.calibrate(
        recording, noise=dict.fromkeys(MODELS, quiet[0]), gravity=GRAVITY, rest_at_least=1.0
    )
    assert found.gyroscope is not None
    np.testing.assert_allclose(found.accelerometer.M, truth.M_a, atol=1e-5)
    residuals = [turn.residual_deg for turn in found.turns if turn.residual_deg]
    assert np.abs(residuals).max() < 1e-3


def test_a_plan_names_attitudes_and_gets_better_with_more_rests() -> None:
    """Faces first; without a gyroscope its part is empty."""
    few, many = (plan_rests(MODELS, count, latitude=45.0) for count in (9, 26))
    assert few.attitudes[0] == "down along -z"
    assert len(set(many.attitudes)) == 26
    for name, one in many.accelerometer.items():
        # Three edges do not show every misalignment.
        assert (one.half_width or 9) < (few.accelerometer[name].half_width or 9)
    accel = {name: model for name, model in MODELS.items() if name.startswith("accel")}
    assert plan_rests(accel, 9).gyroscope == {}
    for models, count, said in ((MODELS, 5, "5 rests can't be calibrated"), ({}, 9, "needs the noise of")):
        with pytest.raises(ArgumentError, match=said):
            plan_rests(models, count)
    with pytest.raises(ArgumentError, match="expected 16 or more"):
        simulate_rests(NOISE, 9, rest_s=0.1)
    with pytest.raises(ArgumentError, match="expected 6 or more"):
        simulate_rests(NOISE, 5)


def test_the_sample_log_is_made_by_its_command(tmp_path: Path) -> None:
    """Byte for byte, with its truth, below 300 kB; the calibration contains the truth."""
    text = (SAMPLE_LOGS / "README.md").read_text(encoding="utf-8")
    command = next(line for line in text.splitlines() if "--rests" in line)

    words = shlex.split(command.partition(" > ")[0])
    done = run(*words[1:], "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    truth = json.loads(done.stdout)
    assert truth == json.loads((SAMPLE_LOGS / "poses-truth.json").read_text(encoding="utf-8"))
    first, second = (imucal.read(place / "poses.mcap") for place in (tmp_path, SAMPLE_LOGS))
    for one, other in zip(first.series, second.series, strict=True):
        np.testing.assert_array_equal(one.samples, other.samples)
    assert (SAMPLE_LOGS / "poses.mcap").stat().st_size < 300_000
    found = imucal.calibrate(second, gravity=GRAVITY)
    scale = found.accelerometer.parameters["scale_z"]
    assert scale.low is not None
    assert scale.high is not None
    assert scale.low < 100 * (truth["calibration"]["M_a"][2][2] - 1) < scale.high


def test_plan_at_the_command_line(tmp_path: Path) -> None:
    """The table fits 80 and 40 columns; JSON has every half-width; wrong options are refused."""
    write_report(tmp_path)
    for columns in ("80", "40"):
        done = run("plan", "still-imucal", "--rests", "12", cwd=tmp_path, COLUMNS=columns)
        assert done.returncode == 0, done.stderr
        assert max(map(len, done.stdout.splitlines())) <= int(columns)
        text = " ".join(done.stdout.split())
        assert "12 rests of 5 s, 1 min 22 s with the turns" in text
        assert "accelerometer misalignment ± " in text
        assert "6 down along +y" in text
        assert "Give --latitude" in text
    document = json.loads(run("plan", "still-imucal", "--rests", "12", "--json", cwd=tmp_path).stdout)
    assert document["schema"] == "imucal/calibration-plan/1"
    assert document["half_widths"]["gyroscope"]["scale_x"]["half_width"] > 0
    assert run("plan", "still-imucal", "--rests", "5", cwd=tmp_path).returncode == 2
    alone = run("plan", "--gyro", "N=1e-4", "--rate", "100", "--rests", "12", cwd=tmp_path)
    assert alone.returncode == 2
    assert "needs the noise of the accelerometer's three axes" in alone.stderr


def test_simulate_at_the_command_line(tmp_path: Path) -> None:
    """The JSON has the errors; options that do not go together are refused."""
    model = ("simulate", "N=1e-4", "--accel", "N=1e-3", "--rests", "9", "--rest", "2s")
    done = run(*model, "-o", "poses.csv", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["duration_s"] == 9 * 2 * 200 // 200 + 8 * 2.0
    gaps = run(*model, "--gap", "1s:1s", "-o", "gaps.csv", cwd=tmp_path)
    assert gaps.returncode == 2
    assert "--gap and --rests exclude each other; omit one" in gaps.stderr
    short = run(*model, "--rest", "0.01s", "-o", "short.csv", cwd=tmp_path)
    assert short.returncode == 2
    assert "expected 16 or more" in short.stderr
