"""Screening of each axis once for all tests with equal samples, because an axis takes 0.2 s."""

import contextlib
from collections.abc import Iterator
from unittest import mock

from imucal import pipeline
from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.disturbances.not_noise import not_noise
from imucal.recording import AxisSeries

__all__ = ["axes_screened_once"]

#: Name, samples and temperature of an axis -> its findings.
_SEEN: dict[tuple[object, ...], tuple[Finding, ...]] = {}


def _remembered(series: AxisSeries, temperature: FloatArray | None) -> tuple[Finding, ...]:
    warmth = None if temperature is None else temperature.tobytes()
    key = (series.name, series.clock.n, series.rate_hz, series.samples.tobytes(), warmth)
    if key not in _SEEN:
        _SEEN[key] = not_noise(series, temperature)
    return _SEEN[key]


@contextlib.contextmanager
def axes_screened_once() -> Iterator[None]:
    """Screen each axis once for all tests with equal samples."""
    with mock.patch.object(pipeline, "not_noise", _remembered):
        yield
