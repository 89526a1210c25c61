"""Curves that other tools made."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import deviation_table
from imucal.allan.curve import AllanCurve
from imucal.allan.deviation_table import read_curve
from imucal.errors import ReadError
from imucal.fitting import FitSettings
from imucal.fitting.moments import fit_gmwm
from imucal.recording import Sensor
from tests.real_data import real_data


def _write(folder: Path, text: str) -> Path:
    path = folder / "curve.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_a_table_with_headings_and_units(tmp_path: Path) -> None:
    """Units are turned into SI; counts and limits are passed over."""
    text = (
        "# made by a tool\ntau [s], n, gyro_x [deg/s], gyro_x_low, accel_z [mg]\n"
        "0.01, 99, 2, 1, 3\n0.02, 98, 1, 0, 2\n"
    )
    gyro, accel = read_curve(_write(tmp_path, text))
    assert (gyro.name, gyro.sensor, gyro.unit) == ("gyro_x", Sensor.GYROSCOPE, "rad/s")
    npt.assert_allclose(gyro.curve.adev, np.deg2rad([2, 1]))
    assert (accel.name, accel.sensor, accel.unit) == ("accel_z", Sensor.ACCELEROMETER, "m/s^2")
    npt.assert_allclose(accel.curve.adev, np.array([3, 2]) * 9.80665e-3)
    assert gyro.curve.m.tolist() == [1, 2]
    assert gyro.curve.computed == "given"


@pytest.mark.parametrize("separator", [",", ";", "\t", "   "])
def test_reads_numbers_alone_with_any_separator(tmp_path: Path, separator: str) -> None:
    """Without headings the first column is tau; without a unit nothing is turned."""
    text = "\n".join(separator.join(row) for row in (("1", "3"), ("2", "2"), ("4", "1")))
    (curve,) = read_curve(_write(tmp_path, text))
    assert (curve.name, curve.sensor, curve.unit) == ("column 2", None, "")
    npt.assert_array_equal(curve.curve.adev, [3, 2, 1])
    assert np.all(np.isnan(curve.curve.edf))
    assert curve.curve.n == 0
    assert [finding.text for finding in curve.findings] == [
        "The sampling period is assumed to be the shortest averaging time, 1 s."
    ]


def test_variances_and_missing_numbers_and_order(tmp_path: Path) -> None:
    """A column called avar holds variances; empty cells are left out; rows are put in order."""
    (trailing,) = read_curve(_write(tmp_path, "tau,adev,\n1,2,\n2,1,\n"))
    npt.assert_array_equal(trailing.curve.adev, [2, 1])
    (curve,) = read_curve(_write(tmp_path, "tau,avar\n4,1\n2,\n1,4\n"), rate_hz=10)
    npt.assert_array_equal(curve.curve.tau, [1, 4])
    npt.assert_array_equal(curve.curve.m, [10, 40])
    npt.assert_array_equal(curve.curve.avar, [4, 1])
    assert curve.findings == ()


def test_times_that_are_no_multiples_make_a_fine_grid(tmp_path: Path) -> None:
    """The noise is then continuous, and the finding says so."""
    (curve,) = read_curve(_write(tmp_path, "1,3\n1.5,2\n2.3,1\n"))
    npt.assert_array_equal(curve.curve.m, [1000, 1500, 2300])
    assert curve.findings[0].text == (
        "Averaging times are not multiples of 1 s, so the sampling period is unknown. The fit "
        "assumes continuous noise."
    )
    assert curve.findings[0].advice == "Give the sampling rate."


def test_times_within_a_part_in_fifty_of_a_multiple_are_multiples(tmp_path: Path) -> None:
    """Printed with few digits they are; the tolerance is of the multiple."""
    limit = deviation_table._MULTIPLE
    (near,) = read_curve(_write(tmp_path, f"1,3\n{3 * (1 + 0.99 * limit)!r},2\n"))
    (far,) = read_curve(_write(tmp_path, f"1,3\n{3 * (1 + 1.01 * limit)!r},2\n"))
    assert near.curve.m.tolist() == [1, 3]
    assert far.curve.m[0] == 1000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "{path}: is empty; expected a table of tau and deviations"),
        (
            "tau,adev\n",
            "{path}: has 0 rows of 0 columns; expected at least 2 rows of tau and one or more deviations",
        ),
        ("1,2\n2,x\n", "{path}:2: column 'column 2' is 'x', expected a number"),
        ("1,2\n2,1,3\n", "{path}:2: has 3 columns, other lines have 2; expected the same number"),
        ("tau,a,b\n1,2\n2,1\n", "{path}:2: has 2 columns, other lines have 3; expected the same number"),
        ("1,2\n1,1\n", "{path}: averaging time 1 s is duplicated; expected each once"),
        ("0,2\n1,1\n", "{path}: averaging times must be positive numbers in s, got 0 to 1"),
        ("tau,n\n1,2\n2,1\n", "{path}: no column of deviations next to 'tau'; found tau, n"),
        ("1,-2\n2,-1\n", "{path}: column 'column 2' has no positive number; expected Allan deviations"),
        (
            "tau,gyro_x [furlong]\n1,2\n2,1\n",
            (
                "{path}: column 'gyro_x [furlong]' is in 'furlong'; expected one of rad/s, mrad/s, deg/s, "
                "mdeg/s, deg/h, m/s^2, g, mg, ug"
            ),
        ),
    ],
)
def test_refuses_what_is_no_curve(tmp_path: Path, text: str, message: str) -> None:
    """Each message says where, what was found and what was expected."""
    path = _write(tmp_path, text)
    with pytest.raises(ReadError) as caught:
        read_curve(path)
    assert str(caught.value) == message.format(path=path)


def test_refuses_files_that_are_not_text(tmp_path: Path) -> None:
    """A missing file and a binary one are two messages."""
    with pytest.raises(ReadError, match=r"nothing\.csv: can't be read: No such file or directory$"):
        read_curve(tmp_path / "nothing.csv")
    path = tmp_path / "curve.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ReadError, match=r"is not a text table \(byte 0 is not UTF-8\)"):
        read_curve(path)


def test_the_known_truth_of_a_published_curve_is_found() -> None:
    """ori-drs/allan_variance_ros, 11000 s at 400 Hz, simulated: N and K of six axes, adjacent windows.

    All twelve truths lie inside their 95 % intervals (of twelve, fewer than ten would be beyond
    three standard errors). The tool's own fit is 1 to 2 % high in N and 30 to 61 % in K.
    """
    path = real_data("curves", "ori_drs_simulated", "allan_variance.csv")
    curves = read_curve(path, rate_hz=400.0)
    n = 400 * 11_000
    truth = {
        "m/s^2": {"N": 2.5019929573561175e-3, "K": 6.972435158192731e-5},
        "rad/s": {"N": 1.888339269965301e-4, "K": 2.5565313322052523e-6},
    }
    assert len(curves) == 6
    # The table has neither headings nor counts: accelerations in m/s², rates in deg/s; n/m windows less one.
    for named, unit in zip(curves, ["m/s^2"] * 3 + ["rad/s"] * 3, strict=True):
        m, factor = named.curve.m, np.pi / 180 if unit == "rad/s" else 1.0
        edf = np.maximum((n - 2 * m + 1) / m, 1.0)
        avar = factor**2 * named.curve.avar
        curve = replace(named.curve, avar=avar, edf=edf, n=n, estimator="standard", edf_method="eta3")
        fit = fit_gmwm(None, curve, FitSettings())
        assert str(fit.model) == "N + K"
        for key, value in truth[unit].items():
            assert fit[key].low <= value <= fit[key].high
        assert fit["N"].value == pytest.approx(truth[unit]["N"], rel=0.005)
        assert fit["K"].value == pytest.approx(truth[unit]["K"], rel=0.3)


@pytest.mark.parametrize("device", ["16448", "A3", "N3", "gx4", "xsens"])
def test_published_curves_of_real_sensors_are_met_at_one_second(device: str) -> None:
    """imu_utils publishes sigma(1 s) as N, which holds B and K too: the model's is within 10 % of it.

    Its own values are 0 to 8 % off the curves they were read from. The curve itself is met to 4 %
    at 1 s, although several of these sensors have output filters.
    """
    folder = real_data("curves", "imu_utils")
    published = re.findall(r"gyr_n: *([\d.e+-]+)", (folder / f"{device}_imu_param.yaml").read_text())
    tau = np.loadtxt(folder / f"data_{device}_gyr_t.txt")
    adev = np.deg2rad(np.loadtxt(folder / f"data_{device}_gyr_x.txt")) / 3600
    m = np.round(tau / tau[0]).astype(np.int64)
    curve = AllanCurve(tau=tau, m=m, avar=adev**2, edf=np.full(tau.size, np.nan), n=0)
    fit = fit_gmwm(None, curve, FitSettings(model="N + B + K"))
    at_one = float(np.sqrt(fit.model.avar(np.array([1 / tau[0]]), rate_hz=fit.rate_hz))[0])
    assert at_one == pytest.approx(float(published[1]), rel=0.10)
    assert at_one == pytest.approx(np.exp(np.interp(0, np.log(tau), np.log(adev))), rel=0.04)
    assert fit["N"].value is not None
    assert fit["N"].value < at_one


def test_without_a_heading_of_times_the_first_column_is_taken(tmp_path: Path) -> None:
    """Wherever it stands, one that is called so is taken instead."""
    for text in ("window,gyro_x\n1,4\n2,3\n", "gyro_x,tau\n4,1\n3,2\n"):
        (curve,) = read_curve(_write(tmp_path, text))
        assert curve.name == "gyro_x"
        assert (curve.curve.tau.tolist(), curve.curve.avar.tolist()) == ([1, 2], [16, 9])
