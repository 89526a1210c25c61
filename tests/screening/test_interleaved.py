"""Tests of the check for several sensors in one log."""

from collections.abc import Callable

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.findings import Finding
from imucal.grading import grade_of
from imucal.recording import AxisSeries, Recording, Source
from imucal.screening import screen_values
from tests.screening.still import KINDS, recording, still

Noise = Callable[[int, np.random.Generator], FloatArray]
N = 20_000


def interleaved(gyro: FloatArray, accel: FloatArray) -> list[Finding]:
    findings = screen_values(recording(gyro, accel))
    return [finding for finding in findings if finding.code == "interleaved-sensors"]


@pytest.mark.parametrize(
    ("factors", "count"),
    [((1.0, 2.0), "Two"), ((1.0, 1.2), "Two"), ((1.0, 1.0, 1.5, 1.5), "Two"), ((1.0, 1.5, 2.0), "Three")],
)
def test_sensors_of_different_noise_are_found(factors: tuple[float, ...], count: str) -> None:
    """The gyroscope alternates; the accelerometer does not."""
    gyro, accel = still(N, seed=1)
    pattern = np.resize(factors, N)
    (finding,) = interleaved(gyro * pattern, accel)
    assert (finding.axis, grade_of(finding)) == ("gyro", "not-noise")
    assert finding.text.startswith(f"{count} sensors share this log: the noise of gyro_x repeats")


@pytest.mark.parametrize("pattern", [(0.0, 1.0), (0.0, 0.0, 1.0, 1.0)])
def test_sensors_of_equal_noise_and_different_levels_are_found(pattern: tuple[float, ...]) -> None:
    """The biases of two gyroscopes differ by seven standard deviations."""
    gyro, accel = still(N, seed=2)
    (finding,) = interleaved(gyro + 1e-2 * np.resize(pattern, N), accel)
    assert "the level of gyro_x repeats" in finding.text


def test_sensors_with_drifts_of_their_own_are_found_in_single_precision() -> None:
    """The samples are read as floats with an offset, and a gap shifts their index."""
    rng = np.random.default_rng(3)
    walks = [size * (rng.standard_normal(N) + 0.1 * rng.standard_normal(N).cumsum()) for size in (1e-3, 2e-3)]
    samples = np.stack(walks, axis=1).ravel().astype(np.float32).astype(np.float64)
    kept = np.ones(2 * N, dtype=bool)
    kept[10_001:10_010] = False
    clock = Clock.even(2 * N, 200.0).keeping(kept)
    axis = AxisSeries.from_samples(samples, rate_hz=200.0)
    series = AxisSeries(sensor=axis.sensor, axis=axis.axis, samples=samples[kept], clock=clock)
    findings = screen_values(Recording(source=Source(path="log.csv", format="csv"), series=(series,)))
    assert "interleaved-sensors" in {finding.code for finding in findings}


def _held(n: int, rng: np.random.Generator, times: int) -> FloatArray:
    return np.repeat(rng.standard_normal(n // times + 1), times)[:n]


def _dithered(n: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(np.round(0.4 * rng.standard_normal(n) + 0.5 * (-1.0) ** np.arange(n)))


def _tone(n: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(rng.standard_normal(n) + 5 * np.cos(np.pi / 2 * np.arange(n) + 0.3))


#: Logs of one sensor with patterns of their own: name -> samples.
PATTERNS: dict[str, Noise] = {
    "held twice": lambda n, rng: _held(n, rng, 2),
    "held three times": lambda n, rng: _held(n, rng, 3),
    "interpolated 2:1": lambda n, rng: np.interp(np.arange(n) / 2, np.arange(n), rng.standard_normal(n)),
    "interpolated 3:2": lambda n, rng: np.interp(np.arange(n) / 1.5, np.arange(n), rng.standard_normal(n)),
    "alternating dither": _dithered,
    "noise of the resolution": lambda n, rng: (
        0.05 * rng.standard_normal(n) + np.diff(rng.standard_normal(n + 1))
    ),
    "drift": lambda n, rng: rng.standard_normal(n) + rng.standard_normal(n).cumsum(),
    "outliers": lambda n, rng: rng.standard_t(3, n),
    "tone at a quarter of the rate": _tone,
}


@pytest.mark.parametrize("kind", [*KINDS, *PATTERNS])
def test_one_sensor_is_no_pattern(kind: str) -> None:
    """Five records of each kind on three axes."""
    noise = {**KINDS, **PATTERNS}[kind]
    for seed in range(5):
        rng = np.random.default_rng([20261129, seed])
        axes = [noise(8000, rng) for _ in range(3)]
        size = min(axis.size for axis in axes)
        gyro = 1e-3 * np.stack([axis[:size] for axis in axes])
        assert not interleaved(gyro, still(size, seed=seed)[1])
