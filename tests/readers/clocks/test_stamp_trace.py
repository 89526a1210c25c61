"""The stamps that are kept for pictures: the extremes of each part of a log."""

from pathlib import Path

import numpy as np

import imucal
from imucal.readers.clocks import stamp_trace


def test_extremes_are_kept() -> None:
    """A step back, a gap, and a late message among 100 000 stay, with few other stamps."""
    stamps = np.arange(100_000, dtype=np.int64) * 10_000_000
    log = stamps + 2_000_000
    stamps[50_000] -= 25_000_000
    stamps[70_000:] += 1_000_000_000
    log[70_000:] += 1_000_000_000
    log[30_000] += 500_000_000
    trace = stamp_trace(stamps, log)
    assert trace.index.size <= 2000
    intervals = dict(zip(trace.index.tolist(), trace.interval_s.tolist(), strict=True))
    assert (intervals[50_000], intervals[70_000]) == (-0.015, 1.01)
    late = dict(zip(trace.compared.tolist(), trace.late_s.tolist(), strict=True))
    assert (late[30_000], np.median(trace.late_s)) == (0.502, 0.002)


def test_short_logs_and_logs_without_log_time() -> None:
    """One stamp has no interval."""
    assert stamp_trace(np.array([5]), None).index.size == 0
    trace = stamp_trace(np.array([0, 10, 30]), None)
    assert trace.index.tolist() == [1, 2]
    assert trace.compared.size == 0


def test_a_recording_has_them(tmp_path: Path) -> None:
    """The reader keeps the stamps as they are in the log."""
    rng = np.random.default_rng(2)
    times = np.arange(2000) * 10_000_000 + 10**18
    times[700] -= 25_000_000
    rows = [
        ",".join([str(time), *(f"{value:.6f}" for value in sample)])
        for time, sample in zip(
            times.tolist(), rng.normal([0, 0, 0, 0, 0, 9.8], 0.01, (2000, 6)), strict=True
        )
    ]
    gyroscope = [f"gyro_{axis} [rad/s]" for axis in "xyz"]
    head = ",".join(["timestamp [ns]", *gyroscope, *(f"acc_{axis} [m/s^2]" for axis in "xyz")])
    path = tmp_path / "back.csv"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    (trace,) = imucal.read(path).stamps
    assert trace.interval_s[trace.index == 700] == [-0.015]
