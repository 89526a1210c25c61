"""What `imucal adev` prints can be fitted again."""

import json
from pathlib import Path

import numpy.testing as npt
import pytest

from imucal.allan import allan_curve
from imucal.allan.deviation_table import COLUMNS, is_adev_table, read_adev_table
from imucal.errors import ReadError
from imucal.readers import read
from tests.cli.run import SAMPLE_LOGS, run


def test_the_curves_of_a_log_come_back(tmp_path: Path) -> None:
    """Times, factors, deviations and degrees of freedom, to the printed digits."""
    log = SAMPLE_LOGS / "too_short.db3"
    table = tmp_path / "curves.csv"
    table.write_text(run("adev", "-q", str(log), cwd=tmp_path).stdout, encoding="utf-8")
    assert is_adev_table(table)
    curves = {named.name: named for named in read_adev_table(table)}
    for series in read(log).series:
        made, found = allan_curve(series), curves[series.name].curve
        assert curves[series.name].unit == series.unit
        npt.assert_array_equal(found.m, made.m)
        npt.assert_allclose(found.adev, made.adev, rtol=1e-8)
        npt.assert_allclose(found.edf, made.edf, rtol=1e-5)


def test_a_table_of_several_axes_is_fitted_from_the_command_line(tmp_path: Path) -> None:
    """One block of terms for each axis, in SI."""
    curves = run("adev", "-q", str(SAMPLE_LOGS / "too_short.db3"), cwd=tmp_path).stdout
    (tmp_path / "curves.csv").write_text(curves, encoding="utf-8")
    done = run("fit", "-q", "curves.csv", "--model", "N + B + K", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("N + B + K (gmwm") == 6
    assert done.stdout.startswith("gyro_x, rad/s: ")
    assert done.stdout.count("for a filter that coasts for 1 min: white noise ") == 6
    (first, *_) = json.loads(run("fit", "-q", "curves.csv", "--json", cwd=tmp_path).stdout)
    assert [(pair["horizon_s"], pair["basis"]) for pair in first["filter_numbers"]] == [
        (60.0, "curve"),
        (300.0, "curve"),
    ]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "{path}: has no rows below its heading"),
        (["gyro_x,1"], "{path}: a line is 'gyro_x,1'; expected values of axis, tau, m, adev, low, high, edf"),
        (
            ["gyro_x,2,2,1,1,1,9", "gyro_x,1,1,1,1,1,9"],
            "{path}: axis gyro_x: tau must increase; expected each averaging time once, in increasing order",
        ),
    ],
)
def test_a_damaged_table_is_refused(lines: list[str], message: str, tmp_path: Path) -> None:
    """With the place and what was expected."""
    path = tmp_path / "curves.csv"
    path.write_text("\n".join([",".join(COLUMNS), *lines]), encoding="utf-8")
    with pytest.raises(ReadError) as caught:
        read_adev_table(path)
    assert str(caught.value) == message.format(path=path)


def test_an_axis_of_another_name_keeps_its_own_unit(tmp_path: Path) -> None:
    """Only gyro and accel are known to be SI."""
    path = tmp_path / "curves.csv"
    path.write_text(",".join(COLUMNS) + "\ntemp,1,1,0.5,0.4,0.6,9\n", encoding="utf-8")
    (named,) = read_adev_table(path)
    assert (named.sensor, named.unit) == (None, "")
