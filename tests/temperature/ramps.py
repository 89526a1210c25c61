"""Simulated ramps of known shape: the temperature, the bias that follows it, and the noise."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.fitting.regressors import lagged
from imucal.noise import NoiseModel
from imucal.recording import AxisSeries, Recording, Sensor, Source, Temperature

__all__ = ["SHAPES", "STATIC", "KnownRamp", "known_ramp", "recording_of"]

#: Middle of the temperatures, in degrees Celsius.
MIDDLE = 25.0
#: Half of their span, in K.
HALF = 35.0
#: Size of the effects, in rad/s.
SIZE = 1e-3

#: Effects of the temperature alone, of u = (T - MIDDLE) / HALF.
STATIC: dict[str, Callable[[FloatArray], FloatArray]] = {
    "none": lambda u: 0 * u,
    "line": lambda u: 3 * u,
    "parabola": lambda u: 2 * u - 1.5 * u**2,
    "cubic": lambda u: u - u**2 + 1.2 * u**3,
    "kink": lambda u: 2 * np.abs(u - 0.3),
    "step": lambda u: 2 * np.tanh(3 * u),
}
#: Effects of u and of u behind 60 s and 200 s.
LAGGING: dict[str, Callable[[FloatArray, FloatArray, FloatArray], FloatArray]] = {
    "line behind 60 s": lambda _, a, __: 3 * a,
    "parabola behind 60 s": lambda _, a, __: 2 * a - a**2,
    "gradient of 200 s": lambda u, _, b: 2 * u + 1.5 * (b - u),
    "gradient of 60 s": lambda u, a, _: u**2 + 2 * (a - u),
}
#: Names of all effects.
SHAPES = (*STATIC, *LAGGING)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRamp:
    """A log of one axis, its true bias without noise at each sample, and the model of the noise."""

    recording: Recording
    bias: FloatArray
    model: NoiseModel


def recording_of(columns: FloatArray, temperature: FloatArray, rate_hz: float) -> Recording:
    """Return a recording of the gyroscope x, y, z and the accelerometer, as many as there are columns."""
    clock = Clock.even(temperature.size, rate_hz)
    names = [(sensor, axis) for sensor in Sensor for axis in ("x", "y", "z")]
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=column, clock=clock)  # type: ignore[arg-type]
        for (sensor, axis), column in zip(names, columns.T, strict=False)
    )
    heat = Temperature(samples=temperature, clock=clock)
    return Recording(source=Source(path="ramp", format="test"), series=series, temperature=heat)


def known_ramp(
    shape: str,
    rng: np.random.Generator,
    *,
    duration_s: float = 3600.0,
    rate_hz: float = 2.0,
    noise: str = "N=1e-4 + B=5e-5 + K=3e-7",
    chamber: bool = True,
) -> KnownRamp:
    """Return a ramp of a chamber (up and down at a constant rate), or of a heater that is switched off."""
    n = round(duration_s * rate_hz)
    place = np.arange(n) / n
    if chamber:
        u = 1 - 2 * np.abs(2 * place - 1)
    else:
        up, down = 1 - np.exp(-8 * place), np.exp(-8 * (place - 0.5))
        u = 2 * np.where(place < 0.5, up, down) - 1
    temperature = MIDDLE + HALF * u
    behind = [lagged(u, seconds * rate_hz) for seconds in (60.0, 200.0)]
    effect = STATIC[shape](u) if shape in STATIC else LAGGING[shape](u, behind[0], behind[1])
    bias = SIZE * effect
    model = NoiseModel.parse(noise)
    samples = bias + model.simulate(n, rate_hz=rate_hz, rng=rng)
    read = np.round((temperature + 0.05 * rng.standard_normal(n)) * 16) / 16
    return KnownRamp(recording=recording_of(samples[:, np.newaxis], read, rate_hz), bias=bias, model=model)
