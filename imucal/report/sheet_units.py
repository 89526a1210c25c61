"""The data-sheet units of a sensor's numbers, chosen once a report: no row and no plot mixes two."""

import math
from dataclasses import dataclass

from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.units import DatasheetUnit

#: Where the floor of every axis is below this, in mg, levels are told in µg.
_SMALL = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetUnits:
    """How a sensor's numbers are printed and drawn.

    Attributes
    ----------
    level
        Of the rate itself: Allan deviations, B, sigma of a Gauss-Markov term.
    density
        Of N, and of the root of a psd.
    """

    level: DatasheetUnit
    density: DatasheetUnit

    def estimate(self, estimate: Estimate, sensor: Sensor) -> Quantity:
        """Return an estimate's coefficient."""
        return self._shown(numbers.datasheet(estimate, sensor))

    def minimum(self, axis: AxisReport) -> Quantity:
        """Return the lowest point of an axis's curve."""
        return self._shown(numbers.minimum(axis)[1])

    def _shown(self, quantity: Quantity) -> Quantity:
        """Return micro-g for milli-g where the sensor's levels are told in it."""
        if quantity.unit == "mg" and self.level.name == "ug":
            return quantity.scaled(1e3, "ug")
        return quantity


def sheet_units(report: Report, sensor: Sensor) -> SheetUnits:
    """Return the units of a sensor: deg/h and deg/√h, or mg (µg where all floors are small) and m/s/√h."""
    floors = [axis.fit.curve.minimum[0] for axis in report.by_sensor.get(sensor, ())]
    density = TERMS["N"].datasheet_unit(sensor)
    return SheetUnits(level=level_unit(sensor, max(floors, default=math.inf)), density=density)


def level_unit(sensor: Sensor, size: float) -> DatasheetUnit:
    """Return the unit of a sensor's levels, the largest of which is `size`, in U."""
    unit = TERMS["B"].datasheet_unit(sensor)
    if unit.name == "mg" and size * unit.factor < _SMALL:
        return DatasheetUnit("ug", 1e3 * unit.factor)
    return unit
