"""Tests of the pipeline from a recording to a report: axes, findings and coverage."""

import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from imucal.clock import Clock
from imucal.errors import ArgumentError, DataError
from imucal.findings import Finding
from imucal.fitting.regressors import TemperatureEffect
from imucal.noise import NoiseModel
from imucal.pipeline import Settings, _workers, characterize, screen
from imucal.readers import read
from imucal.recording import Axis, AxisSeries, Recording, Source, Temperature
from imucal.report.json_file import to_document
from imucal.report.result import AxisReport, Report
from imucal.report.typed_json import dumps

SAMPLE_LOGS = Path(__file__).parents[1] / "sample_logs"
TRUTH = json.loads((SAMPLE_LOGS / "truth.json").read_text(encoding="utf-8"))


@cache
def analysed(log: str) -> Report:
    """Return the report of a sample log, at a level whose intervals cover all coefficients."""
    return characterize(read(SAMPLE_LOGS / log), Settings(level=0.999))


def recording_of(*series: AxisSeries) -> Recording:
    """Return a recording of series."""
    return Recording(source=Source(path="made.csv", format="csv"), series=series)


def covers(axis: AxisReport, truth: NoiseModel) -> dict[str, bool]:
    """Return for each true coefficient whether its interval covers it."""
    found = {}
    for term in truth.terms:
        estimate = axis.fit[term.symbol]
        found[term.symbol] = estimate.low <= term.coefficient <= estimate.high
    return found


@pytest.mark.parametrize("log", sorted(TRUTH))
def test_intervals_cover_the_truth_of_the_sample_logs(log: str) -> None:
    """The level is 99.9 %; at 95 % one in twenty would miss."""
    truth = TRUTH[log]
    report = analysed(log)
    assert len(report.axes) == 6
    for axis in report.axes:
        model = NoiseModel.parse(truth[axis.sensor]["model"])
        assert all(covers(axis, model).values()), (axis.name, covers(axis, model), axis.fit.estimates)
        for symbol in ("N", "B", "K"):
            assert axis.fit[symbol].high > 0


def test_absent_terms_of_a_sample_log_are_bounded() -> None:
    """The log is twenty seconds of white noise."""
    report = characterize(read(SAMPLE_LOGS / "too_short.db3"))
    for axis in report.axes:
        assert axis.fit["N"].status == "estimated"
        assert {axis.fit[symbol].status for symbol in "BK"} == {"bounded"}


def test_gaps_are_reported_with_the_axes() -> None:
    """Three gaps are found at their places."""
    report = analysed("with_gaps.csv")
    for axis in report.axes:
        assert [gap.start_s for gap in axis.gaps] == pytest.approx([20.0, 60.0, 110.0])
        assert [gap.duration_s for gap in axis.gaps] == pytest.approx([1.5, 0.2, 4.0])
    assert "gaps" in {finding.code for finding in report.findings}


def test_an_unusable_axis_does_not_stop_the_others() -> None:
    """It is reported in a finding."""
    rng = np.random.default_rng(5)
    good = AxisSeries.from_samples(rng.normal(size=4096), rate_hz=100.0, axis="x")
    dead = AxisSeries.from_samples(np.full(4096, np.nan), rate_hz=100.0, axis="y")
    report = characterize(recording_of(good, dead))
    assert [axis.name for axis in report.axes] == ["gyro_x"]
    (finding,) = [finding for finding in report.findings if finding.axis == "gyro_y"]
    assert finding.code == "no-result"
    assert finding.text == "No usable samples among 4096: all are NaN, infinite or absurdly large."
    assert finding.advice == "Check the driver or the choice of columns."


def test_a_recording_without_any_usable_axis_is_an_error() -> None:
    """The reason appears once."""
    dead = [AxisSeries.from_samples(np.full(64, np.nan), rate_hz=100.0, axis=axis) for axis in ("x", "y")]
    with pytest.raises(DataError) as caught:
        characterize(recording_of(*dead))
    assert str(caught.value) == (
        "made.csv: no axis can be analysed: gyro_x, gyro_y: no usable samples among 64: "
        "all are NaN, infinite or absurdly large"
    )


@pytest.mark.parametrize("n", [5000, (1 << 20) + 1])
def test_a_constant_axis_is_rejected(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error does not depend on its length; a long axis is rejected before any calculation."""
    still = AxisSeries.from_samples(np.full(n, 0.25), rate_hz=100.0)
    recording = Recording(source=Source(path="log.csv", format="csv"), series=(still,))
    if n > 5000:
        monkeypatch.delattr("imucal.pipeline.allan_curve")
    with pytest.raises(DataError, match=f"gyro_x: all {n} samples are equal"):
        characterize(recording)


def test_a_report_does_not_depend_on_the_unit_of_the_samples() -> None:
    """Scaling the samples by 1e-9 only scales every coefficient."""
    samples = NoiseModel.parse("N=1e-3 + K=1e-4").simulate(
        20_000, rate_hz=100.0, rng=np.random.default_rng(3)
    )
    fits = [
        characterize(recording_of(AxisSeries.from_samples(samples * scale, rate_hz=100.0))).axes[0].fit
        for scale in (1.0, 1e-9)
    ]
    assert str(fits[0].model) == str(fits[1].model)
    for symbol in ("N", "B", "K"):
        assert fits[1][symbol].high == pytest.approx(fits[0][symbol].high * 1e-9, rel=1e-4)


def test_a_failed_second_opinion_keeps_the_result() -> None:
    """The curve of alternating samples has no noise model; the finding contains the reason."""
    rng = np.random.default_rng(2)
    samples = np.where(np.arange(400) % 2, 1.0, -1.0) + 1e-9 * rng.normal(size=400)
    log = recording_of(AxisSeries.from_samples(samples, rate_hz=100.0))
    report = characterize(log, Settings(second_opinion=True))
    (finding,) = [f for f in report.axes[0].findings if f.code == "second-opinion"]
    assert finding.axis == "gyro_x"
    assert finding.text == (
        "The fit of the Allan curve failed: an output filter or lines dominate the Allan variance; "
        "found 0 averaging times that show the noise, expected at least 4; record for longer."
    )


@pytest.mark.parametrize(("seconds", "code"), [(15, "touch"), (30, "motion")])
@pytest.mark.parametrize("settings", [Settings(), Settings(model="N + GM"), Settings(method="gmwm")])
def test_a_moved_log_is_fitted_by_slopes(seconds: int, code: str, settings: Settings) -> None:
    """Its numbers must not be used, and a search for a model of motion is slow."""
    rng = np.random.default_rng(3_911)
    t = np.arange(6000) / 50
    shaken = 0.5 * np.sin(8 * t) * (t < seconds)
    samples = rng.normal(0, 1e-3, (2, t.size)) + shaken
    axes: tuple[Axis, ...] = ("x", "y")
    gyro = [
        AxisSeries.from_samples(values, rate_hz=50.0, axis=axis)
        for axis, values in zip(axes, samples, strict=True)
    ]
    report = characterize(recording_of(*gyro), settings)
    assert [finding.code for finding in report.findings] == [code]
    assert [axis.fit.method for axis in report.axes] == ["slope", "slope"]
    assert [axis.fit.curve.tau.size > 10 for axis in report.axes] == [True, True]
    assert report.settings["method"] == settings.method


def test_every_setting_is_in_the_report() -> None:
    """A run can be repeated; `reading` is last, and the log itself shows whether it was `still`."""
    document = Settings(level=0.9, reading={"topic": ["/imu"]}).document()
    assert set(document) == {field.name for field in dataclasses.fields(Settings)} - {"still"}
    assert list(document)[-1] == "reading"
    assert document["level"] == 0.9


@pytest.mark.usefixtures("forks")
def test_a_report_does_not_depend_on_the_number_of_workers() -> None:
    """Axes, an axis without a result, and findings have the same order and numbers."""
    rng = np.random.default_rng(913)
    model = NoiseModel.parse("N=1e-3 + K=1e-4")
    samples = [model.simulate(4000, rate_hz=50.0, rng=rng) for _ in range(4)]
    axes: tuple[Axis, ...] = ("x", "y", "z")
    series = [
        AxisSeries.from_samples(own, rate_hz=50.0, axis=a) for own, a in zip(samples, axes, strict=False)
    ]
    series.append(AxisSeries.from_samples(samples[3], rate_hz=50.0, sensor="accelerometer"))
    series[1] = AxisSeries.from_samples(np.zeros(4000), rate_hz=50.0, sensor="gyroscope", axis="y")
    reports: list[tuple[int, int, str]] = []

    def document(workers: int) -> str:
        reports.clear()
        report = characterize(
            recording_of(*series), progress=lambda *what: reports.append(what), workers=workers
        )
        return dumps(to_document(report))

    alone = document(1)
    assert [what[:2] for what in reports] == [(done, 4) for done in range(5)]
    for workers in (2, 9):
        assert document(workers) == alone
        # Two axes may end at the same time.
        counts = [done for done, _, _ in reports]
        assert counts[0] == 0
        assert counts == sorted(set(counts))
        assert {number for _, number, _ in reports} == {4}
        assert reports[-1] == (4, 4, "")


def test_the_number_of_workers_is_limited_by_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default is the number of processors if 300 MB are enough for all."""
    short, long = (
        recording_of(AxisSeries.from_samples(np.broadcast_to(0.0, n), rate_hz=50.0)) for n in (1000, 10**7)
    )
    monkeypatch.setenv("IMUCAL_MEMORY", "10G")
    monkeypatch.setenv("IMUCAL_THREADS", "8")
    assert (_workers(short, 9), _workers(short, None)) == (9, 8)
    assert (_workers(long, 9), _workers(long, None)) == (9, 1)
    monkeypatch.setenv("IMUCAL_MEMORY", "100M")
    assert (_workers(short, 9), _workers(short, None)) == (4, 4)
    assert (_workers(long, 9), _workers(long, None)) == (1, 1)
    monkeypatch.setenv("IMUCAL_THREADS", "1")
    assert (_workers(short, 9), _workers(short, None)) == (4, 1)
    with pytest.raises(ValueError, match=r"^workers must be at least 1, got 0$"):
        characterize(short, workers=0)


def test_a_temperature_with_its_own_clock_is_interpolated() -> None:
    """It is sampled once a second, from 0.5 s before the IMU; the fit removes its effect, `screen` warns."""
    rng = np.random.default_rng(914)
    n, clock = 20_000, Clock(source="made", rate_hz=1.0, segments=Clock.even(201, 1.0).segments, start_ns=0)
    own = dataclasses.replace(Clock.even(n, 100.0), start_ns=500_000_000)
    degrees = 30 + 2 * np.sin(np.arange(201) / 15) + 0.01 * rng.normal(size=201)
    warmth = np.interp(own.grid() / 100 + 0.5, np.arange(201), degrees)
    samples = 1e-3 * rng.normal(size=n) + 5e-4 * warmth
    series = dataclasses.replace(AxisSeries.from_samples(samples, rate_hz=100.0), clock=own)
    log = dataclasses.replace(recording_of(series), temperature=Temperature(samples=degrees, clock=clock))
    (axis,) = characterize(log).axes
    assert [(f.code, f.level) for f in axis.findings if f.code in {"temperature", "cycle"}] == [
        ("temperature", "info")
    ]
    assert axis.fit.taken_out[TemperatureEffect()] == pytest.approx(5e-4, rel=0.02)
    assert ("temperature", "warning", "gyro_x") in {(f.code, f.level, f.axis) for f in screen(log)}


def test_a_second_opinion_needs_the_likelihood() -> None:
    """Other methods fit the curve anyway; a log that was moved is fitted without it."""
    with pytest.raises(ArgumentError, match="omit it, or omit method gmwm"):
        Settings(method="gmwm", second_opinion=True)
    series = AxisSeries.from_samples(np.random.default_rng(3).standard_normal(20_000), rate_hz=100.0)
    moved = dataclasses.replace(
        recording_of(series), findings=(Finding("error", "motion", "It moved.", axis="gyro_x"),)
    )
    (axis,) = characterize(moved, Settings(second_opinion=True)).axes
    assert "second-opinion" not in {finding.code for finding in axis.findings}
