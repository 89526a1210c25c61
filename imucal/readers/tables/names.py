"""Parse column names: sensor, axis and unit, in any order."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

from imucal.readers.tables.layout import is_number
from imucal.recording import Sensor
from imucal.units import (
    AMBIGUOUS_UNITS,
    is_unit,
    may_be_unit,
    parse_increment_unit,
    parse_sample_unit,
    time_unit_ns,
)


class Role(StrEnum):
    """The content of a column according to its name."""

    GYROSCOPE = "gyroscope"
    ACCELEROMETER = "accelerometer"
    VECTOR = "vector"  # x, y or z of an unnamed quantity
    TIME = "time"
    COUNTER = "counter"
    TEMPERATURE = "temperature"
    OTHER = "other"


@dataclass(frozen=True)
class NamedColumn:
    """A column and its parsed name.

    `words` are in lower case, without axis and unit. `axis` is 0, 1, 2 for x, y, z; if `numbered`, it is a
    number that may start at 1. `unknown_unit` has the form of a unit, but is none that imucal knows. `cells`
    are the first cells.
    """

    index: int
    header: str
    words: tuple[str, ...]
    role: Role
    axis: int | None = None
    numbered: bool = False
    unit: str | None = None
    unknown_unit: str | None = None
    cells: Sequence[str] = ()

    @property
    def filled(self) -> list[str]:
        """The non-empty cells without quotes."""
        return [cell.strip("\"'") for cell in self.cells if cell]

    @property
    def is_numeric(self) -> bool:
        return bool(filled := self.filled) and all(map(is_number, filled))

    @property
    def counts(self) -> list[int]:
        """The non-empty cells, if all are integers of 64 bits."""
        filled = self.filled
        whole = all(cell.isdecimal() and len(cell) <= _MAX_DIGITS for cell in filled)
        return [int(cell) for cell in filled] if whole else []

    @property
    def sensor(self) -> Sensor | None:
        return next((sensor for sensor in Sensor if self.role is Role(str(sensor))), None)

    def unit_of(self, sensor: Sensor) -> str | None:
        parsed = _sample_or_increment(self.unit) if self.unit else None
        return parsed[1] if parsed and parsed[0] is sensor else None


#: Digits of the largest integer of 64 bits.
_MAX_DIGITS = 19

#: Names of angle and velocity increments since the previous sample, if a unit of increments follows.
_GYROSCOPE_INCREMENT = re.compile(
    r"^(dtheta|deltatheta|dangle|dang|deltaangle|deltaang)\b|^d(elta)? (theta|angle|ang)\b"
)
_ACCELEROMETER_INCREMENT = re.compile(
    r"^(dvel|deltavel|dvelocity|deltavelocity|deltav|dv)\b|^d(elta)? (vel|velocity|v)\b"
)
#: A power of ten before a unit of time: 100 in ``time_100us``.
_TICKS = re.compile(r"10+")

#: Words in camelCase, capitals and digits.
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-zµμ]+\d*|[A-Z]+\d*|\d+")

#: Units that make T a temperature.
_DEGREES = frozenset({"°", "º", "â°", "°c", "ºc", "degc", "c", "â°c"})

_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")

_AXES = {"x": 0, "y": 1, "z": 2}

_ATTITUDE = {"roll": 0, "pitch": 1, "yaw": 2}


def listed(text: str, mark: str | None = None) -> tuple[str, ...]:
    """Return the words of a text."""
    return tuple(text.split(mark))


def _words(text: str) -> frozenset[str]:
    return frozenset(listed(text))


def _stems(words: Sequence[str]) -> list[str]:
    return [word.rstrip("0123456789") or word for word in words]


_REJECTED = _words(
    "cov covariance orientation quat quaternion mag magn compass euler bias biases gravity grav free user "
    "setpoint motor motors motion est estimated delta angle angles attitude position pos pressure baro std "
    "stddev variance var valid uncertainty clip clipping clipped integral target desired cmd ref reference "
    "jerk relative calibration status accuracy rms inc heading gps lat lon alt altitude axisp axisi axisd "
    "axisf debug mean rc vel velocity rotationvector gt truth"
)
_REJECTED_STARTS = listed("quat orient magn euler covar freeacc useracc accura accum deltav")

#: A first letter counts only before short words: w_RS_S, not w_heading.
_GYROSCOPE = re.compile(
    r"\b(gyr|angular|angvel|angrate|omega|rotationrate|rotrate|turnrate|bodyrate)|\b(rate|rot)\b"
    r"|\bang\b.*\bvel\b|\bvel\b.*\bang\b|\b[gw]$|^w( \w{1,2})*$"
)
_ACCELEROMETER = re.compile(
    r"\b(acc|linacc|linearacc|specificforce)"
    r"|\bspecific\b.*\bforce\b|\bforce\b.*\bspecific\b|\b[af]$|^[af]( \w{1,2})*$"
)

#: Meaningless suffixes: gx_raw, gx_2.
_TRAILING = re.compile(
    r"( (\d+|raw|filt|filtered|filter|lp|lpf|cal|calib|calibrated|corr?|corrected|uncal|uncalibrated|"
    r"meas|measured|data|vals?|values?|imu|sensor|body))+$"
)

#: Sensor and axis in one word: gx, fy, gyrox, xaccel, gx2.
_GLUED = re.compile(
    r"(?:(?P<sensor>g|w|a|f|r|gyr|gyro|gyros|gyroscope|acc|accl|accel|acceleration|accelerometer|omega|alpha|"
    r"angvel|angrate|rate|rotationrate|rot|mag)(?P<axis>[xyz])"
    r"|(?P<axis2>[xyz])(?P<sensor2>gyr|gyro|gyros|acc|accl|accel|rate|angrate|angvel|mag))(?P<number>\d*)"
)

_VECTOR_WORDS = _words("vector axis dof 3 3dof value values val data raw sensor cal calibrated imu")

_TIME_WORDS = _words(
    "time timestamp stamp t tick ticks uptime epoch epoc elapsed clock sec secs second seconds nsec nsecs "
    "nanosec nanosecs nanoseconds nanos usec usecs msec msecs millis micros ms us ns tow itow datetime date "
    "utc ustime mstime nstime ts yyyy sow gpst millisecond milliseconds microsecond microseconds"
)
#: Names of columns with which rx, ry, rz may be rotation rates: gx, gy, gz are then the direction of gravity.
_R_IS_RATE = frozenset(f"{letter}{axis}" for letter in "ar" for axis in "xyz") | {"mx"}
STEPS = (("dt",), ("delta", "t"), ("delta", "time"))
_NOT_TIME = _words("dt delta relative offset flags flag exposure zone type id duration")
_COUNTER_WORDS = _words(
    "counter count packet index idx sample samples n frame seq number no iteration f row line cnt"
)
_NOT_COUNTER = _words("id type rate satellites sats gps")

#: Last word -> unit, in addition to units of samples.
_UNIT_TAILS = {
    **{word: word for word in _words("ns us ms s sec usec msec nsec degc")},
    **{word: word for word in _words("min mins minute minutes h hr hrs hour hours d day days")},
    "rad": "rad/s",
    "c": "degC",
}


def plain_name(header: str) -> str:
    """Return a column name in lower case, without quotes and comment marks."""
    return header.strip().strip("\"'\ufeff").lstrip("#%").strip().lower()


def parse_column(
    header: str,
    index: int,
    *,
    unit: str | None = None,
    context: frozenset[str] = frozenset(),
    cells: Sequence[str] = (),
) -> NamedColumn:
    """Parse the name of a column; a `unit` from a row of units overrides one in the name.

    `context` contains all names: ``alpha_x`` is an acceleration only together with ``omega_x``; p, q, r are
    rates only together.
    """
    return replace(_parsed_column(header, index, unit, context), cells=cells)


@lru_cache(maxsize=4096)
def _parsed_column(header: str, index: int, unit: str | None, context: frozenset[str]) -> NamedColumn:
    """Return the parsed name without cells; logs of one recorder have the same names."""
    name = header.strip().strip("\ufeff").strip()
    text = name.strip("\"'").lstrip("#%").lstrip("/").strip().strip("\"'")
    text, named_unit, unknown_unit, number = _without_brackets(text)
    if unit is not None:
        unknown_unit = unit if may_be_unit(unit) else None
    unit = named_unit if unit is None or unknown_unit else unit
    words, axis, place = _take_axis([word.lower() for word in _WORD.findall(text)])
    if words[1:] and words[-1] in AMBIGUOUS_UNITS:
        unknown_unit = words.pop()
    axis, numbered = _numbered_axis(words, axis, number)
    words, axis = _letters_of_rates(words, axis, context)
    increment = _increment(words, unit) if axis is not None else None
    role, words, unit = increment or _classify(
        words, axis, unit, place=place, omega="omega" in " ".join(context)
    )
    if text == "T" or (role is Role.OTHER and _in_degrees(text, unit)):
        role = Role.TEMPERATURE
    return NamedColumn(
        index,
        name,
        tuple(words),
        role,
        axis,
        numbered=numbered,
        unit=unit,
        unknown_unit=unknown_unit if unit is None else None,
    )


def _in_degrees(text: str, unit: str | None) -> bool:
    return (unit or "").strip().lower() in _DEGREES and text.lower().startswith("t")


def _numbered_axis(words: list[str], axis: int | None, number: int | None) -> tuple[int | None, bool]:
    """Return the axis, and whether it is a number: in brackets, or the last word, which is removed."""
    if axis is not None:
        return axis, False
    if number is not None:
        return number, True
    if words[1:][-1:] in (["0"], ["1"], ["2"], ["3"]) and not _is_time(words):
        return int(words.pop()), True
    return None, False


def _letters_of_rates(
    words: list[str], axis: int | None, context: frozenset[str]
) -> tuple[list[str], int | None]:
    """Return words and axis; p, q, r become rates if all are in the table, and rx, ry, rz next to ax."""
    if words in (["p"], ["q"], ["r"]) and axis is None and {"p", "q", "r"} <= context:
        return ["rate"], "pqr".index(words[0])
    if words == ["r"] and axis is not None and context >= _R_IS_RATE:
        return ["r", "rate"], axis
    return words, axis


def _increment(words: list[str], unit: str | None) -> tuple[Role, list[str], str] | None:
    """Return role, words and unit of a column of increments, which has a unit of increments; or None."""
    if unit is None and len(words) > 1 and parse_increment_unit(words[-1]):
        # dtheta_x_rad
        words, unit = words[:-1], words[-1]
    parsed = parse_increment_unit(unit) if unit else None
    if parsed is None or unit is None:
        return None
    sensor = parsed[0]
    pattern = _GYROSCOPE_INCREMENT if sensor is Sensor.GYROSCOPE else _ACCELEROMETER_INCREMENT
    return (Role(str(sensor)), words, unit) if pattern.search(" ".join(words)) else None


def _sample_or_increment(unit: str) -> tuple[Sensor, str] | None:
    return parse_sample_unit(unit) or parse_increment_unit(unit)


def _without_brackets(text: str) -> tuple[str, str | None, str | None, int | None]:
    """Return a name without brackets, and in brackets: a known unit, an unknown one, and an index."""
    unit: str | None = None
    unknown_unit: str | None = None
    index: int | None = None
    for match in _BRACKETS.finditer(text):
        inner = (match[1] if match[1] is not None else match[2]).strip()
        if inner.isdigit() and len(inner) == 1:
            index = int(inner) if _ends_name(text, match.end()) else index
        elif inner.lower() in _AXES:
            continue
        elif is_unit(inner) or inner in {"°", "º", "Â°"}:
            unit = inner
        elif may_be_unit(inner):
            unknown_unit = inner

    def kept(match: re.Match[str]) -> str:
        inner = match[0][1:-1].strip()
        device = inner.isdigit() and len(inner) == 1 and not _ends_name(text, match.end())
        return f" {inner} " if device or inner.lower() in _AXES else " "

    named = _BRACKETS.sub(kept, text)
    return named.strip(), unit, unknown_unit if unit is None else None, index


def _ends_name(text: str, place: int) -> bool:
    """Return whether no name follows; a number before a name is that of a device: IMU(1):gyro_x."""
    return re.search(r"[^\W\d_]", _BRACKETS.sub("", text[place:])) is None


def _take_axis(words: list[str]) -> tuple[list[str], int | None, int]:
    """Remove the axis; also return the index of the word after it."""
    for at in reversed(range(len(words))):
        if words[at] in _AXES:
            # DatCon repeats the axis: accelX:X.
            first = words.index(words[at])
            return list(filter(words[at].__ne__, words)), _AXES[words[at]], first
    for at in reversed(range(len(words))):
        match = _GLUED.fullmatch(words[at])
        if match:
            sensor, axis = match["sensor"] or match["sensor2"], match["axis"] or match["axis2"]
            number = [match["number"]] if match["number"] else []
            return [*words[:at], sensor, *number, *words[at + 1 :]], _AXES[axis], at + 1
    rate = any(word in {"rate", "angular", "gyro"} for word in words)
    for at, word in enumerate(words):
        stem = word.removesuffix("rate")
        if stem in _ATTITUDE and (stem != word or rate):
            kept = ["rate"] if stem != word else []
            return [*words[:at], *kept, *words[at + 1 :]], _ATTITUDE[stem], at + len(kept)
    return words, None, len(words)


def _classify(
    words: list[str], axis: int | None, unit: str | None, *, place: int, omega: bool
) -> tuple[Role, list[str], str | None]:
    """Return role, remaining words and unit; the axis was before word `place`."""
    if unit is None:
        for size in (3, 2, 1):
            spelled = _unit_tail(words, size)
            if spelled is None:
                continue
            role = _role(words[:-size], axis, omega=omega)
            if role is Role.TIME and size == 1 and len(words) > 2 and _TICKS.fullmatch(words[-2]):
                return role, words[:-2], words[-2] + spelled
            # A unit follows the axis: imu1_gx is not an acceleration in g.
            if role is Role.VECTOR and len(words) - size < place:
                continue
            agreed = _agreed(role, spelled)
            if agreed is not None and (role is not Role.VECTOR or spelled != "s"):
                return agreed, words[:-size], spelled
    role = _role(words, axis, omega=omega)
    return (role if unit is None else _agreed(role, unit) or Role.OTHER), words, unit


def _unit_tail(words: list[str], size: int) -> str | None:
    """Return the unit that the last `size` words are; None if they are not, or if there are no others."""
    if len(words) <= size or words[-size - 1] == "of":
        # The time of day is in any unit.
        return None
    tail = " ".join(words[-size:])
    sample = parse_sample_unit(tail)
    return sample[1] if sample else _UNIT_TAILS.get(tail)


def _agreed(role: Role, unit: str) -> Role | None:
    sample = parse_sample_unit(unit)
    if role is Role.VECTOR:
        return Role(str(sample[0])) if sample else Role.OTHER
    if role in {Role.GYROSCOPE, Role.ACCELEROMETER}:
        return role if sample and str(sample[0]) == str(role) else None
    if role is Role.TIME:
        return Role.TIME if time_unit_ns(unit) else None
    if role is Role.TEMPERATURE:
        return role if unit.lower().strip("°º") in {"c", "degc", "k", ""} else None
    return role


def _role(words: list[str], axis: int | None, *, omega: bool) -> Role:
    stems = _stems(words)
    sensor = _sensor(stems, omega=omega)
    if _is_time(words) and (axis is None or sensor is None):
        return Role.TIME
    if axis is not None:
        if _rejects(stems, sensor):
            return Role.OTHER
        if sensor is not None:
            return Role(str(sensor))
        return Role.VECTOR if _VECTOR_WORDS.issuperset(stems) else Role.OTHER
    if _COUNTER_WORDS.intersection(stems) and not _NOT_COUNTER.intersection(stems):
        return Role.COUNTER
    return Role.TEMPERATURE if {"temp", "temperature", "temps"}.intersection(stems) else Role.OTHER


def _rejects(stems: Sequence[str], sensor: Sensor | None = None) -> bool:
    rejected = _REJECTED - {"vel", "velocity"} if sensor is Sensor.GYROSCOPE else _REJECTED
    return any(stem in rejected or stem.startswith(_REJECTED_STARTS) for stem in stems)


def is_of_something_else(column: NamedColumn) -> bool:
    """Return whether a name excludes raw samples; unknown names do not."""
    return _rejects(_stems(column.words))


def _sensor(stems: list[str], *, omega: bool) -> Sensor | None:
    text = _TRAILING.sub("", " ".join(stems))
    return _either(_GYROSCOPE.search(text), _ACCELEROMETER.search(text) or (omega and "alpha" in stems))


def _either(gyro: object, accel: object) -> Sensor | None:
    if bool(gyro) == bool(accel):
        return None
    return Sensor.GYROSCOPE if gyro else Sensor.ACCELEROMETER


def _is_time(words: list[str]) -> bool:
    stems, starts, ends = _stems(words), ("timestamp", "datetime"), ("time", "stamp")
    spelled = any(stem in _TIME_WORDS or stem.startswith(starts) or stem.endswith(ends) for stem in stems)
    return spelled and not _NOT_TIME.intersection(stems)


@lru_cache(maxsize=4096)
def sensor_of_name(name: str) -> Sensor | None:
    """Return the sensor in a file name or a row's tag, or None."""
    plain = name.lower()
    return _either(re.search(r"gyr|angular|rotation_?rate", plain), re.search(r"acc(?!u)", plain))
