"""Tests of `imucal.thermal`: findings, the real chamber record, the document and the pictures."""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from lxml import html
from PIL import Image

import imucal
from imucal.errors import DataError, ReadError, WriteError
from imucal.noise import NoiseModel
from imucal.recording import Recording, Sensor, Source, Temperature
from imucal.temperature import Thermal, thermal
from imucal.temperature.document import from_document, load_thermal, schema, to_document
from imucal.temperature.known_log import KnownEffect, simulate_ramp
from imucal.temperature.table import table
from imucal.temperature.writer import is_thermal, write_thermal
from tests.benchmarks.thermal_schema import thermal_schema
from tests.raising import raises
from tests.real_data import real_data

MODELS = (NoiseModel.parse("N=1e-4 + B=1e-5"), NoiseModel.parse("N=1e-3", Sensor.ACCELEROMETER))


def simulated(
    *, low_c: float = -10.0, high_c: float = 60.0, duration_s: float = 3600.0, rate_hz: float = 2.0
) -> tuple[Recording, KnownEffect]:
    return simulate_ramp(MODELS, low_c=low_c, high_c=high_c, rate_hz=rate_hz, duration_s=duration_s, seed=12)


@pytest.fixture(scope="module")
def ramp() -> tuple[Recording, KnownEffect]:
    return simulated()


@pytest.fixture(scope="module")
def found(ramp: tuple[Recording, KnownEffect]) -> Thermal:
    return imucal.thermal(ramp[0])


def codes(found: Thermal) -> list[str]:
    return [each.code for each in found.findings]


def test_the_known_effect_is_found(ramp: tuple[Recording, KnownEffect], found: Thermal) -> None:
    """Each axis, and the lag, within what is left in unseen parts."""
    _, effect = ramp
    for axis in found.axes:
        temperature = np.linspace(-5.0, 55.0, 9)
        true = effect.bias(axis.sensor, "xyz".index(axis.axis), temperature)
        change = axis.curve.static(temperature)
        assert axis.held_out is not None
        off = (change - change.mean()) - (true - true.mean())
        assert np.abs(off).max() < 3 * axis.held_out + 1e-6
        assert axis.curve.lag_s == pytest.approx(effect.lag_s, rel=0.2)
        assert axis.left < axis.held_out < axis.before
    assert found.verdict == "good"
    assert [branch.heats for branch in found.branches] == [True, False]


def turned(recording: Recording) -> Recording:
    """Return a log in which the IMU falls over by 5 degrees while it heats."""
    angle, series = np.radians(5.0), []
    for one in recording.series:
        samples = one.samples.copy()
        if one.name == "accel_x":
            samples[2000:] += 9.8 * np.sin(angle)
        if one.name == "accel_z":
            samples[2000:] -= 9.8 * (1 - np.cos(angle))
        series.append(replace(one, samples=samples))
    return replace(recording, series=tuple(series))


def two_ways(recording: Recording) -> Recording:
    """Return a log whose cooling has another bias than its heating, without any lag."""
    heat = recording.temperature
    assert heat is not None
    place = (heat.samples - heat.samples.min()) / np.ptp(heat.samples)
    loop = 3e-3 * np.sin(2 * np.pi * place)
    loop[: loop.size // 2] *= -1
    series = [
        replace(one, samples=one.samples + loop) if one.name == "gyro_y" else one for one in recording.series
    ]
    return replace(recording, series=tuple(series))


def coarse(recording: Recording) -> Recording:
    heat = recording.temperature
    assert heat is not None
    return replace(
        recording, temperature=Temperature(samples=np.round(heat.samples / 3) * 3, clock=heat.clock)
    )


def without_effect(recording: Recording) -> Recording:
    rng = np.random.default_rng(3)
    series = [replace(one, samples=1e-4 * rng.standard_normal(one.n)) for one in recording.series[:3]]
    return replace(recording, series=tuple(series))


def corrected(recording: Recording) -> Recording:
    return replace(recording, source=Source(path="a.ulg", format="ulog", topics=("sensor_combined",)))


@pytest.mark.parametrize(
    ("change", "code", "level", "text"),
    [
        (turned, "thermal-attitude", "error", "The IMU turned by 5.1° at 16 min"),
        (two_ways, "thermal-hysteresis", "warning", "Heating and cooling differ by up to 0.00"),
        (coarse, "thermal-steps", "warning", "The temperature has steps of 3 K"),
        (without_effect, "thermal-no-effect", "info", "No effect of temperature beyond noise on gyro_"),
        (corrected, "thermal-corrected", "warning", "Topic sensor_combined contains samples"),
        (lambda one: one.take("30min"), "thermal-one-branch", "warning", "The temperature only rises"),
    ],
)
def test_findings(
    ramp: tuple[Recording, KnownEffect],
    change: Callable[[Recording], Recording],
    code: str,
    level: str,
    text: str,
) -> None:
    """Each disturbance is named, and makes the verdict."""
    result = thermal(change(ramp[0]))
    finding = next(each for each in result.findings if each.code == code)
    assert finding.level == level
    assert finding.text.startswith(text)
    assert result.verdict == {"error": "not-usable", "warning": "check", "info": "good"}[level]


def test_a_fast_and_a_narrow_ramp_are_named() -> None:
    """The finding says how slow the ramp must be."""
    fast = thermal(simulated(duration_s=500.0, rate_hz=20.0)[0])
    finding = next(each for each in fast.findings if each.code == "thermal-fast")
    assert finding.advice.startswith("Heat and cool by less than ")
    narrow = thermal(simulated(low_c=20.0, high_c=32.0)[0])
    assert "thermal-narrow" in codes(narrow)


def test_logs_without_a_ramp_are_refused(ramp: tuple[Recording, KnownEffect]) -> None:
    """No temperature, a steady one, or too few samples."""
    recording = ramp[0]
    with raises(DataError, "the log has no temperature"):
        thermal(replace(recording, temperature=None))
    with raises(DataError, "the temperature spans only 3 K, expected at least 5 K"):
        thermal(simulated(low_c=20.0, high_c=23.0)[0])
    with raises(DataError, "samples are too few"):
        thermal(simulated(duration_s=60.0, rate_hz=2.0)[0])


def test_the_real_record_is_twice_as_good_as_a_cubic_on_half_of_the_axes() -> None:
    """In unseen halves of branches; no axis is more than 5 % worse than the cubic of flight stacks."""
    recording = imucal.read(real_data("thermal", "chamber_ramp.csv"), time_unit="us")
    result = thermal(recording)
    ratios = {
        one.name: one.cubic_held_out / one.held_out
        for one in result.axes
        if one.cubic_held_out is not None and one.held_out is not None
    }
    assert min(ratios.values()) > 1 / 1.05
    assert sum(ratio > 1.95 for ratio in ratios.values()) >= 3
    assert [branch.heats for branch in result.branches] == [False, True, False]
    assert {"thermal-fast", "thermal-hysteresis"} <= set(codes(result))


def test_a_document_is_read_back(found: Thermal, tmp_path: Path) -> None:
    """Exports and corrections use the same curves; a wrong document is refused with its place."""
    document = json.loads(json.dumps(to_document(found)))
    again = from_document(document)
    for one, other in zip(found.axes, again.axes, strict=True):
        temperature = np.linspace(-20.0, 70.0, 11)
        assert np.array_equal(
            one.curve.bias(temperature, temperature - 3), other.curve.bias(temperature, temperature - 3)
        )
    assert to_document(again)["findings"] == document["findings"]
    document["axes"][0]["curve"]["kind"] = "odd"
    with raises(ReadError, r"axes\[0\].curve.kind"):
        from_document(document)
    (tmp_path / "thermal.json").write_text("{", encoding="utf-8")
    with raises(ReadError, "can't be read"):
        load_thermal(tmp_path)


def test_a_recording_is_compensated(
    ramp: tuple[Recording, KnownEffect], found: Thermal, tmp_path: Path
) -> None:
    """Noise is left; a second time is refused, and an export of the result is that of the document."""
    corrected = imucal.apply(found, ramp[0])
    assert corrected["gyro_z"].samples.std() == pytest.approx(1e-4 * 2**0.5, rel=0.1)
    assert corrected["accel_z"].samples.mean() == pytest.approx(9.81, abs=0.2)
    with raises(DataError, "it is already corrected"):
        imucal.apply(found, corrected)
    (path,) = imucal.export(found, "yaml", tmp_path / "bias.yaml")
    assert "gyro_x:" in path.read_text(encoding="utf-8")


def test_documents_are_valid_by_the_schema(found: Thermal) -> None:
    """The schema refuses other verdicts."""
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    validator.validate(to_document(found))
    with pytest.raises(jsonschema.ValidationError):
        validator.validate({**to_document(found), "verdict": "maybe"})


def test_the_schema_file_is_current() -> None:
    """Run `python -m tests.benchmarks.thermal_schema` after a change of the dataclasses."""
    assert schema() == thermal_schema()


def test_the_folder(found: Thermal, tmp_path: Path) -> None:
    """Document, page and pictures; another folder is not overwritten."""
    files = write_thermal(found, tmp_path / "out")
    assert [file.name for file in files] == [
        "thermal.json", "thermal-gyro.png", "thermal-accel.png", "thermal.html",
    ]  # fmt: skip
    assert is_thermal(tmp_path / "out")
    assert not is_thermal(tmp_path)
    page = html.fromstring((tmp_path / "out" / "thermal.html").read_text(encoding="utf-8"))
    assert [cell.text for cell in page.xpath("//tbody/tr/th")] == [axis.name for axis in found.axes]
    assert len(page.xpath("//img[@alt]")) == 2
    size = Image.open(io.BytesIO(files[1].read_bytes())).size
    assert size[0] == 1600
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thermal.json").write_text("{}", encoding="utf-8")
    with raises(WriteError, "other"):
        write_thermal(found, tmp_path / "other")


def test_the_table_fits_the_terminal(found: Thermal) -> None:
    """A table at 80 columns, a paragraph for each axis at 40."""
    assert table(found, 80).splitlines()[0].startswith("axis     before")
    assert max(map(len, table(found, 80).splitlines())) <= 80
    assert max(map(len, table(found, 40).splitlines())) <= 40
    assert table(found, 40).count("gyro_x:") == 1
    assert repr(found).startswith("simulated: good, -9.6 to 59.6 °C")
