"""The only module that knows units other than SI: what logs hold, and what data sheets print."""

import math
import re
from dataclasses import dataclass

from imucal.recording import Sensor

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

#: Unit of time stamps in a log -> ns.
TIME_UNITS_NS: dict[str, int] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}

#: Signs that people write -> the plain spelling. The last three lines undo UTF-8 read as Latin-1.
_SIGNS = {
    "\u03bc": "u",
    "\u00b5": "u",
    "²": "^2",
    "⁻¹": "^-1",
    "⁻²": "^-2",
    "⁻^2": "^-2",
    "·": " ",
    "⋅": " ",
    "*": " ",
    "º": "deg",
    "°": "deg",
    "Â": "",
    "â": "",
}

_WORDS = (
    (r"degrees?|degs\b", "deg"),
    (r"radians?|rads\b", "rad"),
    (r"metres?|meters?", "m"),
    (r"seconds?|secs?", "s"),
    (r"hours?|hr\b", "h"),
    (r"milli-?", "m"),
    (r"micro-?", "u"),
    (r"gravit(y|ies)", "g"),
    (r"\s+per\s+", "/"),
)

#: Plain spelling without blanks, underscores and brackets -> name in `SAMPLE_UNITS`.
_SAMPLE_SPELLINGS: dict[str, str] = {
    **dict.fromkeys(("rad/s", "rads^-1", "rads-1", "rads", "radps", "radpers"), "rad/s"),
    **dict.fromkeys(("mrad/s", "mradps", "mrads^-1", "mrads"), "mrad/s"),
    **dict.fromkeys(("deg/s", "degs^-1", "degs-1", "degs", "degps", "dps", "d/s"), "deg/s"),
    **dict.fromkeys(("mdeg/s", "mdegs^-1", "mdegs", "mdegps", "mdps"), "mdeg/s"),
    **dict.fromkeys(("deg/h", "degh^-1", "degph", "dph", "deg/hr"), "deg/h"),
    **dict.fromkeys(
        ("m/s^2", "m/s2", "m/s/s", "ms^-2", "ms-2", "m/ss", "ms2", "mps2", "mps^2", "mss", "mpss", "m/s^-2"),
        "m/s^2",
    ),
    **dict.fromkeys(("g", "gs", "g0", "gn", "gee"), "g"),
    **dict.fromkeys(("mg", "mgs", "mg0"), "mg"),
    **dict.fromkeys(("ug", "ugs"), "ug"),
}

_TIME_SPELLINGS: dict[str, str] = {
    spelling: unit
    for unit, stem in (("ns", "nano"), ("us", "micro"), ("ms", "milli"), ("s", ""))
    for spelling in (
        unit,
        f"{unit}ec",
        f"{unit}ecs",
        f"{stem}s",
        f"{stem}sec",
        f"{stem}secs",
        f"{stem}second",
        f"{stem}seconds",
    )
}


def _spellings(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: Units of other columns: they show that a text is a unit, no more.
_OTHER_UNITS = _spellings(
    "degc c degf k ut mt nt t gauss mgauss ga mga pa hpa kpa mbar v mv deg rad m m/s km/h hz % "
    "nounits localflux n/a -"
)


@dataclass(frozen=True, slots=True)
class DatasheetUnit:
    """A unit that data sheets print; ``value * factor`` turns SI into it."""

    name: str
    factor: float


#: What data sheets print coefficients in -> factor that turns SI into it.
DATASHEET_UNITS: dict[str, float] = {
    "arcsec": _HOUR / _DEGREE,
    "m/s": 1.0,
    "deg/sqrt(h)": 60 / _DEGREE,
    "m/s/sqrt(h)": 60.0,
    "deg/h": _HOUR / _DEGREE,
    "mg": 1e3 / G0,
    "deg/h/sqrt(h)": _HOUR / _DEGREE * 60,
    "m/s^2/sqrt(h)": 60.0,
    "deg/h^2": _HOUR**2 / _DEGREE,
    "m/s^2/h": _HOUR,
}


def duration(seconds: float) -> str:
    """Return a length of time as people say it: ``7.5 s``, ``12 min``, ``3 h 2 min``, ``2 d 5 h``."""
    if float(f"{seconds:.3g}") < 60:
        return f"{seconds:.3g} s"
    if seconds < _HOUR - 0.5:
        (whole, rest), units = divmod(round(seconds), 60), ("min", "s")
    elif seconds < 48 * _HOUR - 30:
        (whole, rest), units = divmod(round(seconds / 60), 60), ("h", "min")
    else:
        (whole, rest), units = divmod(round(seconds / _HOUR), 24), ("d", "h")
    return f"{whole} {units[0]} {rest} {units[1]}" if rest else f"{whole} {units[0]}"


def data_size(size: int) -> str:
    """Return a number of bytes as people say it: ``2.5 kB``, ``224 MB``, ``1.344 GB``, ``22.4 TB``."""
    for unit, power in (("TB", 12), ("GB", 9), ("MB", 6)):
        if size >= 10**power:
            return f"{size / 10**power:.4g} {unit}"
    return f"{size / 1e3:.4g} kB"


def datasheet_unit(name: str) -> DatasheetUnit:
    """Return the data-sheet unit of that name."""
    return DatasheetUnit(name, DATASHEET_UNITS[name])


def pretty(unit: str) -> str:
    """Return a unit as people write it: ``m/s^2/sqrt(Hz)`` becomes ``m/s²/√Hz``."""
    for plain, sign in (("sqrt(Hz)", "√Hz"), ("sqrt(h)", "√h"), ("sqrt(s)", "√s"), ("^2", "²"), ("^3", "³")):
        unit = unit.replace(plain, sign)
    return "µg" + unit[2:] if unit.startswith("ug") else unit


def parse_sample_unit(text: str) -> tuple[Sensor, str] | None:
    """Return the sensor and the name in `SAMPLE_UNITS` of a unit as logs spell it, or None.

    Takes such as ``[rad s^-1]``, ``deg/s``, ``°/s``, ``mdps``, ``m/s²``, ``m/(s^2)``, ``G``, ``mg``.
    """
    plain = _plain(text)
    name = _SAMPLE_SPELLINGS.get(plain) or _SAMPLE_SPELLINGS.get(_bare(_shortened(plain)))
    if name is None:
        return None
    sensor = Sensor.GYROSCOPE if name in SAMPLE_UNITS[Sensor.GYROSCOPE] else Sensor.ACCELEROMETER
    return sensor, name


def parse_time_unit(text: str) -> str | None:
    """Return the name in `TIME_UNITS_NS` of a unit as logs spell it, or None."""
    return _TIME_SPELLINGS.get(_plain(text))


def is_unit(text: str) -> bool:
    """Return whether a text is the unit of anything a log may hold."""
    known = parse_sample_unit(text) is not None or parse_time_unit(text) is not None
    return known or _plain(text) in _OTHER_UNITS


def _plain(text: str) -> str:
    """Return a unit's spelling in small letters, without signs of its own and brackets."""
    for sign, plain in _SIGNS.items():
        text = text.replace(sign, plain)
    return _bare(text) if " per " not in text.lower() else text.strip().lower()


def _shortened(text: str) -> str:
    """Return a spelling with whole words cut to their symbols."""
    for pattern, word in _WORDS:
        text = re.sub(pattern, word, text)
    return text


def _bare(text: str) -> str:
    return re.sub(r"[\s_()\[\]{}]", "", text.lower())
