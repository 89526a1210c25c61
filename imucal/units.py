"""The only module that knows units other than SI: what logs hold, and what data sheets print."""

import math
from dataclasses import dataclass

from imucal.recording import Sensor

__all__ = ["DATASHEET", "G0", "SAMPLE_UNITS", "DatasheetUnit", "datasheet_unit", "pretty"]

#: Standard gravity, in m/s². Source: CGPM 1901.
G0 = 9.80665

_DEGREE = math.pi / 180
_HOUR = 3600.0

#: Sensor -> unit of samples in a log -> factor that turns it into SI.
SAMPLE_UNITS: dict[Sensor, dict[str, float]] = {
    Sensor.GYROSCOPE: {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _DEGREE,
        "mdeg/s": 1e-3 * _DEGREE,
        "deg/h": _DEGREE / _HOUR,
    },
    Sensor.ACCELEROMETER: {
        "m/s^2": 1.0,
        "g": G0,
        "mg": 1e-3 * G0,
        "ug": 1e-6 * G0,
    },
}


@dataclass(frozen=True, slots=True)
class DatasheetUnit:
    """A unit that data sheets print; ``value * factor`` turns SI into it."""

    name: str
    factor: float


#: Symbol of a term -> its data-sheet unit for a gyroscope and for an accelerometer.
DATASHEET: dict[str, tuple[DatasheetUnit, DatasheetUnit]] = {
    "Q": (DatasheetUnit("arcsec", _HOUR / _DEGREE), DatasheetUnit("m/s", 1.0)),
    "N": (DatasheetUnit("deg/sqrt(h)", 60 / _DEGREE), DatasheetUnit("m/s/sqrt(h)", 60.0)),
    "B": (DatasheetUnit("deg/h", _HOUR / _DEGREE), DatasheetUnit("mg", 1e3 / G0)),
    "GM": (DatasheetUnit("deg/h", _HOUR / _DEGREE), DatasheetUnit("mg", 1e3 / G0)),
    "K": (
        DatasheetUnit("deg/h/sqrt(h)", _HOUR / _DEGREE * 60),
        DatasheetUnit("m/s^2/sqrt(h)", 60.0),
    ),
    "R": (DatasheetUnit("deg/h^2", _HOUR**2 / _DEGREE), DatasheetUnit("m/s^2/h", _HOUR)),
}


def datasheet_unit(symbol: str, sensor: Sensor) -> DatasheetUnit:
    """Return the data-sheet unit of a term's coefficient."""
    gyroscope, accelerometer = DATASHEET[symbol]
    return gyroscope if sensor is Sensor.GYROSCOPE else accelerometer


def pretty(unit: str) -> str:
    """Return a unit as people write it: ``m/s^2/sqrt(Hz)`` becomes ``m/s²/√Hz``."""
    for plain, sign in (("sqrt(Hz)", "√Hz"), ("sqrt(h)", "√h"), ("sqrt(s)", "√s"), ("^2", "²"), ("^3", "³")):
        unit = unit.replace(plain, sign)
    return "µg" + unit[2:] if unit.startswith("ug") else unit
