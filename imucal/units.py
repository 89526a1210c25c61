"""Units other than SI, of logs and of data sheets; no other module converts units."""

import ast
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from imucal.recording import Sensor

#: Standard gravity, in m/s². Source: CGPM 1901.
G0 = 9.80665

_DEGREE = math.pi / 180
_HOUR = 3600.0
#: International foot, in m.
_FOOT = 0.3048

#: Sensor -> unit of samples, limits and data sheets -> factor that turns it into SI.
SAMPLE_UNITS: dict[Sensor, dict[str, float]] = {
    Sensor.GYROSCOPE: {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _DEGREE,
        "mdeg/s": 1e-3 * _DEGREE,
        "deg/h": _DEGREE / _HOUR,
    },
    Sensor.ACCELEROMETER: {"m/s^2": 1.0, "g": G0, "mg": 1e-3 * G0, "ug": 1e-6 * G0},
}
#: The same with units that only logs use.
LOG_UNITS: dict[Sensor, dict[str, float]] = {
    Sensor.GYROSCOPE: {
        **SAMPLE_UNITS[Sensor.GYROSCOPE],
        "deg/min": _DEGREE / 60,
        "rad/h": 1 / _HOUR,
        "rpm": 2 * math.pi / 60,
        "rev/s": 2 * math.pi,
        "arcsec/s": _DEGREE / _HOUR,
    },
    Sensor.ACCELEROMETER: {
        **SAMPLE_UNITS[Sensor.ACCELEROMETER],
        "cm/s^2": 1e-2,
        "mm/s^2": 1e-3,
        "um/s^2": 1e-6,
        "Gal": 1e-2,
        "mGal": 1e-5,
        "ft/s^2": _FOOT,
    },
}

#: Sensor -> unit of samples that are increments since the previous sample -> factor that, multiplied by the
#: sampling rate, turns them into SI.
INCREMENT_UNITS: dict[Sensor, dict[str, float]] = {
    Sensor.GYROSCOPE: {"rad": 1.0, "deg": _DEGREE},
    Sensor.ACCELEROMETER: {"m/s": 1.0},
}

#: Unit of time stamps in a log -> ns; an IMU without a stated unit is in one of these.
TIME_UNITS_NS: dict[str, int] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
#: Units that a log or a user must state -> ns.
LONG_TIME_UNITS_NS: dict[str, int] = {
    "min": 60 * TIME_UNITS_NS["s"],
    "h": 3_600 * TIME_UNITS_NS["s"],
    "d": 86_400 * TIME_UNITS_NS["s"],
}

#: Special sign -> the plain spelling. The last three lines undo UTF-8 read as Latin-1.
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

_SPELLINGS = (
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


#: Plain spelling without blanks, underscores and brackets -> name in `LOG_UNITS`.
_SAMPLE_SPELLINGS = {
    spelling: name
    for name, spellings in {
        "rad/s": "rad/s rads^-1 rads-1 rads radps radpers",
        "mrad/s": "mrad/s mradps mrads^-1 mrads",
        "deg/s": "deg/s degs^-1 degs-1 degs degps dps d/s",
        "mdeg/s": "mdeg/s mdegs^-1 mdegs mdegps mdps mdeg",
        "deg/h": "deg/h degh^-1 degph dph deg/hr",
        "m/s^2": "m/s^2 m/s2 m/s/s ms^-2 ms-2 m/ss ms2 mps2 mps^2 mss mpss m/s^-2",
        "g": "g gs g0 gn gee",
        "mg": "mg mgs mg0",
        "ug": "ug ugs",
        "rpm": "rpm rev/min revs/min rpms",
        "rev/s": "rev/s revs/s revolutions/s turns/s",
        "deg/min": "deg/min degpmin dpm",
        "rad/h": "rad/h radh^-1",
        "arcsec/s": "arcsec/s arcs/s as/s",
        "Gal": "gal gals",
        "mGal": "mgal mgals",
        "cm/s^2": "cm/s^2 cm/s2 cms^-2 cms-2 cm/s/s cmps2",
        "mm/s^2": "mm/s^2 mm/s2 mms^-2 mms-2 mm/s/s mmps2",
        "um/s^2": "um/s^2 um/s2 ums^-2 um/s/s",
        "ft/s^2": "ft/s^2 ft/s2 fts^-2 ft/s/s ftps2 fps2",
    }.items()
    for spelling in spellings.split()
}

#: Plain spelling of increments -> name in `INCREMENT_UNITS`.
_INCREMENT_SPELLINGS = {
    "rad": "rad",
    "rads": "rad",
    "radians": "rad",
    "radian": "rad",
    "deg": "deg",
    "degs": "deg",
    "degrees": "deg",
    "degree": "deg",
    "m/s": "m/s",
    "mps": "m/s",
    "ms^-1": "m/s",
    "meter/second": "m/s",
}

_TIME_SPELLINGS = {
    start + end: unit
    for unit, stem in (("ns", "nano"), ("us", "micro"), ("ms", "milli"), ("s", ""))
    for start, ends in ((unit, ("", "ec", "ecs")), (stem, ("s", "sec", "secs", "second", "seconds")))
    for end in ends
}
_LONG_TIME_SPELLINGS = {
    spelling: name
    for name, spellings in {
        "min": "min mins minute minutes",
        "h": "h hr hrs hour hours",
        "d": "d day days",
    }.items()
    for spelling in spellings.split()
}
#: A time unit with a number, such as ``100 ns`` or ``10us``.
_NUMBERED = re.compile(r"(?P<number>\d+(?:\.\d+)?)?\s*(?P<unit>[^\W\d].*)")

#: Units of other columns.
_OTHERS = """
degc c degf k ut mt nt t gauss mgauss ga mga pa hpa kpa mbar v mv deg rad m m/s km/h hz % nounits localflux
n/a -
"""
_OTHER_UNITS = frozenset(_OTHERS.split())


@dataclass(frozen=True)
class _Unit:
    """A unit as its factor to SI and its exponents of radian, metre and second."""

    factor: float
    rad: float = 0.0
    m: float = 0.0
    s: float = 0.0

    def __pow__(self, by: float) -> "_Unit":
        return _Unit(self.factor**by, self.rad * by, self.m * by, self.s * by)

    def __mul__(self, by: "_Unit") -> "_Unit":
        return _Unit(self.factor * by.factor, self.rad + by.rad, self.m + by.m, self.s + by.s)

    def is_like(self, other: "_Unit") -> bool:
        return (self.rad, self.m, self.s) == (other.rad, other.m, other.s)


#: Base units in small letters; an arc second in the spelling of `_SPELLINGS`.
_BASES: dict[str, _Unit] = {
    "rad": _Unit(1.0, rad=1),
    "deg": _Unit(_DEGREE, rad=1),
    "arcmin": _Unit(_DEGREE / 60, rad=1),
    "arcs": _Unit(_DEGREE / _HOUR, rad=1),
    "dps": _Unit(_DEGREE, rad=1, s=-1),
    "dph": _Unit(_DEGREE / _HOUR, rad=1, s=-1),
    "rev": _Unit(2 * math.pi, rad=1),
    "rpm": _Unit(2 * math.pi / 60, rad=1, s=-1),
    "m": _Unit(1.0, m=1),
    "ft": _Unit(_FOOT, m=1),
    "g": _Unit(G0, m=1, s=-2),
    "gal": _Unit(0.01, m=1, s=-2),
    "s": _Unit(1.0, s=1),
    "min": _Unit(60.0, s=1),
    "h": _Unit(_HOUR, s=1),
    "d": _Unit(24 * _HOUR, s=1),
    "hz": _Unit(1.0, s=-1),
}
#: Prefix of a base unit, except units of time -> its factor.
_PREFIXES = {"k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
#: Spellings of roots and exponents -> the form of Python.
_ROOTS = (
    (r"(?:√|\b(?:rt|root|sqrt)\b[- ]*)\(", "sqrt("),
    (r"(?:√|\b(?:rt|root|sqrt)[- ]*)([a-z]+)", r"sqrt(\1)"),
    (r"\b([a-z]+)(-?\d)", r"\1^\2"),
    (r"\^(\(?)(-?)1/2\b", r"^\g<1>\g<2>0.5"),
)


@dataclass(frozen=True)
class DatasheetUnit:
    """A unit of data sheets; ``value * factor`` converts SI to it."""

    name: str
    factor: float


#: Unit of coefficients in data sheets -> factor that converts SI to it.
DATASHEET_UNITS: dict[str, float] = {
    "arcsec": _HOUR / _DEGREE,
    "m/s": 1.0,
    "deg/sqrt(h)": 60 / _DEGREE,
    "m/s/sqrt(h)": 60.0,
    "deg/h": _HOUR / _DEGREE,
    "ug": 1e6 / G0,
    "deg/h/sqrt(h)": _HOUR / _DEGREE * 60,
    "m/s^2/sqrt(h)": 60.0,
    "deg/h^2": _HOUR**2 / _DEGREE,
    "m/s^2/h": _HOUR,
}


def duration(seconds: float, *, rough: bool = False) -> str:
    """Return a length of time as text: ``7.5 s``, ``12 min``, ``3 h 2 min``, ``2 d 5 h``.

    A `rough` one, such as a prediction, has about two digits: ``12 min``, ``3 h 5 min``, ``26 h``.
    """
    in_seconds = f"{seconds:.2g}" if rough else f"{seconds:.3g}"
    if float(in_seconds) < 60:
        return f"{in_seconds} s"
    small, size, count, large = "h", _HOUR, 24, "d"
    if seconds < 48 * _HOUR - 30:
        small, size, count, large = ("s", 1, 60, "min") if seconds < _HOUR - 0.5 else ("min", 60, 60, "h")
    if rough and seconds >= 9.5 * size * count:
        return f"{seconds / (size * count):.0f} {large}"
    # A rough smaller unit is a multiple of 5 s, 5 min or 2 h.
    step = count // 12 if rough else 1
    whole, rest = divmod(step * round(seconds / size / step), count)
    return f"{whole} {large} {rest} {small}" if rest else f"{whole} {large}"


def time_unit(seconds: float) -> tuple[float, str]:
    """Return the unit of a time axis of this length, in s, and its name: s, min or h."""
    if seconds < 600:
        return 1.0, "s"
    return (60.0, "min") if seconds < 2 * _HOUR else (_HOUR, "h")


def data_size(size: int) -> str:
    """Return a number of bytes as text: ``2.5 kB``, ``224 MB``, ``1.344 GB``, ``22.4 TB``."""
    for unit, power in (("TB", 12), ("GB", 9), ("MB", 6)):
        if size >= 10**power:
            return f"{size / 10**power:.4g} {unit}"
    return f"{size / 1e3:.4g} kB"


def datasheet_unit(name: str) -> DatasheetUnit:
    """Return the data-sheet unit of that name."""
    return DatasheetUnit(name, DATASHEET_UNITS[name])


def pretty(unit: str) -> str:
    """Return a unit with signs: ``m/s^2/sqrt(Hz)`` becomes ``m/s²/√Hz``."""
    for plain, sign in (("sqrt(Hz)", "√Hz"), ("sqrt(h)", "√h"), ("sqrt(s)", "√s"), ("^2", "²"), ("^3", "³")):
        unit = unit.replace(plain, sign)
    return "µg" + unit[2:] if unit.startswith("ug") else unit


def find_unit(text: str, units: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the name and the factor to SI of a unit with the dimension of the given units, or None.

    The text is any product of powers, such as ``mdps/rtHz``, ``°/√h``, ``(deg/s)/Hz^0.5`` or ``µg per root
    Hz``. `units` maps names to factors; all have the same dimension. The name of another unit with this
    dimension is its text.
    """
    if text in units:
        return text, units[text]
    found, wanted = _product(text), _product(next(iter(units)))
    if found is None or wanted is None or not found.is_like(wanted):
        return None
    same = (each for each in units.items() if math.isclose(each[1], found.factor, rel_tol=1e-9))
    return next(same, (text.strip(), found.factor))


def _product(text: str) -> _Unit | None:
    """Return a unit that is a product of powers, or None for another text."""
    for sign, plain in _SIGNS.items():
        text = text.replace(sign, plain)
    text = _shortened(text.strip().lower())
    for pattern, plain in _ROOTS:
        text = re.sub(pattern, plain, text)
    text = re.sub(r"\s*([/^()])\s*", r"\1", text).replace("^", "**").replace(" ", "*")
    try:
        return _evaluated(ast.parse(text, mode="eval").body)
    except (SyntaxError, ValueError):
        return None


def _evaluated(node: ast.expr) -> _Unit:
    """Return the unit of an expression of bases, products, quotients, powers and roots."""
    match node:
        case ast.Name(name) if name in _BASES:
            return _BASES[name]
        case ast.Name(name) if _BASES.get(name[1:], _Unit(1.0, s=1)).s != 1 and name[0] in _PREFIXES:
            return _BASES[name[1:]] * _Unit(_PREFIXES[name[0]])
        case ast.BinOp(left, ast.Mult(), right):
            return _evaluated(left) * _evaluated(right)
        case ast.BinOp(left, ast.Div(), right):
            return _evaluated(left) * _evaluated(right) ** -1
        case ast.BinOp(left, ast.Pow(), right):
            return _evaluated(left) ** float(ast.unparse(right))
        case ast.Call(ast.Name("sqrt"), [inside]):
            return _evaluated(inside) ** 0.5
    raise ValueError(f"{ast.unparse(node)} is not a unit")


def parse_sample_unit(text: str) -> tuple[Sensor, str] | None:
    """Return the sensor and the name in `LOG_UNITS` of a unit in any spelling of logs, or None.

    Examples: ``[rad s^-1]``, ``deg/s``, ``°/s``, ``mdps``, ``m/s²``, ``m/(s^2)``, ``G``, ``mg``.
    """
    plain = _plain(text)
    name = _SAMPLE_SPELLINGS.get(plain) or _SAMPLE_SPELLINGS.get(_bare(_shortened(plain)))
    if name is None:
        return None
    sensor = Sensor.GYROSCOPE if name in LOG_UNITS[Sensor.GYROSCOPE] else Sensor.ACCELEROMETER
    return sensor, name


def usual_units(sensor: Sensor) -> str:
    """Return the most usual units of a sensor's samples, for a message."""
    return "rad/s, deg/s, mdeg/s or deg/h" if sensor is Sensor.GYROSCOPE else "m/s^2, g, mg or cm/s^2"


def parse_increment_unit(text: str) -> tuple[Sensor, str] | None:
    """Return the sensor and the name in `INCREMENT_UNITS` of a unit of increments, or None."""
    name = _INCREMENT_SPELLINGS.get(_plain(text))
    if name is None:
        return None
    sensor = Sensor.ACCELEROMETER if name == "m/s" else Sensor.GYROSCOPE
    return sensor, name


def time_unit_ns(text: str) -> int | None:
    """Return the ns of a time unit in any spelling of logs, or None.

    Examples: ``us``, ``milliseconds``, ``min``, ``100 ns``, ``10us``. A unit of less than 1 ns, and one that
    is not a whole number of ns, are None.
    """
    match = _NUMBERED.fullmatch(_plain(text))
    if match is None:
        return None
    short = _TIME_SPELLINGS.get(match["unit"])
    long = _LONG_TIME_SPELLINGS.get(match["unit"])
    if short is None and long is None:
        return None
    unit_ns = TIME_UNITS_NS[short] if short else LONG_TIME_UNITS_NS[long or ""]
    ns = float(match["number"] or 1) * unit_ns
    return int(ns) if ns >= 1 and ns.is_integer() and ns < 2**62 else None


def time_unit_name(ns: int) -> str:
    """Return a time unit as text: ``us``, ``min``, or a number of the largest unit, such as ``100 ns``."""
    units = TIME_UNITS_NS | LONG_TIME_UNITS_NS
    name, size = next((name, size) for name, size in reversed(units.items()) if ns % size == 0)
    return name if ns == size else f"{ns // size} {name}"


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any column of a log."""
    known = parse_sample_unit(text) is not None or time_unit_ns(text) is not None
    return known or _plain(text) in _OTHER_UNITS


#: Signs that occur in units and in no label of a column.
_UNIT_SIGNS = re.compile(r"[/^²³√°µμ·]|\bper\b|^\d+(\.\d+)?\s*[^\W\d]")

#: Units with two meanings: radians or revolutions per second.
AMBIGUOUS_UNITS = frozenset({"rps"})


def may_be_unit(text: str) -> bool:
    """Return whether a text that is not a known unit has the form of one: ``furlong/s``, ``10 ticks``.

    Labels such as ``raw`` or ``body frame`` do not.
    """
    if is_unit(text):
        return False
    return (
        _plain(text) in AMBIGUOUS_UNITS or _UNIT_SIGNS.search(text) is not None or _product(text) is not None
    )


def _plain(text: str) -> str:
    for sign, plain in _SIGNS.items():
        text = text.replace(sign, plain)
    return _bare(text) if " per " not in text.lower() else text.strip().lower()


def _shortened(text: str) -> str:
    for pattern, unit_name in _SPELLINGS:
        text = re.sub(pattern, unit_name, text)
    return text


def _bare(text: str) -> str:
    return re.sub(r"[\s_()\[\]{}]", "", text.lower())
