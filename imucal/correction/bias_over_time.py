"""Correct samples by the temperature: the bias at the temperature of the log, at the time of each sample."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.calibration.applying import CORRECTED
from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.recording import AXES, RAW_COUNTS, AxisSeries, Recording, Sensor
from imucal.temperature.exports import correction_of
from imucal.temperature.result import Thermal
from imucal.temperature.thermometer import Thermometer

#: A log may leave the range of the curve by this much without a warning, in K: noise of the thermometer.
_OUTSIDE_K = 1.0
#: Findings after which a row of a table has no place in the recording.
_REORDERED = frozenset({"stamps-out-of-order", "duplicate-stamps", "bad-rows", "cut-line", "first-rows"})


@dataclass(frozen=True, kw_only=True, eq=False)
class BiasOverTime:
    """The bias of each sensor, shape (m, 3), in SI, at `times_s` after `start_ns`; None without stamps.

    `rows` is the bias at the samples of the recording, shape (n, 3), for tables, whose rows are in order.
    """

    times_s: FloatArray
    start_ns: int | None
    bias: Mapping[Sensor, FloatArray]
    rows: Mapping[Sensor, FloatArray]

    @classmethod
    def of(cls, found: Thermal, recording: Recording) -> "BiasOverTime":
        """Return the bias of a log; raise a DataError if it has no temperature."""
        place = recording.source.path
        thermometer = Thermometer.of(recording)
        times = thermometer.times_s
        bias: dict[Sensor, FloatArray] = {}
        rows: dict[Sensor, FloatArray] = {}
        for sensor in Sensor:
            triad = found.triad(sensor)
            series = [one for one in recording.series if one.sensor is sensor]
            if triad is None or len(series) != len(AXES) or len({one.n for one in series}) > 1:
                continue
            curves = [correction_of(axis) for axis in triad]
            columns = [curve.bias(thermometer.samples, thermometer.lagging(curve.lag_s)) for curve in curves]
            bias[sensor] = np.column_stack(columns)
            seconds = thermometer.seconds_of(series[0].clock)
            rows[sensor] = np.column_stack([np.interp(seconds, times, column) for column in columns])
        if not bias:
            problem = "the log and the ramp have no sensor with three axes in common"
            raise DataError(problem, place=place)
        return cls(times_s=times, start_ns=thermometer.start_ns, bias=bias, rows=rows)

    def samples(self, raw: Mapping[Sensor, FloatArray], times_ns: IntArray) -> dict[Sensor, FloatArray]:
        """Return the corrected samples of each sensor, shape (n, 3), taken at `times_ns`, shape (n,)."""
        seconds = (times_ns - (self.start_ns or 0)) / 1e9
        return {
            sensor: values - self._at(sensor, seconds) if sensor in self.bias else values
            for sensor, values in raw.items()
        }

    def _at(self, sensor: Sensor, seconds: FloatArray) -> FloatArray:
        columns = [np.interp(seconds, self.times_s, column) for column in self.bias[sensor].T]
        return np.column_stack(columns)

    def samples_of_rows(self, raw: Mapping[Sensor, FloatArray], first: int) -> dict[Sensor, FloatArray]:
        """Return the corrected samples of consecutive rows of a table from row `first` on.

        Raises a DataError if the table has more rows than the recording has samples.
        """
        found: dict[Sensor, FloatArray] = {}
        for sensor, values in raw.items():
            if sensor not in self.rows:
                found[sensor] = values
                continue
            bias = self.rows[sensor][first : first + len(values)]
            if len(bias) != len(values):
                raise DataError("the table has rows that are no samples", fix=Fix("remove them first"))
            found[sensor] = values - bias
        return found


def refuse_unlike(found: Thermal, recording: Recording, *, table: bool) -> tuple[Finding, ...]:
    """Raise DataError for a log in counts or a corrected one; return doubts about the pair."""
    place = recording.source.path
    values = recording.source.values
    counts = [sensor for sensor in Sensor if values.get(f"{sensor} unit") == RAW_COUNTS]
    if counts:
        problem = f"the {counts[0]} is in raw counts, and the ramp {found.source.name} is in SI units"
        raise DataError(problem, place=place, fix=Fix("give its scale, such as --gyro-scale"))
    if any(what == CORRECTED for what, _ in recording.source.decisions):
        raise DataError("it is already corrected", place=place, fix=Fix("give the original log"))
    codes = [each.code for each in recording.findings if each.code in _REORDERED]
    if table and codes:
        problem = f"its rows are not one sample each in order of time ({', '.join(codes)})"
        raise DataError(problem, place=place, fix=Fix("repair the table first"))
    return tuple(_doubts(found, recording))


def _doubts(found: Thermal, recording: Recording) -> Iterator[Finding]:
    warnings = list(dict.fromkeys(each.code for each in found.findings if each.level != "info"))
    if warnings:
        text = f"The ramp {found.source.name} warns of: {', '.join(warnings)}."
        yield Finding("warning", "calibration-warns", text, "Read thermal.html first.")
    if recording.temperature is None:
        return
    known = recording.temperature.samples[np.isfinite(recording.temperature.samples)]
    if not known.size:
        return
    low, high = float(known.min()), float(known.max())
    if low < found.low_c - _OUTSIDE_K or high > found.high_c + _OUTSIDE_K:
        text = (
            f"The log is at {low:.1f} to {high:.1f} °C, the curve is valid from {found.low_c:.1f} to "
            f"{found.high_c:.1f} °C: outside, the bias at its end is used."
        )
        yield Finding("warning", "thermal-range", text, "Record a ramp over the whole range.")


def compensated(found: Thermal, recording: Recording) -> Recording:
    """Return a recording less the bias at the temperature of each sample.

    Raises a DataError if it has no temperature, is in raw counts, or is already corrected.
    """
    doubts = refuse_unlike(found, recording, table=False)
    rows = BiasOverTime.of(found, recording).rows

    def without_bias(series: AxisSeries) -> AxisSeries:
        if series.sensor not in rows:
            return series
        return replace(series, samples=series.samples - rows[series.sensor][:, AXES.index(series.axis)])

    decisions = (*recording.source.decisions, (CORRECTED, f"by {found.source.name}"))
    return replace(
        recording,
        source=replace(recording.source, decisions=decisions),
        series=tuple(map(without_bias, recording.series)),
        findings=(*recording.findings, *doubts),
    )
