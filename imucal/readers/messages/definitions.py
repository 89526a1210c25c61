"""Message definitions: `.msg` text -> the flat list of fields, in the order of their bytes.

Definitions of message types in the user's own `.msg` files, as packages hold them, or in their folders.

The definition of a channel's message type: the log's own, one that is given, or the standard one.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

from imucal.errors import ReadError
from imucal.readers.containers import Channel
from imucal.readers.read_options import ReadOptions

#: What a field is: one number, a fixed array, a string, a sequence of numbers, or anything else.
Kind: TypeAlias = Literal["number", "array", "string", "sequence", "other"]


class DefinitionError(Exception):
    """A message definition can't be understood; says which line."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message, with its path from the top such as ``header.stamp.sec``.

    Attributes
    ----------
    kind
        See `Kind`.
    code
        NumPy code of a number without byte order, such as ``f8``; empty for strings and others.
    count
        Numbers of a fixed array, or numbers of one element of a sequence; 1 otherwise.
    """

    path: str
    kind: Kind
    code: str = ""
    count: int = 1

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return int(self.code[1:]) if self.code else 0


_NUMBERS = {
    "bool": "u1",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TIMES = {"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"}
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(<=)?(\d*)\])?\s+(\w+)\s*(.*)$")
_SEPARATOR = re.compile(r"^=+\s*$", re.MULTILINE)
#: A definition that nests deeper than this, or has more fields, is refused.
_DEEP, _MANY = 16, 20_000

#: Definitions of types that logs don't always carry. Source: common_interfaces, PX4 1.14 msg/.
_HEADER = "\n===\nMSG: std_msgs/Header\n{seq}{time} stamp\nstring frame_id"
_VECTOR = "\n===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "\n===\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_TWIST = "\n===\nMSG: geometry_msgs/Twist\nVector3 linear\nVector3 angular" + _VECTOR
BUILT_IN: dict[str, str] = {
    "sensor_msgs/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
        + _HEADER
        + _QUATERNION
        + _VECTOR
    ),
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\nVector3 vector" + _HEADER + _VECTOR,
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\nTwist twist" + _HEADER + _TWIST,
    "geometry_msgs/Twist": "Vector3 linear\nVector3 angular" + _VECTOR,
    "geometry_msgs/TwistWithCovarianceStamped": (
        "std_msgs/Header header\nTwistWithCovariance twist\n===\nMSG: geometry_msgs/TwistWithCovariance\n"
        "Twist twist\nfloat64[36] covariance" + _HEADER + _TWIST
    ),
    "geometry_msgs/AccelStamped": (
        "std_msgs/Header header\nAccel accel\n===\nMSG: geometry_msgs/Accel\nVector3 linear\nVector3 angular"
        + _HEADER
        + _VECTOR
    ),
    "sensor_msgs/Temperature": "std_msgs/Header header\nfloat64 temperature\nfloat64 variance" + _HEADER,
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


def plain_type(name: str) -> str:
    """Return ``package/Name`` of ``package/msg/Name``."""
    return name.replace("/msg/", "/")


def built_in(name: str, *, ros1: bool) -> str | None:
    """Return the definition of a well-known type, or None."""
    text = BUILT_IN.get(plain_type(name))
    if text is None:
        return None
    seq, time = ("uint32 seq\n", "time") if ros1 else ("", "builtin_interfaces/Time")
    return text.replace("{seq}", seq).replace("{time}", time)


class Line(NamedTuple):
    """A line of a definition: one field."""

    kind: str
    array: str | None
    bounded: str | None
    elements: str | None
    name: str

    @property
    def is_number(self) -> bool:
        return self.kind in _NUMBERS

    @property
    def is_text(self) -> bool:
        return self.kind in {"string", "wstring"}

    @property
    def is_time(self) -> bool:
        return plain_type(self.kind) in _TIMES

    @property
    def fixed(self) -> int | None:
        """Elements of an array of a fixed size."""
        return int(self.elements) if self.array is not None and self.elements and not self.bounded else None

    @property
    def brackets(self) -> str:
        """``[3]`` of an array, ``[]`` of a sequence, nothing of a single field."""
        return "" if self.array is None else f"[{self.fixed if self.fixed is not None else ''}]"


class Definitions:
    """The definition of a message type and of the types in it.

    Parameters
    ----------
    text
        Its own, those of types in it behind lines of ``===`` perhaps.
    more
        Definitions of other types, by ``package/Name``; with them the standard types of ROS are known too.
    """

    def __init__(self, name: str, text: str, *, ros1: bool, more: Mapping[str, str] | None = None) -> None:
        self.name = plain_type(name)
        self._ros1 = ros1
        self._standard = more is not None
        self._defined = _split(self.name, text)
        for other, body in (more or {}).items():
            for known, lines in _split(other, body).items():
                self._defined.setdefault(known, lines)

    def lines(self, name: str | None = None) -> list[Line]:
        """Return the fields of a type, that of the messages by default."""
        return self._defined[name or self.name]

    def resolve(self, owner: str | None, kind: str) -> str:
        """Return the type that a field of `owner` is of; a DefinitionError where it is not defined."""
        name = plain_type(kind)
        package = (owner or self.name).partition("/")[0]
        candidates = [name] if "/" in name else [f"{package}/{name}", f"std_msgs/{name}"]
        candidates += [known for known in self._defined if known.endswith("/" + name)]
        # A file outside of its package.
        candidates.append("/" + name.rpartition("/")[2])
        for candidate in candidates:
            if candidate in self._defined or (self._standard and self._take_standard(candidate)):
                return candidate
        msg = f"type {kind} is not defined"
        if self._standard:
            msg += f"; give its .msg file too, {name.rpartition('/')[2]}.msg"
        raise DefinitionError(msg)

    def _take_standard(self, name: str) -> bool:
        """Take a type of ROS itself; False where there is none of that name."""
        from rosbags.typesys import Stores, get_typestore
        from rosbags.typesys.base import TypesysError

        if name.startswith("/"):
            return False
        store = get_typestore(Stores.ROS1_NOETIC if self._ros1 else Stores.LATEST)
        try:
            text, _ = store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1 if self._ros1 else 2)
        except (TypesysError, KeyError):
            return False
        for known, lines in _split(name, text).items():
            self._defined.setdefault(known, lines)
        return True


def flatten(name: str, text: str, *, ros1: bool, more: Mapping[str, str] | None = None) -> tuple[Field, ...]:
    """Return the fields of a message, nested ones in their place.

    A field that can't be laid out (a sequence of structures or strings) is of kind "other"; what follows
    it is left out, because its place depends on that field. For `more` see `Definitions`.

    Raises
    ------
    DefinitionError
        If a line can't be read, or a type is not defined.
    """
    return tuple(_Flattener(Definitions(name, text, ros1=ros1, more=more), ros1=ros1).fields)


class _Flattener:
    """Walks the definitions of a message and of the types in it."""

    def __init__(self, definitions: Definitions, *, ros1: bool) -> None:
        self.ros1 = ros1
        self.numbers = {**_NUMBERS, "byte": "i1"} if ros1 else _NUMBERS
        self.sec = "u4" if ros1 else "i4"
        self.definitions = definitions
        self.fields: list[Field] = []
        self._walk(definitions.name, "", 0)

    def _walk(self, name: str, prefix: str, depth: int) -> bool:
        """Append the fields of a type; False where the layout ends being known."""
        if depth > _DEEP or len(self.fields) > _MANY:
            msg = f"{name} nests too deeply or has too many fields"
            raise DefinitionError(msg)
        lines = self.definitions.lines(name)
        if not lines and not self.ros1:
            # A ROS 2 structure without members takes one byte: rosidl adds a member.
            self.fields.append(Field(prefix + "structure_needs_at_least_one_member", "number", "u1"))
        return all(self._field(name, line, prefix, depth) for line in lines)

    def _field(self, owner: str, line: Line, prefix: str, depth: int) -> bool:
        kind, array, fixed = line.kind, line.array, line.fixed
        path = prefix + line.name
        if kind in self.numbers:
            self._number(path, self.numbers[kind], array, fixed)
            return True
        if line.is_text:
            plain = array is None and kind == "string"
            self.fields.append(Field(path, "string" if plain else "other"))
            return plain
        repeat = 1 if array is None else fixed
        if line.is_time:
            return self._times(path, array)
        nested = self.definitions.resolve(owner, kind)
        if repeat is None:
            return self._structures(nested, path, depth)
        if repeat > _MANY:
            msg = f"{path} has {repeat} elements"
            raise DefinitionError(msg)
        paths = [path] if array is None else [f"{path}[{i}]" for i in range(repeat)]
        return all(self._walk(nested, path + ".", depth + 1) for path in paths)

    def _number(self, path: str, code: str, array: str | None, fixed: int | None) -> None:
        if array is None:
            self.fields.append(Field(path, "number", code))
        elif fixed is not None:
            self.fields.append(Field(path, "array", code, fixed))
        else:
            self.fields.append(Field(path, "sequence", code))

    def _times(self, path: str, array: str | None) -> bool:
        if array is not None:
            self.fields.append(Field(path, "other"))
            return False
        self.fields += [Field(path + ".sec", "number", self.sec), Field(path + ".nanosec", "number", "u4")]
        return True

    def _structures(self, nested: str, path: str, depth: int) -> bool:
        """Lay out a sequence of structures that hold numbers of one size only."""
        start = len(self.fields)
        whole = self._walk(nested, path + "[].", depth + 1)
        inner, self.fields[start:] = self.fields[start:], []
        codes = {field.size for field in inner}
        if whole and len(codes) == 1 and all(field.kind in {"number", "array"} for field in inner):
            count = sum(field.count for field in inner)
            self.fields.append(Field(path, "sequence", inner[0].code, count))
            return True
        self.fields.append(Field(path, "other"))
        return False


def _split(name: str, text: str) -> dict[str, list[Line]]:
    """Return the lines of each type in a definition."""
    defined: dict[str, list[Line]] = {}
    for index, part in enumerate(_SEPARATOR.split(text)):
        own, body = name, part
        if index:
            match = re.match(r"\s*MSG:\s*(\S+)", part)
            if match is None:
                continue
            own, body = plain_type(match[1]), part[match.end() :]
        defined.setdefault(own, [line for raw in body.splitlines() if (line := _line(raw)) is not None])
    return defined


def _line(raw: str) -> Line | None:
    """Return the parts of a line; None for blanks, comments and constants."""
    line = raw.partition("#")[0].strip()
    if not line:
        return None
    match = _FIELD.match(line)
    if match is None:
        msg = f"line {line[:60]!r} is not a field"
        raise DefinitionError(msg)
    if match[6].startswith("="):
        return None
    return Line(*match.group(1, 2, 3, 4, 5))


#: A folder with more files is none of message definitions.
_DEFINITION_FILES_MANY = 20_000


def read_definitions(paths: Sequence[Path]) -> dict[str, str]:
    """Return the definitions in files and folders: ``package/Name`` -> text.

    The name is that of the file; the package that of the folder above ``msg/``, and empty elsewhere.

    Raises
    ------
    ReadError
        If a file can't be read, or there is none in a folder.
    """
    found = {}
    for path in paths:
        files = sorted(path.rglob("*.msg"))[:_DEFINITION_FILES_MANY] if path.is_dir() else [path]
        if not files:
            msg = f"{path}: no .msg files in this folder; expected the definitions of message types"
            raise ReadError(msg)
        for file in files:
            try:
                text = file.read_text(encoding="utf-8-sig")
            except (OSError, UnicodeDecodeError) as error:
                msg = f"{file}: can't be read: {error}; expected a message definition"
                raise ReadError(msg) from error
            folder = file.resolve().parent
            package = folder.parent.name if folder.name == "msg" else ""
            found[f"{package}/{_stem(file)}"] = text
    return found


def _stem(file: Path) -> str:
    """Return the name of the type that a file defines; packages and versions may stand in its name."""
    return re.split(r"[/.]|__", file.name.removesuffix(".msg"))[-1]


def definition_of(kind: str, given: dict[str, str]) -> str | None:
    """Return the given definition of a type; None where none of that name is given.

    One of its package goes first; one of another package is none, one of no package is.
    """
    name = plain_type(kind)
    return given.get(name, given.get("/" + name.rpartition("/")[2]))


@dataclass(frozen=True, slots=True)
class ChannelDefinition:
    """The definition of a channel's type, and whether it is `assumed` from the type's name.

    `more` are definitions of other types; None where the log's own definition is whole.
    """

    text: str
    assumed: bool
    more: dict[str, str] | None = None

    def fields(self, channel: Channel) -> tuple[Field, ...]:
        """Return the flat fields; a DefinitionError where they can't be told."""
        return flatten(channel.type, self.text, ros1=channel.encoding == "ros1", more=self.more)


def definition_of_channel(channel: Channel, options: ReadOptions) -> ChannelDefinition:
    """Return the definition of a channel's type: the log's own, one that is given, or the standard one.

    Raises
    ------
    DefinitionError
        If the type has no definition, or one that can't be read.
    """
    standard = built_in(channel.type, ros1=channel.encoding == "ros1")
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        own = ChannelDefinition(channel.definition, assumed=False)
        try:
            own.fields(channel)
        except DefinitionError:
            # A damaged definition of a well-known type loses nothing: messages must have its size.
            if standard is None:
                raise
            return ChannelDefinition(standard, assumed=True)
        return own
    given = read_definitions(options.message_definitions)
    text = definition_of(channel.type, given)
    if text is not None:
        return ChannelDefinition(text, assumed=True, more=given)
    if standard is None:
        kind = f" but of kind {channel.definition_kind!r}" if channel.definition_kind else ""
        others = ", ".join(sorted(name.strip("/") for name in given)[:8])
        names = f", those that are given are of {others}" if given else ""
        last = plain_type(channel.type).rpartition("/")[2]
        msg = f"the log holds no definition of {channel.type}{kind}{names}; give its .msg file, {last}.msg"
        raise DefinitionError(msg)
    return ChannelDefinition(standard, assumed=True)


def is_given(channel: Channel, options: ReadOptions) -> bool:
    """Return whether the user gives the definition of a channel's type."""
    return definition_of(channel.type, read_definitions(options.message_definitions)) is not None
