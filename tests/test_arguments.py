"""Tests of invalid arguments of public functions, and of the representation of values."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.errors import ArgumentError, DataError
from imucal.findings import Finding
from imucal.fitting import NoiseFit
from imucal.pipeline import characterize
from tests.raising import raises

RECORDING = imucal.simulate("N=1e-4 + B=2e-5", rate_hz=20.0, duration=120.0)


@cache
def still() -> imucal.Report:
    """Return the report of the recording."""
    return imucal.fit(RECORDING, model="N")


def fit_of_x() -> NoiseFit:
    """Return the fit of its first axis."""
    return still()["gyro_x"].fit


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: imucal.allan_curve(RECORDING), "type imucal.allan_curve(recording['gyro_x'])"),  # type: ignore[arg-type]
    (lambda: imucal.fit(RECORDING, axis="x"), 'for one axis type imucal.fit(recording["gyro_x"])'),  # type: ignore[call-overload]
    (lambda: imucal.fit(RECORDING, modl="N"), "fit: there is no option 'modl'; expected one of model"),  # type: ignore[call-overload]
    (lambda: imucal.fit(RECORDING["gyro_x"].samples), "an array has no sampling rate"),
    (lambda: imucal.export(RECORDING, "kalibr", "out"), "found Recording, expected a report"),  # type: ignore[arg-type]
    (lambda: imucal.check(RECORDING, "N = 1"), "type imucal.fit(recording) to make one"),  # type: ignore[arg-type]
    (lambda: imucal.check(still()), "nothing to check against"),
    (lambda: imucal.drift(RECORDING), "type imucal.drift(imucal.fit(recording))"),  # type: ignore[arg-type]
    (imucal.read, "no log: name at least one file"),
    (lambda: imucal.simulate("N=1e-4", rate_hz=-1.0), "type simulate(model, rate_hz=200.0)"),
    (lambda: imucal.simulate("Z=1e-4"), "is not understood; write a sum such as"),
    (lambda: still()["gyro_x"]["N"].in_units("deg"), "'deg' is no unit of N; expected one of rad/s/sqrt(Hz)"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), WRONG, ids=[message for _, message in WRONG])
def test_the_error_for_an_invalid_argument_contains_advice(call: Callable[[], object], message: str) -> None:
    """It is an ArgumentError, which is also a ValueError."""
    with pytest.raises(ArgumentError) as caught:
        call()
    assert message in str(caught.value)


def test_what_users_print_has_at_most_twelve_short_lines(tmp_path: Path) -> None:
    """It is what the public functions return, and the parts of a report."""
    path = tmp_path / "log.csv"
    imucal.simulate("N=1e-4", rate_hz=10.0, duration="1min", path=path)
    axis = still()["gyro_x"]
    values: list[object] = [
        *(RECORDING, RECORDING["gyro_x"], still(), axis, axis["N"], axis.fit, axis.fit.curve, axis.fit.model),
        *(imucal.plan(still()), imucal.compare(still(), still()), imucal.drift(still()), imucal.info(path)),
        *(imucal.check(still(), "[gyroscope]\nN = { max = 1e-4 }\n"), imucal.sensor("BMI088")),
        imucal.decompose(RECORDING["gyro_x"], axis.fit),
    ]
    for value in values:
        lines = repr(value).splitlines()
        assert len(lines) <= 12, type(value)
        assert max(map(len, lines)) <= 250, type(value)
    assert "N  " in repr(axis)


def test_a_report_is_written_and_loaded_by_the_name_of_its_folder(tmp_path: Path) -> None:
    """The name may be a string."""
    imucal.write_report(still(), str(tmp_path / "out"), formats=(), html=False)
    assert imucal.load_report(str(tmp_path / "out"))["gyro_x"]["N"].value == still()["gyro_x"]["N"].value


def test_an_estimate_is_converted_to_other_units() -> None:
    """The default is the data-sheet unit; limits are converted, and a bound has no value."""
    white, flicker = still()["gyro_x"]["N"], fit_of_x()["B"]
    assert white.value is not None
    sheet = white.in_units()
    assert sheet.unit == "deg/sqrt(h)"
    assert sheet.value == pytest.approx(white.value * 3437.7467707849396)
    assert sheet.high == pytest.approx(white.high * 3437.7467707849396)
    assert white.in_units("mdps/rtHz").value == pytest.approx(white.value * 57295.779513082325)
    assert flicker.in_units("deg/h").value == (
        flicker.value and pytest.approx(flicker.value * 206264.80624709636)
    )


def test_a_recording_has_a_rate_if_its_axes_share_one(tmp_path: Path) -> None:
    """The simulated log can be read back; the error lists different rates."""
    assert RECORDING.rate_hz == 20.0
    path = tmp_path / "log.mcap"
    made = imucal.simulate(
        "N=0.3deg/sqrt(h)", "N=60ug/sqrt(Hz)", rate_hz=50.0, duration="20s", seed=4, path=path
    )
    assert imucal.read(path)["accel_z"].samples == pytest.approx(made["accel_z"].samples)
    other = imucal.AxisSeries.from_samples(made["gyro_x"].samples, rate_hz=10.0, sensor="accelerometer")
    mixed = imucal.Recording(source=made.source, series=(made["gyro_x"], other))
    with pytest.raises(DataError, match="no common rate: gyro_x 50 Hz, accel_x 10 Hz"):
        _ = mixed.rate_hz


def test_uncertain_or_moved_noise_is_only_exported_by_force(tmp_path: Path) -> None:
    """As on the command line, nothing is written, and the error contains the next step."""
    axis = still()["gyro_x"]
    white = replace(axis["N"], low=1e-5, high=1e-3)
    fit = replace(axis.fit, estimates=(white, *axis.fit.estimates[1:]))
    vague = replace(still(), axes=(replace(axis, fit=fit), *still().axes[1:]))
    moving = [replace(one, samples=one.samples + np.sin(np.arange(one.n) / 9)) for one in RECORDING.series]
    moved = characterize(replace(RECORDING, series=tuple(moving)))
    for report, code in ((vague, "uncertain"), (moved, "not-noise")):
        with raises(DataError, code=code, place=report.source.path, argument="force") as caught:
            imucal.export(report, "kalibr", tmp_path / "imu.yaml")
        assert "smoothing" not in str(caught.value)
        assert list(tmp_path.iterdir()) == []
    two_levels = Finding("warning", "two-levels", "The spectrum has two explanations.", axis="gyro_x")
    with raises(DataError, "switch off filters and smoothing", code="uncertain"):
        imucal.export(replace(vague, findings=(two_levels,)), "kalibr", tmp_path / "imu.yaml")
    (file,) = imucal.export(vague, "kalibr", tmp_path / "imu.yaml", force=True)
    assert file.is_file()
