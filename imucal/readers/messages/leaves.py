"""The numbers that messages of a type hold, by their paths: what a user chooses fields from.

A path is written as in Python: ``imu.gyro.x``, ``gyro[0]``; of a list of structures the first stands for
all: ``imus[0].gyro.x``. Where the list holds samples, ``imus[].gyro.x`` is that of each.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from imucal.errors import ChoiceError
from imucal.readers.messages.message_types import EACH, FieldsText, ImuFields, Named, Stamp, Vector
from imucal.recording import AXES, Axis, Sensor
from imucal.units import TIME_UNITS_NS, parse_sample_unit, parse_time_unit

#: Fields that a message shows, and lists of JSON that are looked into.
MOST = 60

#: What names an axis at the end of a path.
_AXIS = re.compile(r"(\[\d+\]|\.[xyzXYZ])$")
_INDEX = re.compile(r"\[\d+\]")
#: The letter of an axis in the name of a number: ``gz``, ``gyro_z_dps``, ``rate.z``, ``rotationRateZ``.
_LETTER = re.compile(r"(?:(?<![A-Za-z])(?:[gwaf](?=[xyz]))?|(?<=[a-z])(?=[XYZ]))([xyzXYZ])(?![A-Za-z])")

#: Names of the parts of a time.
_SECONDS, _NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nanos", "nsec", "nanoseconds", "nsecs")

#: What the name of a vector says.
_NAMES = {
    Sensor.GYROSCOPE: re.compile(r"gyr|ang|omega|rot|rate|(^|[._])[gw][._]?$"),
    Sensor.ACCELEROMETER: re.compile(r"acc|force|(^|[._])[af][._]?$"),
}


@dataclass(frozen=True, slots=True)
class Leaf:
    """A number, or an array of numbers, with its type such as ``float64``, ``int16[3]`` or ``int16[]``."""

    path: str
    type: str

    @property
    def is_array(self) -> bool:
        return self.type.endswith("]")

    @property
    def is_three(self) -> bool:
        """Whether it may be a vector."""
        return self.type.endswith(("[3]", "[]"))

    def __str__(self) -> str:
        return f"{self.path} {self.type}"


def _refuse_half_lists(vectors: Sequence[Vector], stamp: Stamp | None) -> None:
    """Refuse samples of which some are those of each element of a list, and others those of the message."""
    paths = [path for vector in vectors for path in vector.paths]
    times = [stamp.sec, stamp.nanosec] if stamp is not None else []
    each = [path for path in (*paths, *times) if EACH in path]
    single = [path for path in paths if EACH not in path]
    if each and single:
        msg = f"{each[0]} has {EACH} and {single[0]} has not; expected {EACH} in both, or in none"
        raise ChoiceError(msg)


def _axis_of(sensor: Sensor, path: str) -> Axis:
    """Return the axis that the name of a number tells; a ChoiceError where it tells none."""
    last = (_LETTER.findall(path) or [""])[-1].lower()
    axis = next((axis for axis in AXES if axis == last), None)
    if axis is None:
        msg = (
            f"the field {path} is one number without an axis in its name; name the axis, such as "
            f"{sensor.short}.z={path}"
        )
        raise ChoiceError(msg)
    return axis


def _key(path: str) -> str:
    return _INDEX.sub("[]", path)


class Leaves:
    """The numbers of a type, to be found by any index."""

    def __init__(self, leaves: Iterable[Leaf]) -> None:
        self.all = tuple(leaves)
        self._by_key = {_key(leaf.path): leaf for leaf in self.all}

    def shown(self) -> str:
        """Return the fields for a message."""
        more = f", … {len(self.all) - MOST} more" if len(self.all) > MOST else ""
        return ", ".join(map(str, self.all[:MOST])) + more or "none with numbers"

    def is_number(self, path: str) -> bool:
        """Return whether a path leads to one number."""
        leaf = self._by_key.get(_key(path))
        if leaf is not None:
            return not leaf.is_array
        owner = self._by_key.get(_key(path.rpartition("[")[0])) if path.endswith("]") else None
        if owner is None or not owner.is_array:
            return False
        count, index = (text.rpartition("[")[2].rstrip("]") for text in (owner.type, path))
        return not count or not index or int(index) < int(count)

    def vector(self, paths: Sequence[str]) -> tuple[str, ...] | None:
        """Return the paths of x, y and z; None where one leads nowhere."""
        if len(paths) == 1:
            (path,) = paths
            leaf = self._by_key.get(_key(path))
            spelled = ("[0]", "[1]", "[2]") if leaf is not None and leaf.is_three else (".x", ".y", ".z")
            paths = tuple(path + axis for axis in spelled)
        return tuple(paths) if all(map(self.is_number, paths)) else None

    def _asked_vector(self, sensor: Sensor, wanted: Named) -> Vector | None:
        """Return what a user says are a sensor's fields: a vector, or some axes; None where there are none.

        Raises ChoiceError if a number is named, and nothing says which axis it is.
        """
        if wanted.axes or (len(wanted.paths) == 1 and self.is_number(wanted.paths[0])):
            paths: tuple[str, ...] | None = wanted.paths if all(map(self.is_number, wanted.paths)) else None
            axes = wanted.axes or (_axis_of(sensor, wanted.paths[0]),)
        else:
            paths, axes = self.vector(wanted.paths) if wanted.paths else None, AXES
        if paths is None:
            return None
        # The unit that all their names end in: deg/s of ``gyro_x_dps``, ``gyro_dps.x``.
        found = {_tail_unit(_AXIS.sub("", path)) for path in paths}
        unit = found.pop() if len(found) == 1 else None
        known = unit[1] if unit is not None and unit[0] is sensor else None
        return Vector(sensor, paths, axes=axes, unit=known)

    def stamp(self, paths: Sequence[str], unit: str | None) -> Stamp | None:
        """Return the time that paths lead to; None where there is none.

        Raises ChoiceError if it is a number whose unit is open.
        """
        if len(paths) == 1 and not self.is_number(paths[0]):
            pairs = ((f"{paths[0]}.{s}", f"{paths[0]}.{n}") for s, n in product(_SECONDS, _NANOSECONDS))
            paths = next((pair for pair in pairs if all(map(self.is_number, pair))), ())
        if not paths or not all(map(self.is_number, paths)):
            return None
        if len(paths) == 2:
            return Stamp(paths[0], paths[1])
        unit = unit or parse_time_unit(re.split(r"[._]", paths[0])[-1])
        if unit is None:
            raise ChoiceError(f"the time {paths[0]} has no unit in its name; give the time unit")
        return Stamp(paths[0], scale=TIME_UNITS_NS[unit])

    def asked(self, wanted: FieldsText, time_unit: str | None) -> ImuFields | str:
        """Return what a user says the fields are, or the first that isn't there.

        Of a topic that has the fields of one sensor only, that one is returned: the other may be on another.
        """
        found = {sensor: self._asked_vector(sensor, wanted.of(sensor)) for sensor in Sensor}
        vectors = [vector for vector in found.values() if vector is not None]
        lacking = (",".join(wanted.of(sensor).paths) for sensor, vector in found.items() if vector is None)
        missing = next(filter(None, lacking), "")
        stamp = self.stamp(wanted.time, time_unit) if wanted.time else self._stamp_of(vectors)
        if not vectors or (wanted.time and stamp is None):
            return missing or ",".join(wanted.time)
        _refuse_half_lists(vectors, stamp)
        return ImuFields(
            stamp=stamp,
            vectors=tuple(vectors),
            temperature=wanted.temperature if self.is_number(wanted.temperature) else "",
            standard=False,
            asked=True,
        )

    def _stamp_of(self, vectors: Sequence[Vector]) -> Stamp | None:
        """Return the stamp of each element where elements are read and have one, else the message's."""
        lists = {path.partition(EACH)[0] for vector in vectors for path in vector.paths if EACH in path}
        own = (self.own_stamp(within=f"{name}[0].") for name in lists)
        stamp = next((stamp for stamp in own if stamp is not None), None)
        if stamp is None:
            return self.own_stamp()
        return Stamp(stamp.sec.replace("[0]", EACH, 1), stamp.nanosec.replace("[0]", EACH, 1))

    def own_stamp(self, within: str = "") -> Stamp | None:
        """Return the first time of seconds and nanoseconds that is called a stamp or a time."""
        for leaf in self.all:
            if not leaf.path.startswith(within):
                continue
            owner, _, last = leaf.path.rpartition(".")
            if last in _NANOSECONDS and owner.rpartition(".")[2] in {"stamp", "timestamp", "time"}:
                return self.stamp((owner,), None)
        return None

    def proposal(self) -> str:
        """Return a fields text for these fields, by their names; empty where none is named as a sensor."""
        found: dict[Sensor | None, str] = {}
        for stem, text in self._triads():
            # The unit of a name goes before its words.
            unit = _tail_unit(stem)
            named = next((sensor for sensor, words in _NAMES.items() if words.search(stem)), None)
            found.setdefault(unit[0] if unit else named, text)
        return " ".join(f"{sensor.short}={found[sensor]}" for sensor in Sensor if sensor in found)

    def _triads(self) -> Iterable[tuple[str, str]]:
        """Yield the name of each vector without its axis, and its paths."""
        for leaf in self.all:
            if leaf.is_three:
                yield leaf.path.lower(), leaf.path
            if leaf.is_array:
                continue
            for match in re.finditer("[xX]", leaf.path):
                before, letter, after = leaf.path[: match.start()], match[0], leaf.path[match.end() :]
                *axes, w = (before + axis + after for axis in ("xyzw" if letter == "x" else "XYZW"))
                # With a w it is a quaternion.
                if all(map(self.is_number, axes)) and not self.is_number(w):
                    stem = before.rstrip(".")
                    whole = letter == "x" and not after and before.endswith(".")
                    yield stem.lower(), stem if whole else ",".join(axes)


def _tail_unit(name: str) -> tuple[Sensor, str] | None:
    """Return the sensor and the unit that a name ends in."""
    words = name.rpartition(".")[2].split("_")
    tails = ("_".join(words[-size:]) for size in (3, 2, 1) if len(words) > size)
    return next((unit for tail in tails if (unit := parse_sample_unit(tail))), None)


def leaves_of_tree(tree: object, path: str = "") -> Iterable[Leaf]:
    """Yield the numbers of a JSON message."""
    if isinstance(tree, Mapping):
        for name, value in list(tree.items())[: 10 * MOST]:
            yield from leaves_of_tree(value, f"{path}.{name}" if path else str(name))
    elif _is_number(tree):
        yield Leaf(path, "number")
    elif isinstance(tree, list) and tree:
        if all(map(_is_number, tree)):
            yield Leaf(path, f"number[{len(tree)}]")
        elif isinstance(tree[0], Mapping):
            yield from leaves_of_tree(tree[0], f"{path}[0]")


def _is_number(value: Any) -> bool:  # noqa: ANN401 - anything JSON holds
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
