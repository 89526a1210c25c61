"""A calibration and a diagnosis report a fault of the sensors with the same code and the same sentence."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imucal import calibrate
from imucal.errors import DataError
from imucal.findings import Finding, as_sentence
from imucal.health import diagnose
from imucal.noise import NoiseModel
from tests.calibration.simulated import GRAVITY, Log, Truth, attitudes, log
from tests.health.cases import row_of

NOISE = NoiseModel.parse("N=2e-3 + B=5e-4"), NoiseModel.parse("N=1.5e-4 + B=2e-5")


@cache
def rested() -> Log:
    """Return a log of 18 rests."""
    rng = np.random.default_rng(8230)
    return log(Truth.draw(rng), NOISE, attitudes(18, rng), rng, rest_s=3.0)


def of_gyroscope(one: Log, code: str) -> Finding:
    """Return the finding of a calibration with a code."""
    findings = calibrate(one.recording(), gravity=GRAVITY).findings
    (found,) = [finding for finding in findings if finding.code == code]
    assert (found.level, found.axis) == ("error", "gyro")
    return found


@pytest.mark.parametrize(
    "order",
    [
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, -1]],
    ],
)
def test_wrong_axes_have_one_sentence(order: list[list[float]]) -> None:
    one = replace(rested(), gyroscope=rested().gyroscope @ np.array(order).T)
    row, found = row_of(diagnose(one.recording()), "axes"), of_gyroscope(one, "axes")
    assert (row.status, row.values["finding"], row.found) == ("fail", found.code, found.text)
    assert found.advice.startswith(row.advice)


def test_a_gyroscope_in_degrees_has_one_sentence() -> None:
    one = replace(rested(), gyroscope=np.degrees(rested().gyroscope))
    row, found = row_of(diagnose(one.recording()), "gyroscope-unit"), of_gyroscope(one, "unit-suspect")
    assert (row.status, row.values["finding"], row.fix) == ("fail", found.code, found.fix)
    assert without_numbers(row.found) == without_numbers(found.text)
    assert found.advice.startswith(row.advice)


def test_an_accelerometer_in_g_has_one_sentence() -> None:
    one = replace(rested(), accelerometer=rested().accelerometer / GRAVITY)
    row = row_of(diagnose(one.recording()), "accelerometer-unit")
    with pytest.raises(DataError) as caught:
        calibrate(one.recording(), gravity=GRAVITY)
    error = caught.value
    assert (row.status, row.values["finding"], (row.fix,)) == ("fail", error.code, error.fixes)
    assert without_numbers(row.found) == without_numbers(as_sentence(error.problem))


def without_numbers(text: str) -> str:
    """Return a sentence with a sign for each measured number."""
    return re.sub(r"\d+\.\d+", "#", text)
