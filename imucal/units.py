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

#: Sensor -> unit of samples in a log -> factor that turns it into SI.
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

#: Unit of time stamps in a log -> ns.
TIME_UNITS_NS: dict[str, int] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}

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


#: Plain spelling without blanks, underscores and brackets -> name in `SAMPLE_UNITS`.
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
    }.items()
    for spelling in spellings.split()
}

_TIME_SPELLINGS = {
    start + end: unit
    for unit, stem in (("ns", "nano"), ("us", "micro"), ("ms", "milli"), ("s", ""))
    for start, ends in ((unit, ("", "ec", "ecs")), (stem, ("s", "sec", "secs", "second", "seconds")))
    for end in ends
}

#: Units of other columns.
_OTHERS = """
degc c degf k ut mt nt t gauss mgauss ga mga pa hpa kpa mbar v mv deg rad m m/s km/h hz % nounits localflux
n/a -
"""
_OTHER_UNITS = frozenset(_OTHERS.split())


@dataclass(frozen=True, slots=True)
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
    "m": _Unit(1.0, m=1),
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


@dataclass(frozen=True, slots=True)
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


def duration(seconds: float) -> str:
    """Return a length of time as text: ``7.5 s``, ``12 min``, ``3 h 2 min``, ``2 d 5 h``."""
    if float(f"{seconds:.3g}") < 60:
        return f"{seconds:.3g} s"
    small, size, count, large = "h", _HOUR, 24, "d"
    if seconds < 48 * _HOUR - 30:
        small, size, count, large = ("s", 1, 60, "min") if seconds < _HOUR - 0.5 else ("min", 60, 60, "h")
    whole, rest = divmod(round(seconds / size), count)
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
    """Return the sensor and the name in `SAMPLE_UNITS` of a unit in any spelling of logs, or None.

    Examples: ``[rad s^-1]``, ``deg/s``, ``°/s``, ``mdps``, ``m/s²``, ``m/(s^2)``, ``G``, ``mg``.
    """
    plain = _plain(text)
    name = _SAMPLE_SPELLINGS.get(plain) or _SAMPLE_SPELLINGS.get(_bare(_shortened(plain)))
    if name is None:
        return None
    sensor = Sensor.GYROSCOPE if name in SAMPLE_UNITS[Sensor.GYROSCOPE] else Sensor.ACCELEROMETER
    return sensor, name


def parse_time_unit(text: str) -> str | None:
    """Return the name in `TIME_UNITS_NS` of a unit in any spelling of logs, or None."""
    return _TIME_SPELLINGS.get(_plain(text))


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any column of a log."""
    known = parse_sample_unit(text) is not None or parse_time_unit(text) is not None
    return known or _plain(text) in _OTHER_UNITS


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
