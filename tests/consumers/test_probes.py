"""Exports run by the target programs themselves, if an interpreter can import them."""

import math
import re
from pathlib import Path

import pytest

from imucal.report.exports import export
from tests.consumers.probes import interpreters, probe
from tests.report.downstream import READERS, qgroundcontrol
from tests.report.synthetic import consumer_report

_NONE = "no interpreter has {}; pip install it, or name one in IMUCAL_CONSUMERS"


def test_gtsam_integrates_the_noise_of_the_export(tmp_path: Path) -> None:
    """After one second the attitude has the standard deviation sqrt(N^2 + K^2/3), in GTSAM 4.2 and 4.3.

    Along gravity, only the accelerometer affects the velocity. Preintegration is exact up to one step per
    second, 0.5 %; GTSAM 4.2 would be wrong by a factor of 6000 without its setter.
    """
    (file,) = export(consumer_report(), "gtsam", tmp_path)
    given = READERS["gtsam"](file)
    pythons = list(interpreters("gtsam"))
    if not pythons:
        pytest.skip(_NONE.format("gtsam"))
    for python in pythons:
        found = probe(python, "gtsam", file)
        gyro = math.hypot(given["gyro", "N"], given["gyro", "K"] / math.sqrt(3))
        accel = math.hypot(given["accel", "N"], given["accel", "K"] / math.sqrt(3))
        assert found["attitude"] == pytest.approx([gyro] * 3, rel=5e-3), found["version"]
        assert found["velocity"][2] == pytest.approx(accel, rel=5e-3), found["version"]
        assert found["bias_gyro"] == pytest.approx([given["gyro", "K"]] * 3, rel=1e-6), found["version"]


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_pymavlink_loads_the_parameters(target: str, tmp_path: Path) -> None:
    """The parser skips the four lines for QGroundControl and reads all others."""
    (file,) = export(consumer_report(), target, tmp_path)
    pythons = list(interpreters("pymavlink"))
    if not pythons:
        pytest.skip(_NONE.format("pymavlink"))
    for python in pythons:
        found = probe(python, "pymavlink", file)
        text = file.read_text()
        rows = re.findall(r"^(EK\w+) (\S+)$", text, re.MULTILINE)
        assert found["parameters"] == {name: float(value) for name, value in rows}
        assert found["invalid_lines"] == len(qgroundcontrol(text))
