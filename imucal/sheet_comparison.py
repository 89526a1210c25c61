"""A report against the data sheet of the part: N and B relative to its figures, and the unit of the log.

The figures are typical values of many units, so only a large excess is a finding.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from imucal.errors import Fix
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate
from imucal.recording import Recording, Sensor
from imucal.report.result import AxisReport, Report
from imucal.screening.windows import resolution
from imucal.sensors import Part, PartSensor, TermFigure
from imucal.units import SAMPLE_UNITS, pretty

__all__ = ["SheetRatio", "compared_with_sheet", "sheet_ratios"]

#: Relative difference of equal steps; data sheets round 32.75 to 32.8 counts per deg/s. With it, no step of
#: one part is another part's in a wrong unit (0 of 3006 pairs), and 0.2 % of random steps are.
_STEP_TOLERANCE = 2e-3
#: Mantissas of steps that are the rounding of a text and not counts of a sensor.
_DECIMALS = (1.0, 2.0, 5.0, 10.0)
#: Units of a sensor that users confuse, SI first.
_CONFUSED = {Sensor.GYROSCOPE: ("rad/s", "deg/s", "mdeg/s"), Sensor.ACCELEROMETER: ("m/s^2", "g", "mg")}


@dataclass(frozen=True, kw_only=True)
class SheetRatio:
    """One term of a sensor's axes, relative to the figure of the data sheet.

    Attributes
    ----------
    part
        Name of the part.
    term
        The figure.
    low, high
        Smallest and largest ratio of the axes; for a term that no axis shows, 0 and the largest bound.
    seen
        Whether an axis shows the term.
    """

    part: str
    term: TermFigure
    low: float
    high: float
    seen: bool

    def text(self, *, plain: bool = False) -> str:
        """Return ``gyro N is 1.06 times the data sheet's typical value (BMI088, 0.014 deg/s/√Hz)``.

        The units of a `plain` text are ASCII.
        """
        term = self.term
        unit = term.unit if plain else pretty(term.unit)
        name = f"{term.sensor.short} {term.symbol}"
        low, high = _three_digits(self.low), _three_digits(self.high)
        times = high if low == high else f"{low} to {high}"
        found = f"is {times} times" if self.seen else f"was not detected: at most {high} times"
        figure = f"{term.in_unit(term.reference):.3g} {unit}"
        if term.alternative is None:
            return f"{name} {found} the data sheet's {term.kind} value ({self.part}, {figure})"
        origin = term.alternative_origin.replace("_", " ")
        printed = f"{term.in_unit(term.value):.3g} {unit}"
        return (
            f"{name} {found} the data sheet's value from its {origin} ({self.part}, {figure}; its "
            f"{term.origin.replace('_', ' ')} is {printed})"
        )


def _three_digits(ratio: float) -> str:
    """Return ``1.00`` or ``57.1``."""
    return f"{ratio:#.3g}".rstrip(".")


def sheet_ratios(report: Report, part: Part, *, forced: bool = False) -> tuple[SheetRatio, ...]:
    """Return the ratio of each term that the data sheet prints; axes that are not noise only if `forced`."""
    return tuple(_ratios(_compared_axes(report, forced=forced), part))


def _compared_axes(report: Report, *, forced: bool) -> tuple[AxisReport, ...]:
    return tuple(axis for axis in report.axes if forced or axis.name in report.verdict.axes)


def _ratios(axes: Sequence[AxisReport], part: Part) -> Iterator[SheetRatio]:
    for term in part.terms:
        estimates = [
            estimate
            for axis in axes
            if axis.sensor is term.sensor and (estimate := _estimate(axis, term.symbol)) is not None
        ]
        values = [e.value / term.reference for e in estimates if e.value is not None]
        bounds = [e.high / term.reference for e in estimates if math.isfinite(e.high)]
        if values:
            yield SheetRatio(part=part.name, term=term, low=min(values), high=max(values), seen=True)
        elif bounds:
            yield SheetRatio(part=part.name, term=term, low=0.0, high=max(bounds), seen=False)


def _estimate(axis: AxisReport, symbol: str) -> Estimate | None:
    return next((estimate for estimate in axis.fit.estimates if estimate.symbol == symbol), None)


def compared_with_sheet(report: Report, recording: Recording, part: Part) -> Report:
    """Return the report with the findings of the comparison, and the part's name in its settings.

    ``unit-of-sensor``: the steps of the samples are those of the part in another unit.
    ``above-data-sheet``: N or B of an axis is certainly above the limit of `TermFigure.most`. A sensor in
    another unit has only the first finding.
    """
    units = [
        finding for own in part.sensors.values() if (finding := _unit_finding(recording, own, part.name))
    ]
    wrong = {finding.axis for finding in units}
    names = {axis.name for axis in _compared_axes(report, forced=False)}
    axes = []
    for axis in report.axes:
        excess: tuple[Finding, ...] = ()
        if axis.name in names and axis.sensor.short not in wrong:
            excess = tuple(_excesses(axis, part))
        axes.append(replace(axis, findings=axis.findings + excess))
    return replace(
        report,
        axes=tuple(axes),
        findings=report.findings + tuple(units),
        settings={**report.settings, "sensor": part.name},
    )


def _excesses(axis: AxisReport, part: Part) -> Iterator[Finding]:
    for symbol in ("N", "B"):
        term, estimate = part.term(axis.sensor, symbol), _estimate(axis, symbol)
        if term is None or estimate is None or estimate.value is None or estimate.low <= term.most:
            continue
        unit = pretty(term.unit)
        text = (
            f"{symbol}, {term.in_unit(estimate.value):.3g} {unit}, is {estimate.value / term.reference:.3g} "
            f"times the {term.kind} value of the {part.name}, {term.in_unit(term.reference):.3g} {unit}."
        )
        advice = (
            "Check the unit and the name of the part, then look for vibration, and for a low-power mode or a "
            "missing filter of the sensor."
        )
        yield Finding("warning", "above-data-sheet", text, advice, axis=axis.name)


def _unit_finding(recording: Recording, own: PartSensor, part: str) -> Finding | None:
    """Return a finding if the steps of all axes are those of the part in another unit than the log's."""
    steps = [resolution(series.finite()) for series in recording.series if series.sensor is own.sensor]
    known = [step for step in steps if step is not None]
    if not known or len(known) < len(steps) or _are_steps(known, own.steps):
        return None
    stated = recording.source.values.get(f"{own.sensor} unit")
    factors = SAMPLE_UNITS[own.sensor]
    for read, true in _confused_pairs(own.sensor, stated):
        in_log = [step / factors[read] for step in known]
        in_true_unit = [step * factors[true] for step in in_log]
        if not any(map(_is_decimal, in_log)) and _are_steps(in_true_unit, own.steps):
            return _wrong_unit(own.sensor, part, read=read, true=true, step=in_log[0])
    return None


def _confused_pairs(sensor: Sensor, stated: str | None) -> Iterator[tuple[str, str]]:
    """Yield pairs of units, the one that was read first; only the `stated` one if it is known."""
    si, *others = _CONFUSED[sensor]
    for other in others:
        for pair in ((si, other), (other, si)):
            if stated not in _CONFUSED[sensor] or pair[0] == stated:
                yield pair


def _wrong_unit(sensor: Sensor, part: str, *, read: str, true: str, step: float) -> Finding:
    text = (
        f"The {sensor} was read as {pretty(read)}, but the steps of its samples, {step:.4g}, are those of "
        f"the {part} in {pretty(true)}."
    )
    name = sensor.short
    advice = f"Run again with --{name}-unit {true}; all its numbers scale with the unit."
    return Finding("warning", "unit-of-sensor", text, advice, axis=name, fix=Fix("", f"{name}_unit", true))


def _are_steps(steps: Sequence[float], known: Sequence[float]) -> bool:
    """Return whether all steps, in SI, are one of a part's."""
    return any(all(abs(step / size - 1) < _STEP_TOLERANCE for step in steps) for size in known)


def _is_decimal(step: float) -> bool:
    """Return whether a step is 1, 2 or 5 times a power of ten, as a text rounds numbers."""
    mantissa = step / 10.0 ** math.floor(math.log10(step))
    return any(abs(mantissa / decimal - 1) < _STEP_TOLERANCE for decimal in _DECIMALS)
