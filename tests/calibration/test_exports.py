"""Exports of a calibration: each file, read as its program reads it, corrects raw samples as imucal does."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

import imucal
from imucal.arrays import FloatArray
from imucal.calibration.accelerometer import fit_accelerometer
from imucal.calibration.document import Intrinsics
from imucal.calibration.exports import CALIBRATION_TARGETS, render_calibration
from imucal.calibration.frames import FRAMES, rotation_to
from imucal.errors import DataError
from imucal.report.exports import render
from imucal.units import G0
from tests.calibration.simulated import GRAVITY, Truth, attitudes
from tests.report.synthetic import consumer_report

if TYPE_CHECKING:
    from collections.abc import Callable

#: Corrected specific force and rate of raw samples, each (n, 3).
Both = tuple[np.ndarray, np.ndarray]
_RNG = np.random.default_rng(8300)
#: Random samples of a random sensor with 1 % errors, and what they mean.
TRUTH = Truth.draw(_RNG)
F, W = _RNG.normal(0, 9, (100, 3)), _RNG.normal(0, 2, (100, 3))
RAW_A, RAW_G = F @ TRUTH.M_a.T + TRUTH.b_a, W @ TRUTH.M_g.T + TRUTH.b_g + F @ TRUTH.G.T


def inverse(M: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(M), dtype=np.float64)


def intrinsics() -> Intrinsics:
    """Return the intrinsics of the truth, and its best diagonal fit at 18 rests."""
    up = attitudes(18, np.random.default_rng(8301))
    means = up * GRAVITY @ TRUTH.M_a.T + TRUTH.b_a
    noise = np.tile(1e-6 * np.eye(18), (3, 1, 1))
    fit = fit_accelerometer(means, noise, gravity=GRAVITY, model="diagonal")
    return Intrinsics(
        source="poses.mcap", topics=("/imu",), kind="mcap", frame="kalibr",
        C_a=inverse(TRUTH.M_a), b_a=TRUTH.b_a, diagonal_C=fit.C, diagonal_b=fit.b,
        C_g=inverse(TRUTH.M_g), b_g=TRUTH.b_g, G=TRUTH.G, gravity=GRAVITY, means=means,
    )  # fmt: skip


FOUND = intrinsics()


def text_of(name: str, *, noise: bool = False) -> str:
    return render_calibration(FOUND, name, consumer_report() if noise else None)


def arrays(node: dict[str, object]) -> dict[str, FloatArray]:
    return {key: np.array(value) for key, value in node.items() if isinstance(value, list)}


def kalibr(text: str) -> Both:
    """raw_a = M a + b; raw_g = M C w + A C a + b. Source: kalibr, IccSensors.py, IccScaledMisalignedImu."""
    node = yaml.safe_load(text)
    accel, gyro = arrays(node["accelerometers"]), arrays(node["gyroscopes"])
    a = np.linalg.solve(accel["M"], (RAW_A - TRUTH.b_a).T).T
    left = RAW_G - TRUTH.b_g - a @ (gyro["A"] @ gyro["C_gyro_i"]).T
    assert np.triu(gyro["M"], 1).max() == 0
    return a, np.linalg.solve(gyro["M"] @ gyro["C_gyro_i"], left.T).T


def openvins(text: str) -> Both:
    """Both inverses keep their lower triangle only. Source: open_vins, State.h (Dm), Propagator.cpp."""
    first, rest = text.split("\n", 1)
    assert first == "%YAML:1.0"
    node = arrays(yaml.safe_load(rest)["imu0"])
    Dw, Da = np.tril(np.linalg.inv(node["Tw"])), np.tril(np.linalg.inv(node["Ta"]))
    a = (RAW_A - TRUTH.b_a) @ Da.T @ node["R_IMUtoACC"]
    return a, (RAW_G - TRUTH.b_g - a @ node["Tg"].T) @ Dw.T @ node["R_IMUtoGYRO"]


def basalt(text: str) -> Both:
    """(I + S) raw - b. Source: basalt-headers, calib_bias.hpp."""
    node = json.loads(text)["value0"]
    a, g = np.array(node["calib_accel_bias"]), np.array(node["calib_gyro_bias"])
    S = np.array([[a[3], 0, 0], [a[4], a[6], 0], [a[5], a[7], a[8]]])
    raw = RAW_G - F @ TRUTH.G.T
    return RAW_A @ (np.eye(3) + S).T - a[:3], raw @ (np.eye(3) + g[3:].reshape(3, 3).T).T - g[:3]


def dlio(text: str) -> Both:
    """Accel = sm raw - bias, gyro = raw - bias. Source: direct_lidar_inertial_odometry, odom.cc."""
    node = yaml.safe_load(text)["dlio"]["imu"]["intrinsics"]
    w = RAW_G - np.array(node["gyro"]["bias"])
    sm = np.array(node["accel"]["sm"]).reshape(3, 3)
    return RAW_A @ sm.T - np.array(node["accel"]["bias"]), (w - F @ TRUTH.G.T) @ FOUND.C_g.T  # type: ignore[union-attr]


def autoware(text: str) -> Both:
    """Raw - offset, the gyroscope only. Source: autoware_imu_corrector, imu_corrector_core.cpp."""
    node = yaml.safe_load(text)["/**"]["ros__parameters"]
    w = RAW_G - np.array([node[f"angular_velocity_offset_{axis}"] for axis in "xyz"])
    return F, (w - F @ TRUTH.G.T) @ FOUND.C_g.T  # type: ignore[union-attr]


def imu_calib(text: str) -> Both:
    """SM raw - bias. Source: imu_calib, accel_calib.cpp."""
    node = yaml.safe_load(text)
    return RAW_A @ np.array(node["SM"]).reshape(3, 3).T - np.array(node["bias"]), W


def fusion(text: str) -> Both:
    """Misalignment ((raw - offset) * sensitivity) in g and deg/s. Source: Fusion, FusionCalibration.h."""
    found = {
        name: np.array(json.loads(value.replace("{", "[").replace("}", "]")))
        for name, value in re.findall(r"(\w+) = \{\.array = (.*)\};", text)
    }
    degree = np.degrees(1.0)
    both = []
    for sensor, raw, unit in (
        ("accelerometer", RAW_A, 1 / G0),
        ("gyroscope", RAW_G - F @ TRUTH.G.T, degree),
    ):
        M, s, b = (found[f"{sensor}{part}"] for part in ("Misalignment", "Sensitivity", "Offset"))
        both.append(((raw * unit - b) * s) @ M.T / unit)
    return both[0], both[1]


def imu_tk(text: str) -> Both:
    """T K (raw - B), in a frame turned by R; returned in ours. Source: imu_tk, calibration.h (load)."""
    both = []
    for name, raw in (("acc", RAW_A), ("gyro", RAW_G - F @ TRUTH.G.T)):
        part = text.partition(f"imu_{name}.calib\n")[2].partition("#")[0]
        values = np.array(part.split(), dtype=float)
        T, K, B = values[:9].reshape(3, 3), values[9:18].reshape(3, 3), values[18:]
        if name == "acc":
            assert np.abs(np.tril(T, -1)).max() < 1e-14
            R = T @ K @ TRUTH.M_a
        both.append((raw - B) @ (T @ K).T @ R)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    return both[0], both[1]


def matlab(text: str) -> Both:
    """Raw = AxesMisalignment/100 true + ConstantBias. Source: MATLAB, imuSensor, algorithms."""
    found = {}
    for name, value in re.findall(r"^(\w+\.\w+) = \[(.*)\];$", text, re.MULTILINE):
        found[name] = np.array([[float(x) for x in row.split(",")] for row in value.split(";")])
    assert text.rstrip().endswith("imu.Gyroscope = gyro;")
    np.testing.assert_array_equal(found["gyro.AccelerationBias"][0], np.diag(TRUTH.G))
    both = []
    for sensor, raw in (("accel", RAW_A), ("gyro", RAW_G - F @ TRUTH.G.T)):
        M = found[f"{sensor}.AxesMisalignment"] / 100
        both.append(np.linalg.solve(M, (raw - found[f"{sensor}.ConstantBias"]).T).T)
    return both[0], both[1]


def own_yaml(text: str) -> Both:
    node = arrays(yaml.safe_load(text)["calibration"])
    f = (RAW_A - node["b_a"]) @ node["C_a"].T
    return f, (RAW_G - node["b_g"] - f @ node["G"].T) @ node["C_g"].T


def python(text: str) -> Both:
    known: dict[str, Callable[..., Both]] = {}
    exec(text, known)  # noqa: S102 - our own file
    return known["correct"](RAW_A, RAW_G)


CONSUMERS = {
    "kalibr": kalibr, "openvins": openvins, "basalt": basalt, "dlio": dlio, "autoware": autoware,
    "imu-calib": imu_calib, "fusion": fusion, "imu-tk": imu_tk, "matlab": matlab, "yaml": own_yaml,
    "python": python,
}  # fmt: skip


@pytest.mark.parametrize("name", CONSUMERS)
def test_a_program_corrects_as_imucal_does(name: str) -> None:
    """To 1e-12, also if the noise numbers are in the same file."""
    for noise in (False, True):
        f, w = CONSUMERS[name](text_of(name, noise=noise))
        np.testing.assert_allclose(f, F, rtol=0, atol=1e-12)
        np.testing.assert_allclose(w, W, rtol=0, atol=1e-12)


@pytest.mark.parametrize("frame", ["imu-tk", "nearest"])
def test_another_frame_is_turned_for_programs_that_need_their_own(frame: str) -> None:
    """Kalibr, OpenVINS, Basalt and imu_tk correct as before; own programs give the vectors in that frame."""
    own = FOUND.in_frame(frame)
    R = rotation_to(frame, FOUND.C_a)
    for name, target in CALIBRATION_TARGETS.items():
        text = render_calibration(own, name)
        if target.frame:
            f, w = CONSUMERS[name](text)
            np.testing.assert_allclose(f, F, rtol=0, atol=1e-12)
            np.testing.assert_allclose(w, W, rtol=0, atol=1e-12)
        elif name in {"yaml", "python"}:
            f, w = CONSUMERS[name](text)
            np.testing.assert_allclose(f, F @ R.T, rtol=0, atol=1e-12)
            np.testing.assert_allclose(w, W @ R.T, rtol=0, atol=1e-12)
        if "misalignment" in target.uses:
            assert f"frame: {FRAMES[target.frame or frame]}" in text
    back = own.in_frame("kalibr")
    for part in ("C_a", "C_g", "G"):
        np.testing.assert_allclose(getattr(back, part), getattr(FOUND, part), atol=1e-14)
    assert replace(own, C_g=None, G=None).in_frame("kalibr").G is None


@pytest.mark.parametrize(
    ("name", "offset", "scale"),
    [("px4", "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE"), ("ardupilot", "INS_ACCOFFS_{}", "INS_ACCSCAL_{}")],
)
def test_autopilots_get_the_diagonal_fit(name: str, offset: str, scale: str) -> None:
    """(raw - OFF) * SCALE; the comment has the size of what is ignored; with all noise parameters."""
    for noise in (False, True):
        text = text_of(name, noise=noise)
        found = dict(re.findall(r"^([A-Z]\w+) (\S+)$", text, re.MULTILINE))
        own = (RAW_A - [float(found[offset.format(x)]) for x in "XYZ"]) * [
            float(found[scale.format(x)]) for x in "XYZ"
        ]
        np.testing.assert_allclose(own, (RAW_A - FOUND.diagonal_b) @ FOUND.diagonal_C.T, rtol=0, atol=1e-12)
        at_rest = (FOUND.means - FOUND.diagonal_b) @ FOUND.diagonal_C.T
        f = (FOUND.means - FOUND.b_a) @ FOUND.C_a.T
        size = np.linalg.norm(at_rest - f, axis=1).max()
        assert f"ignored misalignment: error up to {size:.3g} m/s^2" in text
        gyro = [
            float(found[("CAL_GYRO0_{}OFF" if name == "px4" else "INS_GYROFFS_{}").format(x)]) for x in "XYZ"
        ]
        np.testing.assert_allclose(gyro, TRUTH.b_g, rtol=0, atol=1e-12)
        assert any("NOISE" in key or "NSE" in key for key in found) == noise
    if name == "px4":
        tabs = dict(re.findall(r"^1\t1\t(\w+)\t(\S+)\t9$", text, re.MULTILINE))
        assert tabs == {key: found[key] for key in tabs}
        assert len(tabs) == 9 + 4


def test_autopilots_refuse_counts_and_corrected_samples() -> None:
    """The message has the samples to use."""
    for changes, said in (
        ({"topics": ("sensor_combined",)}, "the autopilot has already corrected sensor_combined; "),
        ({"C_a": FOUND.C_a / 400}, "read it with --accel-scale and --gyro-scale"),
    ):
        for name in ("px4", "ardupilot"):
            with pytest.raises(DataError, match=said):
                render_calibration(replace(FOUND, **changes), name)


def test_the_c_file_compiles_and_corrects(tmp_path: Path) -> None:
    """A program that includes it, without a warning."""
    (tmp_path / "imu_calibration.h").write_text(text_of("c"), encoding="utf-8")
    lines = "\n".join(
        f"  {{ double a[3] = {{{a[0]!r}, {a[1]!r}, {a[2]!r}}}, g[3] = {{{g[0]!r}, {g[1]!r}, {g[2]!r}}};"
        ' imucal_correct(a, g, f, w); for (int i = 0; i < 3; i++) printf("%.17g %.17g\\n", f[i], w[i]); }'
        for a, g in zip(RAW_A[:5].tolist(), RAW_G[:5].tolist(), strict=True)
    )
    head = '#include <stdio.h>\n#include "imu_calibration.h"\n'
    code = f"{head}int main(void) {{\n  double f[3], w[3];\n{lines}\n}}\n"
    (tmp_path / "main.c").write_text(code, encoding="utf-8")
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler here")
    flags = ("-Wall", "-Wextra", "-Werror", "-std=c99")
    subprocess.run([compiler, *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)  # noqa: S603
    out = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout  # noqa: S603
    found = np.array([line.split() for line in out.splitlines()], dtype=float).reshape(5, 3, 2)
    np.testing.assert_allclose(found[..., 0], F[:5], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[..., 1], W[:5], rtol=0, atol=1e-12)


def test_counts_keep_their_scale() -> None:
    """Counts go in, SI comes out; Fusion's sensitivity is in g and deg/s per count."""
    counts = replace(FOUND, C_a=FOUND.C_a / 400, b_a=400 * FOUND.b_a)
    text = render_calibration(counts, "fusion")
    s = re.search(r"accelerometerSensitivity = \{\.array = \{([^}]*)\}", text)
    assert s is not None
    np.testing.assert_allclose(np.array(s[1].split(","), float), np.diag(FOUND.C_a) / 400 / G0, rtol=1e-14)
    assert "raw samples are counts" in text


def test_the_noise_numbers_are_those_of_the_report() -> None:
    """The same lines as the file of the report alone; one set of matrices."""
    for name, target in CALIBRATION_TARGETS.items():
        text = text_of(name, noise=True)
        if not target.noise:
            assert text == text_of(name)
            continue
        alone = render(consumer_report(), name)
        own = [line for line in alone.splitlines() if re.search(r"noise|walk|NOISE|NSE|Noise", line)]
        assert len(own) >= 3
        if target.sign != "json":
            assert [line for line in own if "intrinsics" not in line and line not in text] == []
        else:
            noise = json.loads(alone)["value0"]
            both = json.loads(text)["value0"]
            assert {key: both[key] for key in noise} == noise
    assert text_of("openvins", noise=True).count("Tw:") == 1
    assert "identity" not in text_of("openvins", noise=True)
    assert "no noise numbers: calibrate with --noise REPORT" in text_of("openvins")


def test_what_a_program_has_no_place_for_is_in_the_comment() -> None:
    """g-sensitivity, the gyroscope's scale, weak parameters, a gyroscope without turns or none at all."""
    assert "format has no g-sensitivity: error up to" in text_of("fusion")
    assert "g-sensitivity" not in text_of("kalibr")
    assert "Kalibr does not read M, A and C_gyro_i from imu.yaml" in text_of("kalibr")
    assert "DLIO applies them after its rotation baselink2imu" in text_of("dlio")
    assert "format has no gyroscope scale and misalignment: error up to" in text_of("dlio")
    assert "format has no gyroscope scale and misalignment: error up to" in text_of("autoware")
    assert "ignored misalignment" not in text_of("autoware")
    G = np.array([[1e-4, 0.0, 2e-4], [0.0, 1e-4, -3e-4], [0.0, 0.0, 5e-4]])
    level = np.array([0.01, -0.02, 0.03]) + G[:, 2] * FOUND.gravity
    sensitive = render_calibration(replace(FOUND, G=G, b_g=np.array([0.01, -0.02, 0.03])), "fusion")
    match = re.search(r"starts level, b_g \+ G \[0 0 g\]: \[(.*)\] rad/s", sensitive)
    assert match is not None
    np.testing.assert_allclose([float(each) for each in match[1].split(",")], level, rtol=1e-5)
    weak = replace(FOUND, weak=("gyro scale x",), C_g=None)
    text = render_calibration(weak, "python")
    assert "determined weakly or not at all: gyro scale x" in text
    assert "no usable turn: scale" in text
    warned = replace(FOUND, warnings=("beyond-noise", "turn-wrong"))
    assert "it warns of: beyond-noise, turn-wrong" in render_calibration(warned, "px4")
    assert "it warns of" not in render_calibration(replace(FOUND, warnings=()), "px4")
    assert "no gyroscope" in render_calibration(replace(weak, b_g=None, G=None), "python")


def test_python_writes_the_file(tmp_path: Path) -> None:
    """`imucal.export` takes a calibration; an unknown name lists the others."""
    from tests.calibration.test_calibrate import drawn

    found = imucal.calibrate(drawn(8302)[1].recording(), gravity=GRAVITY)
    (file,) = imucal.export(found, "Kalibr", tmp_path)
    assert file == tmp_path / "imu.yaml"
    assert file.read_text(encoding="utf-8") == render_calibration(Intrinsics.of(found), "kalibr")
    imucal.export(found, "openvins", tmp_path / "o.yaml", noise=consumer_report())
    assert "gyroscope_noise_density" in (tmp_path / "o.yaml").read_text(encoding="utf-8")
    with pytest.raises(imucal.ImucalError, match="'rovio'"):
        imucal.export(found, "rovio", tmp_path)
