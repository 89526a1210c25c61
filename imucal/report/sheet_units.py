"""The data-sheet units of a sensor's numbers, chosen once a report: no row and no plot mixes two."""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity
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

    def estimate(self, estimate: Estimate, sensor: Sensor | None) -> Quantity:
        """Return an estimate's coefficient."""
        return self._shown(numbers.datasheet(estimate, sensor))

    def minimum(self, fit: NoiseFit) -> Quantity:
        """Return the lowest point of an axis's curve."""
        return numbers.minimum(fit).scaled(self.level.factor, self.level.name)

    def _shown(self, quantity: Quantity) -> Quantity:
        """Return micro-g for milli-g where the sensor's levels are told in it."""
        if quantity.unit == "mg" and self.level.name == "ug":
            return quantity.scaled(1e3, "ug")
        return quantity


def sheet_units(fits: Sequence[NoiseFit]) -> SheetUnits:
    """Return the units of one sensor's fits: deg/h and deg/√h, or mg and m/s/√h.

    Where all floors of an accelerometer are small, it is µg. Where nobody knows the sensor, the unit is that
    of the samples, whatever it is.
    """
    sensor = fits[0].sensor
    if sensor is None:
        return SheetUnits(level=DatasheetUnit("", 1.0), density=DatasheetUnit("", 1.0))
    floors = [fit.curve.minimum[0] for fit in fits]
    return SheetUnits(level=level_unit(sensor, max(floors)), density=TERMS["N"].datasheet_unit(sensor))


def level_unit(sensor: Sensor, size: float) -> DatasheetUnit:
    """Return the unit of a sensor's levels, the largest of which is `size`, in U."""
    unit = TERMS["B"].datasheet_unit(sensor)
    if unit.name == "mg" and size * unit.factor < _SMALL:
        return DatasheetUnit("ug", 1e3 * unit.factor)
    return unit
