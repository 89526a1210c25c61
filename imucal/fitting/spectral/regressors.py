"""Regressors: slow, known shapes that are taken out with the fit, and their DCT-II ordinates.

A regressor is a column of generalised least squares, so that what it takes out is judged against the
noise at the same frequencies. Its name says all about it; places and times are in samples, from the
first sample of the record:

    R                    the ramp
    exp:<time>           exp(-t/time), a warm-up
    step:<place>         0 before the place, 1 from it on
    cos:<w>, sin:<w>     of w (t + 1/2), w in rad/sample: together a cycle
    temperature[:<lag>]  the temperature, behind a first-order lag
"""

from typing import TYPE_CHECKING

import numpy as np

from imucal.allan.dct import dct_ordinates, ramp_ordinates
from imucal.arrays import FloatArray
from imucal.fitting.spectral.ordinates import exponential_ordinates

if TYPE_CHECKING:
    from collections.abc import Callable

#: Means of the temperature for each ordinate that is asked for, where those are few.
_MEANS = 4


def regressor_ordinates(
    name: str, n: int, count: int, *, offset: int = 0, temperature: FloatArray | None = None
) -> FloatArray:
    """Return the ordinates k = 1 … count of a regressor in `n` samples from place `offset` on.

    `temperature`, shape (n,), is that at these samples. Constants are left out, as ordinate 0 is.
    """
    kind, _, text = name.partition(":")
    value = float(text) if text else 0.0
    if kind == "temperature":
        if temperature is None:
            msg = f"regressor {name!r} needs the temperature of the samples, got none"
            raise ValueError(msg)
        return temperature_ordinates(temperature, count, value)
    closed: dict[str, Callable[[], FloatArray]] = {
        "R": lambda: ramp_ordinates(n, count),
        "exp": lambda: exponential_ordinates(n, count, value, offset),
        "step": lambda: step_ordinates(n, count, value - offset),
        "cos": lambda: cycle_ordinates(n, _angles(n, count), value, value * offset),
        "sin": lambda: cycle_ordinates(n, _angles(n, count), value, value * offset - np.pi / 2),
    }
    return closed[kind]()


def regressor_samples(name: str, places: FloatArray, temperature: FloatArray | None = None) -> FloatArray:
    """Return the regressor at `places` from the first sample of the record, shape of `places`."""
    kind, _, text = name.partition(":")
    value = float(text) if text else 0.0
    if kind == "temperature" and temperature is not None:
        return lagged(temperature, value)
    shapes: dict[str, Callable[[], FloatArray]] = {
        "R": lambda: places,
        "exp": lambda: np.exp(-places / value),
        "step": lambda: (places >= value).astype(np.float64),
        "cos": lambda: np.cos(value * (places + 0.5)),
        "sin": lambda: np.sin(value * (places + 0.5)),
    }
    return shapes[kind]()


def step_ordinates(n: int, count: int, place: float) -> FloatArray:
    """Return the ordinates k = 1 … count of a step from 0 to 1 at sample `place`.

    -sqrt(2/n) sin(theta place) / (2 sin(theta/2)); nothing of a step that is not inside.
    """
    if not 0 < place < n:
        return np.zeros(count)
    half = np.pi / (2 * n) * np.arange(1, count + 1, dtype=np.float64)
    ordinates: FloatArray = -np.sqrt(2 / n) * np.sin(2 * half * place) / (2 * np.sin(half))
    return ordinates


def _angles(n: int, count: int) -> FloatArray:
    return np.asarray(np.pi / n * np.arange(1, count + 1, dtype=np.float64))


def cycle_ordinates(
    n: int, theta: FloatArray, omega: FloatArray | float, phase: FloatArray | float
) -> FloatArray:
    """Return the ordinates at angles `theta` = pi k/n of cos(omega (t + 1/2) + phase), t = 0 … n-1.

    With D(a) = sin(n a/2) / sin(a/2), Dirichlet's kernel:
    sqrt(2/n)/2 sum over a = omega ± theta of D(a) cos(n a/2 + phase). The three are broadcast together.
    """
    total: FloatArray | float = 0.0
    for angle in (omega + theta, omega - theta):
        sine, cosine = np.sin(n / 2 * angle), np.cos(n / 2 * angle)
        below = np.sin(angle / 2)
        kernel = np.divide(sine, below, out=np.full(below.shape, float(n)), where=below != 0)
        total = total + kernel * (cosine * np.cos(phase) - sine * np.sin(phase))
    return np.asarray(np.sqrt(2 / n) / 2 * total)


def temperature_ordinates(temperature: FloatArray, count: int, lag: float) -> FloatArray:
    """Return the ordinates k = 1 … count of the temperature behind a first-order lag, in samples.

    Where few are asked for, of means over spans of equal length: the transform of those is the same
    at frequencies far below theirs, and quick.
    """
    n = temperature.size
    spans = min(n, _MEANS * (count + 1))
    if spans < n:
        total = np.concatenate([[0.0], np.cumsum(temperature - temperature[0])])
        edges = np.interp(np.linspace(0, n, spans + 1), np.arange(n + 1.0), total)
        temperature = np.diff(edges) * (spans / n)
    ordinates = dct_ordinates(lagged(temperature, lag * spans / n))[:count]
    return np.asarray(ordinates * np.sqrt(n / spans))


def lagged(samples: FloatArray, lag: float) -> FloatArray:
    """Return what follows `samples` with a first-order lag, in samples, at rest before the first."""
    if not lag > 0:
        return samples
    from scipy.signal import lfilter

    phi = float(np.exp(-1 / lag))
    followed = lfilter([1 - phi], [1.0, -phi], samples - samples[0])
    return np.asarray(samples[0] + followed)
