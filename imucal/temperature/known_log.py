"""Simulate a temperature ramp whose bias over temperature is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.errors import ArgumentError
from imucal.fitting.regressors import lagged
from imucal.noise import NoiseModel
from imucal.recording import AXES, Recording, Sensor, Temperature
from imucal.simulation import SensorTruth, simulate_recording
from imucal.units import G0

__all__ = ["KnownEffect", "simulate_ramp"]

#: Standard deviation of the coefficients of a sensor: a consumer part moves by this over half of the span.
#: 0.3 deg/s and 20 mg.
_SIZES = {Sensor.GYROSCOPE: 5e-3, Sensor.ACCELEROMETER: 0.2}
#: Order of the polynomials.
_ORDER = 3
#: Later coefficients are smaller by this factor.
_FALL = 0.4
#: The parts of the IMU follow the thermometer after this time, in s.
_LAG_S = 40.0
#: Resolution of the thermometer, in K.
_STEP_K = 1 / 16


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownEffect(ReadOnlyArrays):
    """bias = sum of coefficients[k] ((L - middle_c) / half_k)^(k + 1), in SI, for x, y and z of each sensor.

    L is the temperature behind a first-order lag of `lag_s`. The coefficients have the shape (3, order).
    """

    middle_c: float
    half_k: float
    lag_s: float
    gyroscope: FloatArray
    accelerometer: FloatArray

    def bias(self, sensor: Sensor, axis: int, lagging: FloatArray) -> FloatArray:
        """Return the bias of an axis at lagging temperatures, shape (n,)."""
        own = self.gyroscope if sensor is Sensor.GYROSCOPE else self.accelerometer
        coefficients = np.concatenate([[0.0], own[axis]])
        place = (lagging - self.middle_c) / self.half_k
        return np.asarray(np.polynomial.polynomial.polyval(place, coefficients))


def simulate_ramp(
    models: Sequence[NoiseModel],
    *,
    low_c: float,
    high_c: float,
    rate_hz: float,
    duration_s: float,
    seed: int,
    lsb: tuple[float, float] = (0.0, 0.0),
) -> tuple[Recording, KnownEffect]:
    """Return a log at rest that heats from `low_c` to `high_c` and cools again, and its known effect.

    `models` are those of the gyroscope and the accelerometer. The effect of temperature follows the seed.
    Raises ArgumentError if `high_c` is not above `low_c`.
    """
    if not high_c > low_c:
        raise ArgumentError(f"a ramp from {low_c:g} to {high_c:g} °C does not heat; the higher one is second")
    rng = np.random.default_rng([seed, 1])
    sizes = _FALL ** np.arange(_ORDER)
    effect = KnownEffect(
        middle_c=(low_c + high_c) / 2,
        half_k=(high_c - low_c) / 2,
        lag_s=_LAG_S,
        gyroscope=_SIZES[Sensor.GYROSCOPE] * sizes * rng.standard_normal((len(AXES), _ORDER)),
        accelerometer=_SIZES[Sensor.ACCELEROMETER] * sizes * rng.standard_normal((len(AXES), _ORDER)),
    )
    quiet = simulate_recording(
        gyroscope=SensorTruth(model=models[0], mean=(0.0, 0.0, 0.0)),
        accelerometer=SensorTruth(model=models[1], mean=(0.0, 0.0, G0)),
        rate_hz=rate_hz,
        duration_s=duration_s,
        seed=seed,
    )
    clock = quiet.series[0].clock
    place = np.arange(clock.n) / max(clock.n - 1, 1)
    temperature = low_c + (high_c - low_c) * (1 - np.abs(2 * place - 1))
    lagging = lagged(temperature, _LAG_S * rate_hz)
    series = []
    for one in quiet.series:
        samples = one.samples + effect.bias(one.sensor, AXES.index(one.axis), lagging)
        step = lsb[one.sensor is Sensor.ACCELEROMETER]
        series.append(replace(one, samples=np.round(samples / step) * step if step else samples))
    read = Temperature(samples=np.round(temperature / _STEP_K) * _STEP_K, clock=clock)
    return replace(quiet, series=tuple(series), temperature=read), effect
