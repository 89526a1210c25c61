"""Recordings with known truth: an IMU at rest with many kinds of noise, and tools to change them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.powerlaw import PowerLaw
from imucal.recording import Axis, AxisSeries, Recording, Sensor, Source, Temperature
from imucal.units import G0

__all__ = ["KINDS", "flicker", "recording", "still", "unrelated_temperature", "with_samples"]

RATE = 100.0
AXES: tuple[Axis, ...] = ("x", "y", "z")
#: Deviation per sample of a common MEMS IMU at 100 Hz: rad/s and m/s².
NOISE = {Sensor.GYROSCOPE: 1.5e-3, Sensor.ACCELEROMETER: 2e-2}


def flicker(n: int, rng: np.random.Generator) -> FloatArray:
    """Return flicker noise of unit coefficient, by its spectrum; the lowest frequency is absent."""
    f = np.fft.rfftfreq(n)
    spectrum = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
    spectrum[0] = 0
    spectrum[1:] *= np.sqrt(n * PowerLaw.FLICKER.psd(np.asarray(2 * np.pi * f[1:], dtype=np.float64)) / 2)
    samples: FloatArray = np.fft.irfft(spectrum, n)
    return samples


def _recursion(x: FloatArray, phi: float) -> FloatArray:
    from scipy.signal import lfilter

    filtered: FloatArray = lfilter([1.0], [1.0, -phi], x)
    return filtered


def _low_pass(x: FloatArray, cutoff: float, order: int) -> FloatArray:
    from scipy.signal import butter, sosfilt

    filtered: FloatArray = sosfilt(butter(order, cutoff, output="sos"), x)
    return filtered[200:]


#: Noise at rest with a deviation of about 1 per sample: name -> samples (n,).
KINDS: dict[str, Callable[[int, np.random.Generator], FloatArray]] = {
    "white": lambda n, rng: rng.standard_normal(n),
    "laplace": lambda n, rng: rng.laplace(size=n),
    "flicker": lambda n, rng: rng.standard_normal(n) + 0.2 * flicker(n, rng),
    "strong flicker": lambda n, rng: 0.3 * rng.standard_normal(n) + flicker(n, rng),
    "random walk": lambda n, rng: rng.standard_normal(n) + 0.01 * rng.standard_normal(n).cumsum(),
    "strong random walk": lambda n, rng: (
        0.1 * rng.standard_normal(n) + 0.05 * rng.standard_normal(n).cumsum()
    ),
    "Gauss-Markov 1 s": lambda n, rng: (
        rng.standard_normal(n) + _recursion(0.05 * rng.standard_normal(n), np.exp(-0.01))
    ),
    "Gauss-Markov 100 s": lambda n, rng: (
        rng.standard_normal(n) + _recursion(0.01 * rng.standard_normal(n), np.exp(-1e-4))
    ),
    "ramp": lambda n, rng: rng.standard_normal(n) + np.linspace(0, 5, n),
    "quantization": lambda n, rng: 0.3 * rng.standard_normal(n) + np.diff(rng.standard_normal(n + 1)),
    "rounded": lambda n, rng: np.round(rng.standard_normal(n)),
    "low-pass": lambda n, rng: _low_pass(rng.standard_normal(n + 200), 0.3, 4),
    "resonance": lambda n, rng: _resonance(rng.standard_normal(n)),
    "one in a thousand spikes": lambda n, rng: rng.standard_normal(n) + 30 * (rng.random(n) < 1e-3),
}


def _resonance(x: FloatArray) -> FloatArray:
    from scipy.signal import lfilter

    filtered: FloatArray = lfilter([0.4], [1.0, -1.4, 0.8], x)
    return filtered


def recording(
    gyro: FloatArray, accel: FloatArray, *, clock: Clock | None = None, temperature: FloatArray | None = None
) -> Recording:
    """Return a recording of samples of shape (3, n), in SI."""
    clock = clock or Clock.even(gyro.shape[1], RATE)
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=samples, clock=clock)
        for sensor, table in ((Sensor.GYROSCOPE, gyro), (Sensor.ACCELEROMETER, accel))
        for axis, samples in zip(AXES, table, strict=True)
    )
    warmth = None if temperature is None else Temperature(samples=temperature, clock=clock)
    return Recording(source=Source(path="still.csv", format="csv"), series=series, temperature=warmth)


def still(n: int, seed: int, kind: str = "white") -> tuple[FloatArray, FloatArray]:
    """Return gyroscope and accelerometer samples at rest, shape (3, n) each, gravity on z."""
    rng = np.random.default_rng(seed)
    gyro = np.stack([NOISE[Sensor.GYROSCOPE] * KINDS[kind](n, rng) for _ in range(3)])
    accel = np.stack([NOISE[Sensor.ACCELEROMETER] * KINDS[kind](n, rng) for _ in range(3)])
    accel[2] += G0
    gyro += np.array([[0.01], [-0.005], [0.002]])
    return gyro, accel


def unrelated_temperature(n: int, seed: int) -> FloatArray:
    """Return a temperature that rises by 2 degrees and levels off, with noise, shape (n,)."""
    rng = np.random.default_rng([seed, 1])
    return 30 + 2 * (1 - np.exp(-np.linspace(0, 4, n))) + 0.02 * rng.standard_normal(n)


def with_samples(original: Recording, name: str, samples: FloatArray) -> Recording:
    """Return the recording with the samples of one axis replaced."""
    series = tuple(replace(s, samples=samples) if s.name == name else s for s in original.series)
    return replace(original, series=series)
