"""What the name of a column says: sensor, axis and unit. By name alone, never by position."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from imucal.readers.tables.layout import is_number
from imucal.recording import Sensor
from imucal.units import is_unit, parse_sample_unit, parse_time_unit


class Role(StrEnum):
    """What a column holds, as far as its name tells."""

    GYROSCOPE = "gyroscope"
    ACCELEROMETER = "accelerometer"
    VECTOR = "vector"  # x, y or z of something the name leaves open
    TIME = "time"
    COUNTER = "counter"
    TEMPERATURE = "temperature"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """A column and what its name says.

    `words` are the name in small letters, without axis and unit. `axis` is 0, 1, 2 for x, y, z, or the
    number in a name; that may count from 1, which `numbered` tells. The unit stands as it is written.
    `cells` are the first ones of the column.
    """

    index: int
    header: str
    words: tuple[str, ...]
    role: Role
    axis: int | None = None
    numbered: bool = False
    unit: str | None = None
    cells: Sequence[str] = ()

    @property
    def filled(self) -> list[str]:
        """The cells that are not empty, without quotation marks."""
        return [cell.strip("\"'") for cell in self.cells if cell]

    @property
    def is_numeric(self) -> bool:
        """Whether there are filled cells, and all of them are numbers."""
        return bool(filled := self.filled) and all(map(is_number, filled))

    @property
    def counts(self) -> list[int]:
        """The filled cells as whole numbers; none where one is not."""
        filled = self.filled
        return [int(cell) for cell in filled] if all(map(str.isdecimal, filled)) else []

    @property
    def sensor(self) -> Sensor | None:
        """The sensor that the name says."""
        return next((sensor for sensor in Sensor if self.role is Role(str(sensor))), None)

    def unit_of(self, sensor: Sensor) -> str | None:
        """Return the unit of a sensor's samples that the name says; None where it says none."""
        parsed = parse_sample_unit(self.unit) if self.unit else None
        return parsed[1] if parsed and parsed[0] is sensor else None


#: A word of a name: camelCase, capitals, digits.
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-zµμ]+\d*|[A-Z]+\d*|\d+")

#: Units beside which T is a temperature.
_DEGREES = frozenset({"°", "º", "â°", "°c", "ºc", "degc", "c", "â°c"})

_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")

_AXES = {"x": 0, "y": 1, "z": 2}

_ATTITUDE = {"roll": 0, "pitch": 1, "yaw": 2}


def listed(text: str, mark: str | None = None) -> tuple[str, ...]:
    """Return the words of a text, or what stands between its marks."""
    return tuple(text.split(mark))


def _words(text: str) -> frozenset[str]:
    return frozenset(listed(text))


def _stems(words: Sequence[str]) -> list[str]:
    return [word.rstrip("0123456789") or word for word in words]


#: Names with one of these hold no raw sample of either sensor.
_REJECTED = _words(
    "cov covariance orientation quat quaternion mag magn compass euler bias biases gravity grav free user "
    "setpoint motor motors motion est estimated delta angle angles attitude position pos pressure baro std "
    "stddev variance var valid uncertainty clip clipping clipped integral target desired cmd ref reference "
    "jerk relative calibration status accuracy rms inc heading gps lat lon alt altitude axisp axisi axisd "
    "axisf debug rc vel velocity rotationvector gt truth"
)
_REJECTED_STARTS = listed("quat orient magn euler covar freeacc useracc accura accum deltav")

#: How the words of a name spell a sensor: the start of a word, a word, two words, or a letter at an end.
#: A first letter counts only before words that are short as well: w_RS_S, not w_heading.
_GYROSCOPE = re.compile(
    r"\b(gyr|angular|angvel|angrate|omega|rotationrate|rotrate|turnrate|bodyrate)|\b(rate|rotation|rot)\b"
    r"|\bang\b.*\bvel\b|\bvel\b.*\bang\b|\b[gw]$|^w( \w{1,2})*$"
)
_ACCELEROMETER = re.compile(
    r"\b(acc|linacc|linearacc|specificforce)"
    r"|\bspecific\b.*\bforce\b|\bforce\b.*\bspecific\b|\b[af]$|^[af]( \w{1,2})*$"
)

#: What stands behind a sensor and an axis and says nothing of either: gx_raw, gx_2.
_TRAILING = re.compile(
    r"( (\d+|raw|filt|filtered|filter|lp|lpf|cal|calib|calibrated|corr?|corrected|uncal|uncalibrated|"
    r"meas|measured|data|vals?|values?|imu|sensor|body))+$"
)

#: A sensor and an axis in one word, and perhaps a number: gx, wz, ax, fy, gyrox, xaccel, gx2.
_GLUED = re.compile(
    r"(?:(?P<sensor>g|w|a|f|gyr|gyro|gyros|gyroscope|acc|accl|accel|acceleration|accelerometer|omega|alpha|"
    r"angvel|angrate|rate|rotationrate|rot|mag)(?P<axis>[xyz])"
    r"|(?P<axis2>[xyz])(?P<sensor2>gyr|gyro|gyros|acc|accl|accel|rate|angrate|angvel|mag))(?P<number>\d*)"
)

_VECTOR_WORDS = _words("axis dof 3 3dof value values val data raw sensor cal calibrated imu")

_TIME_WORDS = _words(
    "time timestamp stamp t tick ticks uptime epoch epoc elapsed clock sec secs second seconds nsec nsecs "
    "nanosec nanosecs nanoseconds nanos usec usecs msec msecs millis micros ms us ns tow itow datetime date "
    "utc ustime mstime nstime ts yyyy sow gpst millisecond milliseconds microsecond microseconds"
)
#: What a column of steps is called: the time since the sample before.
STEPS = (("dt",), ("delta", "t"), ("delta", "time"))
_NOT_TIME = _words("dt relative offset flags flag exposure zone type id duration")
_COUNTER_WORDS = _words(
    "counter count packet index idx sample samples n frame seq number no iteration f row line cnt"
)
_NOT_COUNTER = _words("id type rate satellites sats gps")

#: Last word of a name -> the unit it spells, beside those of samples.
_UNIT_TAILS = {
    **{word: word for word in _words("ns us ms s sec usec msec nsec degc")},
    "rad": "rad/s",
    "c": "degC",
}


def plain_name(header: str) -> str:
    """Return the name of a column as names are compared: in small letters, without marks around it."""
    return header.strip().strip("\"'\ufeff").lstrip("#%").strip().lower()


def parse_column(
    header: str,
    index: int,
    *,
    unit: str | None = None,
    context: frozenset[str] = frozenset(),
    cells: Sequence[str] = (),
) -> NamedColumn:
    """Return what the name of a column says.

    A `unit` from a row of units goes before one in the name. `context` holds the names of the table's
    other columns in small letters: ``alpha_x`` is an acceleration only beside an ``omega_x``, and p, q,
    r are rates only together.
    """
    shown = header.strip().strip("\ufeff").strip()
    text = shown.strip("\"'").lstrip("#%").lstrip("/").strip().strip("\"'")
    text, named_unit, number = _without_brackets(text)
    unit = unit or named_unit
    words, axis, place = _take_axis([word.lower() for word in _WORD.findall(text)])
    numbered = axis is None and number is not None
    if numbered:
        axis = number
    elif axis is None and words[1:][-1:] in (["0"], ["1"], ["2"], ["3"]) and not _is_time(words):
        axis, numbered = int(words.pop()), True
    if words in (["p"], ["q"], ["r"]) and {"p", "q", "r"} <= context:
        axis, words = "pqr".index(words[0]), ["rate"]
    role, words, unit = _classify(words, axis, unit, place=place, omega="omega" in " ".join(context))
    degrees = (unit or "").strip().lower() in _DEGREES and text.lower().startswith("t")
    if text == "T" or (degrees and role is Role.OTHER):
        role = Role.TEMPERATURE
    return NamedColumn(index, shown, tuple(words), role, axis, numbered=numbered, unit=unit, cells=cells)


def _without_brackets(text: str) -> tuple[str, str | None, int | None]:
    """Take the units and numbers in brackets off a name; an axis in brackets becomes a word of it."""
    unit: str | None = None
    index: int | None = None
    for match in _BRACKETS.finditer(text):
        inner = (match[1] if match[1] is not None else match[2]).strip()
        if inner.isdigit() and len(inner) == 1:
            index = int(inner)
        elif inner.lower() not in _AXES and (is_unit(inner) or inner in {"°", "º", "Â°"}):
            unit = inner
    named = _BRACKETS.sub(
        lambda match: f" {match[0][1:-1]} " if match[0][1:-1].strip().lower() in _AXES else " ", text
    )
    return named.strip(), unit, index


def _take_axis(words: list[str]) -> tuple[list[str], int | None, int]:
    """Take the axis out of the words of a name; also return before which word of the rest it stood."""
    for at in reversed(range(len(words))):
        if words[at] in _AXES:
            return words[:at] + words[at + 1 :], _AXES[words[at]], at
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
    """Return the role, the words left and the unit of a name whose axis stood before word number `place`."""
    if unit is None:
        for size in (3, 2, 1):
            tail = " ".join(words[-size:]) if len(words) > size else ""
            sample = parse_sample_unit(tail) if tail else None
            spelled = sample[1] if sample else _UNIT_TAILS.get(tail)
            if spelled is None:
                continue
            role = _role(words[:-size], axis, omega=omega)
            # Before the axis stands the sensor, behind it the unit: imu1_gx is no acceleration in g.
            if role is Role.VECTOR and len(words) - size < place:
                continue
            agreed = _agreed(role, spelled)
            if agreed is not None and (role is not Role.VECTOR or spelled != "s"):
                return agreed, words[:-size], spelled
    role = _role(words, axis, omega=omega)
    return (role if unit is None else _agreed(role, unit) or Role.OTHER), words, unit


def _agreed(role: Role, unit: str) -> Role | None:
    """Return the role of a name with a unit; None where they contradict each other."""
    sample = parse_sample_unit(unit)
    if role is Role.VECTOR:
        return Role(str(sample[0])) if sample else Role.OTHER
    if role in {Role.GYROSCOPE, Role.ACCELEROMETER}:
        return role if sample and str(sample[0]) == str(role) else None
    if role is Role.TIME:
        return Role.TIME if parse_time_unit(unit) else None
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
    """Return whether words say that a column holds no raw sample of a sensor."""
    rejected = _REJECTED - {"vel", "velocity"} if sensor is Sensor.GYROSCOPE else _REJECTED
    return any(stem in rejected or stem.startswith(_REJECTED_STARTS) for stem in stems)


def is_of_something_else(column: NamedColumn) -> bool:
    """Return whether a name says that the column is no raw sample; one that says nothing may be."""
    return _rejects(_stems(column.words))


def _sensor(stems: list[str], *, omega: bool) -> Sensor | None:
    """Return the sensor that words name, if they name one and only one."""
    text = _TRAILING.sub("", " ".join(stems))
    return _either(_GYROSCOPE.search(text), _ACCELEROMETER.search(text) or (omega and "alpha" in stems))


def _either(gyro: object, accel: object) -> Sensor | None:
    """Return the sensor that alone is true."""
    if bool(gyro) == bool(accel):
        return None
    return Sensor.GYROSCOPE if gyro else Sensor.ACCELEROMETER


def _is_time(words: list[str]) -> bool:
    stems, starts, ends = _stems(words), ("timestamp", "datetime"), ("time", "stamp")
    spelled = any(stem in _TIME_WORDS or stem.startswith(starts) or stem.endswith(ends) for stem in stems)
    return tuple(words) in STEPS or (spelled and not _NOT_TIME.intersection(stems))


def sensor_of_name(name: str) -> Sensor | None:
    """Return the sensor that the name of a file, or the tag of a row, names, if it names one."""
    plain = name.lower()
    return _either(re.search(r"gyr|angular|rotation_?rate", plain), re.search(r"acc(?!u)", plain))
