"""Tests of drives with several rests: detection, separate levels and the joint fit."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.errors import DataError
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source
from tests.cli.run import run

RATE = 50.0
TRUTH = imucal.NoiseModel.parse("N=1e-3 + B=3e-4")


def drive(lengths: Sequence[float], *, seed: int = 1, moving_s: float = 15.0) -> tuple[Recording, FloatArray]:
    """Return rests of given lengths in s with motion before, between and after, and their starts."""
    rng = np.random.default_rng(seed)
    parts, starts, place = [], [], 0
    for number, length in enumerate([*lengths, 0.0]):
        k = int(moving_s * RATE)
        soft = np.sin(np.pi * np.arange(k) / k)[:, None]
        parts.append(soft * (rng.normal(size=(k, 6)) + np.sin(np.arange(k) / 20)[:, None]))
        starts.append((place + k) / RATE)
        # Each rest has another pose and another bias.
        level = np.r_[rng.normal(size=3) * 1e-3, rng.normal(size=3) * 0.5 + [0, 0, 9.8]]
        parts.append(np.tile(level, (int(length * RATE), 1)))
        place += k + int(length * RATE)
        assert number <= len(lengths)
    values = np.concatenate(parts)
    values += np.stack([TRUTH.simulate(len(values), rate_hz=RATE, rng=rng) for _ in range(6)], axis=1)
    return recording_of(values), np.array(starts[:-1])


def recording_of(values: FloatArray) -> Recording:
    """Return a recording of six axes, shape (n, 6), that share a clock."""
    clock = Clock.even(len(values), RATE)
    sensors = [*[Sensor.GYROSCOPE] * 3, *[Sensor.ACCELEROMETER] * 3]
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=column, clock=clock)
        for sensor, axis, column in zip(sensors, AXES * 2, values.T, strict=True)
    )
    return Recording(source=Source(path="drive.csv", format="csv"), series=series)


def rests_text(recording: Recording) -> str:
    """Return the text of the finding about rests."""
    (text,) = (finding.text for finding in recording.findings if finding.code == "rests")
    return text


def write(recording: Recording, path: Path) -> None:
    """Write a recording as a table."""
    columns = [np.arange(recording.series[0].n) / RATE, *(series.samples for series in recording.series)]
    head = "t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    np.savetxt(path, np.column_stack(columns), delimiter=",", fmt="%.9g", header=head, comments="")


def test_rests_are_found_away_from_motion() -> None:
    """Two to five seconds are omitted on each side, and short rests are reported."""
    lengths = (60.0, 12.0, 45.0, 90.0)
    recording, starts = drive(lengths)
    rests = imucal.at_rest(recording)
    segments = rests.series[0].clock.segments
    assert rests.source.read is not None
    begin = rests.source.read.from_s + np.array([s.offset - segments[0].offset for s in segments]) / RATE
    end = begin + np.array([s.size for s in segments]) / RATE
    kept = np.array([True, False, True, True])
    true_end = (starts + lengths)[kept]
    assert np.all((begin - starts[kept] > 1.5) & (begin - starts[kept] < 5))
    assert np.all((true_end - end > 1.5) & (true_end - end < 5))
    text = rests_text(rests)
    assert text.startswith("The fit uses 3 rests, ")
    assert "1 rest shorter than 20 s" in text
    assert "of motion or vibration" in text
    for at in begin:
        assert f"{at:.1f} s" in text
    # All axes share one clock object.
    assert len({id(series.clock) for series in rests.series}) == 1


def test_a_rest_keeps_its_own_level() -> None:
    """Another bias in one rest changes neither the samples, except for a constant, nor the curve."""
    recording, starts = drive((60.0, 60.0, 90.0))
    other = []
    for series in recording.series:
        samples = series.samples.copy()
        samples[int(starts[1] * RATE) : int((starts[1] + 60) * RATE)] += 7e-3
        other.append(replace(series, samples=samples))
    one, shifted = imucal.at_rest(recording), imucal.at_rest(replace(recording, series=tuple(other)))
    for before, after in zip(one.series, shifted.series, strict=True):
        np.testing.assert_allclose(after.samples, before.samples, atol=1e-12)
    curve = imucal.allan_curve(one.series[0])
    assert curve.computed == "runs"
    # A quarter of the longest rest: longer averages would span two rests.
    assert curve.tau[-1] <= 90 / 4


def test_the_fit_of_all_rests_is_more_precise_than_of_the_longest() -> None:
    """All 99.9 % intervals cover the truth, and those of N and B are narrower."""
    rests = imucal.at_rest(drive((200.0, 150.0, 250.0, 180.0), seed=4)[0])
    for series in rests.series[:3]:
        longest = max(series.clock.segments, key=lambda s: s.size)
        alone = AxisSeries.from_samples(series.samples[longest.start : longest.stop], rate_hz=RATE)
        fit, one = (imucal.fit(part, model="N + B + K", level=0.999) for part in (series, alone))
        for term in TRUTH.terms:
            estimate, wide = fit[term.symbol], one[term.symbol]
            assert estimate.low <= term.coefficient <= estimate.high
            # If neither detects the term, one bound may be slightly above the other.
            most = 1.1 if wide.value is None and estimate.value is None else 1.0
            assert estimate.high - estimate.low < most * (wide.high - wide.low)


def test_noisy_or_rotating_parts_are_not_rests() -> None:
    """An idling engine adds noise in one rest, and a turntable rotates in another."""
    recording, starts = drive((60.0, 60.0, 60.0, 60.0), seed=2)
    rng = np.random.default_rng(3)
    values = np.stack([series.samples for series in recording.series], axis=1)
    spans = [slice(int(start * RATE), int((start + 60) * RATE)) for start in starts]
    values[spans[0]] += rng.normal(size=(60 * int(RATE), 6)) * 6e-3
    values[spans[2], 2] += 0.1
    text = rests_text(imucal.at_rest(recording_of(values)))
    assert text.startswith("The fit uses 2 rests, ")
    assert "1 rest with more noise than the quietest" in text
    assert "1 rest with a steady rotation" in text


def test_the_longest_of_many_rests_are_used() -> None:
    """A fit separates at most 48 blocks."""
    rests = imucal.at_rest(drive([*np.linspace(30, 40, 55)], moving_s=8.0)[0])
    assert len(rests.series[0].clock.segments) == 48
    assert "7 rests not among the 48 longest" in rests_text(rests)
    assert imucal.fit(rests.series[0], model="N")["N"].low <= 1e-3 <= imucal.fit(rests.series[0])["N"].high


def test_a_log_at_rest_is_one_rest() -> None:
    """It is not cut, and the fit is the same."""
    rng = np.random.default_rng(8)
    still = recording_of(rng.normal(size=(6000, 6)) * 1e-3 + [0, 0, 0, 0, 0, 9.8])
    rests = imucal.at_rest(still)
    assert rests_text(rests).startswith("The fit uses 1 rest, 2 min of 2 min, starting at 0.0 s (2 min)")
    assert rests.series[0].n == 6000
    assert imucal.fit(rests.series[0])["N"] == imucal.fit(still.series[0])["N"]


def test_a_dead_axis_does_not_hide_rests() -> None:
    """Neither does an axis with lost samples."""
    recording, _ = drive((40.0, 50.0), seed=9)
    values = np.stack([series.samples for series in recording.series], axis=1)
    values[:, 1] = 0.0
    values[::97, 4] = np.nan
    rests = imucal.at_rest(recording_of(values))
    assert rests_text(rests).startswith("The fit uses 2 rests, ")
    assert [series.n for series in rests.series[:4]] == [rests.series[0].n] * 4
    assert 0 < rests.series[4].n < rests.series[0].n


def test_a_log_without_a_rest_is_rejected() -> None:
    """The error contains the longest rest."""
    with pytest.raises(DataError, match=r"^drive\.csv: found no rest of at least 20 s"):
        imucal.at_rest(drive((10.0, 12.0), moving_s=40.0)[0])


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_moved_log_prints_advice_instead_of_numbers(tmp_path: Path) -> None:
    """The exit code is 4, and the advised --rests works."""
    write(drive((40.0, 32.0), seed=5, moving_s=5.0)[0], tmp_path / "drive.csv")
    command = ("fit", "drive.csv", "--model", "N")
    done = run(*command, "--no-report", cwd=tmp_path)
    assert done.returncode == 4
    assert done.stdout == "Not noise: the IMU was moved; do not use these numbers\n"
    assert "[motion]" in done.stderr
    assert "[model-misfit]" not in done.stderr
    advice = (
        "fit the rests, or check the stream: type 'imucal doctor' in place of 'imucal fit'\nUse --rests.\n"
    )
    assert f"moved; do not use these numbers; nothing was written; {advice}" in done.stderr
    assert run("doctor", "drive.csv", cwd=tmp_path).returncode in {0, 1}
    with_rests = run(*command, "--rests", "-o", "out", "--format", "svg", cwd=tmp_path)
    assert with_rests.returncode == 0
    assert "N  angle random walk" in with_rests.stdout
    assert "The fit uses 2 rests, " in " ".join(with_rests.stderr.split())
    report = imucal.load_report(tmp_path / "out")
    assert report.settings["reading"] == {"rests": True}
    assert [finding.code for finding in report.findings if finding.code == "rests"] == ["rests"]
    assert {len(axis.gaps) for axis in report.axes} == {1}


def test_one_line_reports_that_there_is_no_rest(tmp_path: Path) -> None:
    """No file is written."""
    write(drive((10.0, 12.0), moving_s=40.0)[0], tmp_path / "drive.csv")
    done = run("fit", "drive.csv", "--rests", "-q", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert done.stderr.startswith("Error: drive.csv: found no rest of at least 20 s in ")
    assert [path.name for path in tmp_path.iterdir()] == ["drive.csv"]
