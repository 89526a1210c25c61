"""Message definitions: `.msg` text -> the flat list of fields, in the order of their bytes.

The definition of a channel's type is the log's own, one in the user's files, or the standard one.
`rosbags` parses definitions too, but takes longer to import than a small log to read.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from imucal.readers.containers import Channel
from imucal.readers.files import refused

#: What a field is: one number, a fixed array, a string, a sequence of numbers, or anything else.
Kind: TypeAlias = Literal["number", "array", "string", "sequence", "other"]


class DefinitionError(Exception):
    """A message definition can't be understood; says which line."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message, with its path from the top such as ``header.stamp.sec``."""

    path: str
    kind: Kind
    #: NumPy code of a number without byte order, such as ``f8``; empty for strings and others.
    code: str = ""
    #: Numbers of a fixed array, or numbers of one element of a sequence; 1 otherwise.
    count: int = 1

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return int(self.code[1:]) if self.code else 0


_NUMBERS = {
    **dict.fromkeys(("bool", "byte", "octet", "char"), "u1"),
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float32": "f4",
    "float64": "f8",
}
_TIMES = {"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"}
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(<=)?(\d*)\])?\s+(\w+)\s*(.*)$")
_SEPARATOR = re.compile(r"^=+\s*$", re.MULTILINE)
#: A definition that nests deeper than this, or has more fields, is refused; more files are not read.
_DEEP, _MANY = 16, 20_000

#: Definitions of types that logs don't always carry. Source: common_interfaces, PX4 1.14 msg/.
_BUILT_IN: dict[str, str] = {
    "sensor_msgs/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\nVector3 vector",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\nTwist twist",
    "geometry_msgs/Twist": "Vector3 linear\nVector3 angular",
    "geometry_msgs/TwistWithCovarianceStamped": "std_msgs/Header header\nTwistWithCovariance twist",
    "geometry_msgs/AccelStamped": "std_msgs/Header header\nAccel accel",
    "sensor_msgs/Temperature": "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
    "px4_msgs/SensorCombined": (
        "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\n"
        "int32 accelerometer_timestamp_relative\nfloat32[3] accelerometer_m_s2\n"
        "uint32 accelerometer_integral_dt\nuint8 accelerometer_clipping\nuint8 gyro_clipping\n"
        "uint8 accel_calibration_count\nuint8 gyro_calibration_count"
    ),
    "px4_msgs/VehicleImu": (
        "uint64 timestamp\nuint64 timestamp_sample\nuint32 accel_device_id\nuint32 gyro_device_id\n"
        "float32[3] delta_angle\nfloat32[3] delta_velocity\nuint32 delta_angle_dt\nuint32 delta_velocity_dt\n"
        "uint8 delta_angle_clipping\nuint8 delta_velocity_clipping\nuint8 accel_calibration_count\n"
        "uint8 gyro_calibration_count"
    ),
}
#: Types in these.
_INNER = {
    "std_msgs/Header": "{seq}{time} stamp\nstring frame_id",
    "geometry_msgs/Vector3": _BUILT_IN["geometry_msgs/Vector3"],
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Twist": _BUILT_IN["geometry_msgs/Twist"],
    "geometry_msgs/TwistWithCovariance": "Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Accel": "Vector3 linear\nVector3 angular",
}


def plain_type(name: str) -> str:
    """Return ``package/Name`` of ``package/msg/Name``."""
    return name.replace("/msg/", "/")


def built_in(name: str, *, ros1: bool) -> str | None:
    """Return the definition of a well-known type, or None."""
    own = _BUILT_IN.get(plain_type(name))
    if own is None:
        return None
    text = own + "".join(f"\n===\nMSG: {inner}\n{body}" for inner, body in _INNER.items())
    seq, time = ("uint32 seq\n", "time") if ros1 else ("", "builtin_interfaces/Time")
    return text.replace("{seq}", seq).replace("{time}", time)


@dataclass(frozen=True, slots=True)
class Line:
    """A line of a definition: one field, and how many there are of it where it is an array.

    `count` is None for a sequence, whose length each message says.
    """

    kind: str
    name: str
    array: bool
    count: int | None

    @property
    def is_number(self) -> bool:
        return self.kind in _NUMBERS

    @property
    def is_text(self) -> bool:
        return self.kind in {"string", "wstring"}

    @property
    def is_time(self) -> bool:
        return plain_type(self.kind) in _TIMES


class Definition:
    """The definition of a message type, and behind lines of ``===`` perhaps those of the types in it.

    `more` are those of other types, by ``package/Name``; with them the standard types of ROS are known too.
    It is `assumed` where it stands in for the log's own, by the name of the type.
    """

    def __init__(
        self,
        name: str,
        text: str,
        *,
        ros1: bool,
        more: Mapping[str, str] | None = None,
        assumed: bool = False,
    ) -> None:
        self.name = plain_type(name)
        self.text, self.ros1, self.more, self.assumed = text, ros1, more, assumed
        self._defined: dict[str, list[Line]] = {}
        self._add(self.name, text)
        for other, body in (more or {}).items():
            self._add(other, body)

    def _add(self, name: str, text: str) -> None:
        """Add the types of a definition that are not known yet."""
        for index, part in enumerate(_SEPARATOR.split(text)):
            own, body = name, part
            if index:
                match = re.match(r"\s*MSG:\s*(\S+)", part)
                if match is None:
                    continue
                own, body = plain_type(match[1]), part[match.end() :]
            self._defined.setdefault(
                own, [line for raw in body.splitlines() if (line := _line(raw)) is not None]
            )

    def lines(self, name: str) -> list[Line]:
        """Return the fields of a type."""
        return self._defined[name]

    def resolve(self, owner: str, kind: str) -> str:
        """Return the type that a field of `owner` is of; a DefinitionError where it is not defined."""
        name = plain_type(kind)
        last = "/" + name.rpartition("/")[2]
        candidates = [name] if "/" in name else [f"{owner.partition('/')[0]}/{name}", f"std_msgs/{name}"]
        candidates += [known for known in self._defined if known.endswith("/" + name)]
        # A file outside of its package.
        candidates.append(last)
        for candidate in candidates:
            if candidate in self._defined or (self.more is not None and self._take_standard(candidate)):
                return candidate
        msg = f"type {kind} is not defined"
        if self.more is not None:
            msg += f"; also give its .msg file, {last[1:]}.msg"
        raise DefinitionError(msg)

    def _take_standard(self, name: str) -> bool:
        """Take a type of ROS itself; False where there is none of that name."""
        from rosbags.typesys import Stores, get_typestore
        from rosbags.typesys.base import TypesysError

        if name.startswith("/"):
            return False
        store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.LATEST)
        try:
            text, _ = store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1 if self.ros1 else 2)
        except (TypesysError, KeyError):
            return False
        self._add(name, text)
        return True

    def fields(self) -> tuple[Field, ...]:
        """Return the fields of a message, nested ones in their place; a DefinitionError if a type is unknown.

        A field that can't be laid out (a sequence of structures or strings) is of kind "other"; what follows
        it is left out, because its place depends on that field.
        """
        return tuple(_laid_out(self.name, self._fields(self.name)))

    def _fields(self, name: str, prefix: str = "", depth: int = 0) -> Iterator[Field]:
        """Yield the fields of a type, nested ones in their place."""
        if depth > _DEEP:
            raise _too_large(name)
        lines = self._defined[name]
        if not lines and not self.ros1:
            # A ROS 2 structure without members takes one byte: rosidl adds a member.
            yield Field(prefix + "structure_needs_at_least_one_member", "number", "u1")
        for line in lines:
            path = prefix + line.name
            if line.is_number:
                yield self._numbers(path, line)
            elif line.is_text:
                yield Field(path, "other" if line.array or line.kind == "wstring" else "string")
            elif line.is_time and line.array:
                yield Field(path, "other")
            elif line.is_time:
                yield Field(path + ".sec", "number", "u4" if self.ros1 else "i4")
                yield Field(path + ".nanosec", "number", "u4")
            else:
                yield from self._structures(self.resolve(name, line.kind), path, line, depth + 1)

    def _numbers(self, path: str, line: Line) -> Field:
        code = "i1" if self.ros1 and line.kind == "byte" else _NUMBERS[line.kind]
        if not line.array:
            return Field(path, "number", code)
        return Field(path, "sequence", code) if line.count is None else Field(path, "array", code, line.count)

    def _structures(self, nested: str, path: str, line: Line, depth: int) -> Iterator[Field]:
        """Yield the fields of a structure, of each in an array, or one for a sequence of them."""
        if not line.array:
            yield from self._fields(nested, path + ".", depth)
        elif line.count is None:
            # It can be laid out where its structures hold numbers of one size only.
            inner = _laid_out(nested, self._fields(nested, path + "[].", depth))
            if len({one.size for one in inner}) == 1 and {one.kind for one in inner} <= {"number", "array"}:
                yield Field(path, "sequence", inner[0].code, sum(one.count for one in inner))
            else:
                yield Field(path, "other")
        elif line.count > _MANY:
            raise DefinitionError(f"{path} has {line.count} elements")
        else:
            for i in range(line.count):
                yield from self._fields(nested, f"{path}[{i}].", depth)


def _laid_out(name: str, fields: Iterator[Field]) -> list[Field]:
    """Return the fields of a type up to the first whose size is not known."""
    found = []
    for field in fields:
        found.append(field)
        if len(found) > _MANY:
            raise _too_large(name)
        if field.kind == "other":
            break
    return found


def _too_large(name: str) -> DefinitionError:
    return DefinitionError(f"{name} nests too deeply or has too many fields")


def _line(raw: str) -> Line | None:
    """Return the parts of a line; None for blanks, comments and constants."""
    line = raw.partition("#")[0].strip()
    if not line:
        return None
    match = _FIELD.match(line)
    if match is None:
        raise DefinitionError(f"line {line[:60]!r} is not a field")
    kind, array, bounded, elements, name, rest = match.groups()
    if rest.startswith("="):
        return None
    count = int(elements) if elements and not bounded else None
    return Line(kind, name, array=array is not None, count=count)


def read_definitions(paths: Sequence[Path]) -> dict[str, str]:
    """Return the definitions in files and folders: ``package/Name`` -> text.

    The name is that of the file, in which packages and versions may stand too; the package that of the
    folder above ``msg/``, and empty elsewhere.

    Raises ReadError if a file can't be read, or there is none in a folder.
    """
    found = {}
    for path in paths:
        files = sorted(path.rglob("*.msg"))[:_MANY] if path.is_dir() else [path]
        if not files:
            raise refused(path, "no .msg files in this folder; expected the definitions of message types")
        for file in files:
            try:
                text = file.read_text(encoding="utf-8-sig")
            except (OSError, UnicodeDecodeError) as error:
                raise refused(file, f"can't be read: {error}; expected a message definition") from error
            folder = file.resolve().parent
            package = folder.parent.name if folder.name == "msg" else ""
            name = re.split(r"[/.]|__", file.name.removesuffix(".msg"))[-1]
            found[f"{package}/{name}"] = text
    return found


def definition_of(kind: str, given: Mapping[str, str]) -> str | None:
    """Return the given definition of a type; None where none of that name is given.

    One of its package goes first; one of another package is none, one of no package is.
    """
    name = plain_type(kind)
    return given.get(name, given.get("/" + name.rpartition("/")[2]))


def definition_of_channel(channel: Channel, given: Mapping[str, str]) -> Definition:
    """Return the definition of a channel's type: the log's own, one of those `given`, or the standard one.

    Raises DefinitionError if the type has no definition, or one that can't be read.
    """
    ros1 = channel.encoding == "ros1"
    standard = built_in(channel.type, ros1=ros1)
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        try:
            own = Definition(channel.type, channel.definition, ros1=ros1)
            own.fields()
        except DefinitionError:
            # A damaged definition of a well-known type loses nothing: messages must have its size.
            if standard is None:
                raise
        else:
            return own
    elif (text := definition_of(channel.type, given)) is not None:
        return Definition(channel.type, text, ros1=ros1, more=given, assumed=True)
    if standard is not None:
        return Definition(channel.type, standard, ros1=ros1, assumed=True)
    kind = f", except one of kind {channel.definition_kind!r}" if channel.definition_kind else ""
    others = ", ".join(sorted(name.strip("/") for name in given)[:8])
    names = f"; the given ones define {others}" if given else ""
    last = plain_type(channel.type).rpartition("/")[2]
    msg = f"the log has no definition of {channel.type}{kind}{names}; give its .msg file, {last}.msg"
    raise DefinitionError(msg)
