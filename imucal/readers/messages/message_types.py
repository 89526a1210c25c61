"""Message types with IMU samples: find the fields of time, angular rate and specific force.

A type is recognised by its fields, not by its name: any message with an ``angular_velocity`` or a
``linear_acceleration`` (or another usual spelling), at any depth. Plain vectors of ``geometry_msgs`` are read
only if the user names the topic. The user may choose fields: ``gyro=gx,gy,gz accel=ax,ay,az``.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError
from imucal.frozen import frozen
from imucal.readers.messages.definitions import Field, plain_type
from imucal.recording import AXES, Axis, Sensor

_KEYS = {
    **dict.fromkeys(("g", "gyro"), "gyro"),
    **dict.fromkeys(("a", "accel"), "accel"),
    **dict.fromkeys(("t", "time"), "time"),
    **dict.fromkeys(("temp", "temperature"), "temp"),
}
_KEYS |= {f"{name}.{axis}": f"{_KEYS[name]}.{axis}" for name in ("g", "gyro", "a", "accel") for axis in AXES}
#: Allowed numbers of paths for each key; a key of one axis has one.
_COUNTS = {"gyro": (1, 3), "accel": (1, 3), "time": (1, 2)}

_FORM = "gyro=PATH,PATH,PATH accel=PATH,PATH,PATH time=PATH temp=PATH, or gyro.z=PATH"

#: Suffix in a path for each element of a list.
EACH = "[]"

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

#: Names of a vector, best first.
_STEMS: dict[Sensor, tuple[str, ...]] = {
    _GYRO: ("angular_velocity", "gyro_rad", "gyro", "gyroscope", "angular_rate", "angularrate", "body_rate",
            "rotation_rate", "gyro_rate"),
    _ACCEL: ("linear_acceleration", "accelerometer_m_s2", "accel", "acceleration", "accelerometer", "acc",
             "specific_force"),
}  # fmt: skip
#: Name of a message's top level if a field contains another IMU.
TOP = "top"
#: Field of nanoseconds -> field of seconds, in ROS and protobuf.
_PARTS = {"nanosec": "sec", "nanos": "seconds"}
_TEMPERATURE = re.compile(r"(^|[._])(temperature|temp|imu_temperature|imu_temp)$")

#: Types of general vectors: path of the vector, and its sensor (None: from the topic's name).
_PLAIN: dict[str, tuple[str, Sensor | None]] = {
    "geometry_msgs/Vector3Stamped": ("vector", None),
    "geometry_msgs/Vector3": ("", None),
    "geometry_msgs/TwistStamped": ("twist.angular", _GYRO),
    "geometry_msgs/Twist": ("angular", _GYRO),
    "geometry_msgs/TwistWithCovarianceStamped": ("twist.twist.angular", _GYRO),
    "nav_msgs/Odometry": ("twist.twist.angular", _GYRO),
    "geometry_msgs/AccelStamped": ("accel.linear", _ACCEL),
    "geometry_msgs/Accel": ("linear", _ACCEL),
    "geometry_msgs/AccelWithCovarianceStamped": ("accel.accel.linear", _ACCEL),
}


@frozen
class Named:
    """The paths of a sensor's axes, or the path of their parent; `axes` if the text names them."""

    paths: tuple[str, ...] = ()
    axes: tuple[Axis, ...] = ()


@frozen
class FieldsText:
    """Paths of fields such as ``imu.gyro.x``, ``gyro[0]``, ``imus[1].gyro_x`` or ``imus[].gyro``.

    A sensor has paths of three axes, one path of their parent, or paths of named axes. The time has one path,
    or paths of seconds and nanoseconds.
    """

    gyro: Named = Named()
    accel: Named = Named()
    time: tuple[str, ...] = ()
    temperature: str = ""

    def of(self, sensor: Sensor) -> Named:
        """Return the paths of a sensor."""
        return self.gyro if sensor is Sensor.GYROSCOPE else self.accel


def parse_fields_text(texts: Sequence[str]) -> FieldsText | None:
    """Parse texts such as ``gyro=gx,gy,gz accel.z=a``; None if there are none.

    Raises ChoiceError if a text can't be read.
    """
    found: dict[str, tuple[str, ...]] = {}
    for part in " ".join(texts).split():
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.lower(), "")
        paths = tuple(path.strip("/") for path in value.split(",") if path)
        counts = _COUNTS.get(key, (1,))
        doubled = any(key in {other, other.partition(".")[0]} or other == key[:-2] for other in found)
        eaches = max((path.count(EACH) for path in paths), default=0)
        if not key or not equals or doubled or len(paths) not in counts or eaches > 1:
            msg = f"fields text {' '.join(texts)!r}: {part!r} can't be read; expected the form {_FORM}"
            raise ChoiceError(msg)
        found[key] = paths
    if not found:
        return None
    text = FieldsText(
        gyro=_named("gyro", found),
        accel=_named("accel", found),
        time=found.get("time", ()),
        temperature="".join(found.get("temp", ())),
    )
    if not (text.gyro.paths or text.accel.paths):
        raise ChoiceError(f"fields text {' '.join(texts)!r} names no sensor; expected the form {_FORM}")
    return text


def _named(key: str, found: dict[str, tuple[str, ...]]) -> Named:
    axes = tuple(axis for axis in AXES if f"{key}.{axis}" in found)
    paths = tuple(found[f"{key}.{axis}"][0] for axis in axes)
    return Named(paths=paths or found.get(key, ()), axes=axes)


@dataclass(frozen=True, slots=True)
class Stamp:
    """The time in a message: a ROS stamp (``sec``, ``nanosec``) or a count of microseconds."""

    sec: str
    nanosec: str = ""
    #: ns per count, if there is no `nanosec`.
    scale: int = 1000


@dataclass(frozen=True, slots=True)
class Vector:
    """A vector: the paths of x, y, z, the path of an array of three, or the paths of some axes."""

    sensor: Sensor
    paths: tuple[str, ...]
    #: The axes of the numbers, in order.
    axes: tuple[Axis, ...] = AXES
    #: Path of the duration in µs that converts an increment to a rate; empty for a rate.
    divisor: str = ""
    #: Unit in the names of the fields, a key of `imucal.units.SAMPLE_UNITS`; None if there is none.
    unit: str | None = None

    @property
    def field(self) -> str:
        """The field of the vector: ``left.gyro`` for ``left.gyro.x``, ``gyro`` for ``gyro_x``."""
        return self.paths[0] if len(self.paths) == 1 else self.paths[0][:-2]


@frozen
class ImuFields:
    """The IMU fields of a message type."""

    #: None if messages have no time stamp.
    stamp: Stamp | None
    #: One or two vectors, the gyroscope first.
    vectors: tuple[Vector, ...]
    #: Path of a temperature in degrees Celsius, or empty.
    temperature: str = ""
    #: Whether the vectors are general: read only if the user names the topic.
    plain: bool = False
    #: Whether the definition fixes SI units; otherwise SI is assumed and reported.
    standard: bool = True
    #: Other possible fields of vectors, which are not read.
    others: tuple[str, ...] = ()
    #: Whether the user named the fields; their units are then unknown.
    asked: bool = False

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of the vectors."""
        return tuple(vector.sensor for vector in self.vectors)

    @property
    def lists(self) -> bool:
        """Whether each element of a list in a message is a sample."""
        return any(EACH in path for vector in self.vectors for path in vector.paths)

    @property
    def wanted(self) -> tuple[str, ...]:
        """Paths of all fields to read."""
        paths = [path for vector in self.vectors for path in (*vector.paths, vector.divisor) if path]
        if self.stamp is not None:
            paths += [path for path in (self.stamp.sec, self.stamp.nanosec) if path]
        return (*paths, self.temperature) if self.temperature else tuple(paths)


def find_imus(name: str, fields: Sequence[Field], topic: str, sensor: Sensor | None) -> dict[str, ImuFields]:
    """Return the IMU fields of a message type: one entry for each IMU in a message.

    The key is the field with the IMU, such as ``left``, or empty if there is only one IMU. If the type does
    not determine the sensor, the caller's `sensor` or the name of the topic does.
    """
    known = _plain(plain_type(name), fields, topic, sensor) or _px4(plain_type(name), fields)
    if known is not None:
        return {"": known}
    found = {
        kind: [vector for stem in stems for vector in _called(fields, stem)] for kind, stems in _STEMS.items()
    }
    imus = _imus(found)
    taken = {paths for imu in imus.values() for paths in imu.values()}
    spare = [paths for vectors in found.values() for _, paths in vectors if paths not in taken]
    return {
        (owner or TOP) if len(imus) > 1 else "": _imu(fields, owner, imu, spare, others=set(imus) - {owner})
        for owner, imu in imus.items()
    }


def _imu(
    fields: Sequence[Field],
    owner: str,
    imu: dict[Sensor, tuple[str, ...]],
    spare: Sequence[tuple[str, ...]],
    *,
    others: set[str],
) -> ImuFields:
    """Return one IMU of a message, with its own stamp and temperature if it has them."""
    vectors = tuple(Vector(sensor, paths) for sensor, paths in imu.items())
    standard = all(path.split(".")[-2:-1] in (["angular_velocity"], ["linear_acceleration"])
                   for vector in vectors for path in vector.paths)  # fmt: skip
    theirs = tuple(other + "." for other in others if other)
    free = [field for field in fields if not theirs or not field.path.startswith(theirs)]
    if others:
        free.sort(key=lambda field: not (owner and field.path.startswith(owner + ".")))
    return ImuFields(
        stamp=_stamp(free),
        vectors=vectors,
        temperature=next((path for path in _floats(free) if _TEMPERATURE.search(path)), ""),
        standard=standard,
        others=tuple(Vector(_GYRO, paths).field for paths in spare),
    )


def sensor_of_topic(topic: str) -> Sensor | None:
    """Return the sensor in the name of a topic."""
    words = topic.lower()
    gyro = re.search(r"gyr|angular|omega|(^|[/_])w($|[/_])", words)
    accel = re.search(r"acc|force", words)
    if bool(gyro) == bool(accel):
        return None
    return _GYRO if gyro else _ACCEL


def is_command(topic: str) -> bool:
    """Return whether the name of a topic indicates commands instead of measurements."""
    return re.search(r"(^|[/_])(cmd|command|setpoint|desired|target)s?([/_]|$)", topic.lower()) is not None


def _plain(name: str, fields: Sequence[Field], topic: str, sensor: Sensor | None) -> ImuFields | None:
    path, fixed = _PLAIN.get(name, ("", None))
    kind = fixed or sensor or sensor_of_topic(topic)
    paths = _xyz(fields, path + "." if path else "")
    if name not in _PLAIN or kind is None or not paths:
        return None
    return ImuFields(stamp=_stamp(fields), vectors=(Vector(kind, paths),), plain=True)


def _px4(name: str, fields: Sequence[Field]) -> ImuFields | None:
    """PX4's own types: time in µs, increments instead of rates in VehicleImu."""
    if not name.startswith("px4_msgs/"):
        return None
    paths = {field.path for field in fields}
    clock = next((path for path in ("timestamp_sample", "timestamp") if path in paths), None)
    stamp = Stamp(clock) if clock else None
    if {"delta_angle", "delta_velocity", "delta_angle_dt"} <= paths:
        velocity_dt = "delta_velocity_dt" if "delta_velocity_dt" in paths else "dt"
        angle = Vector(_GYRO, ("delta_angle",), divisor="delta_angle_dt")
        velocity = Vector(_ACCEL, ("delta_velocity",), divisor=velocity_dt)
        return ImuFields(stamp=stamp, vectors=(angle, velocity))
    single = {"px4_msgs/SensorGyro": _GYRO, "px4_msgs/SensorAccel": _ACCEL}.get(name)
    if single is not None and paths.issuperset(AXES):
        temperature = "temperature" if "temperature" in paths else ""
        return ImuFields(stamp=stamp, vectors=(Vector(single, AXES),), temperature=temperature)
    both = {_GYRO: "gyro_rad", _ACCEL: "accelerometer_m_s2"}
    if not paths.issuperset(both.values()):
        return None
    vectors = tuple(Vector(sensor, (path,)) for sensor, path in both.items())
    return ImuFields(stamp=Stamp("timestamp"), vectors=vectors)


def _imus(found: dict[Sensor, list[tuple[str, tuple[str, ...]]]]) -> dict[str, dict[Sensor, tuple[str, ...]]]:
    """Return the vectors of each IMU by the field that contains them.

    Vectors in one field belong together. If no field contains both sensors, sensors that occur once are
    combined; otherwise each field is a separate IMU.
    """
    owned: dict[str, dict[Sensor, tuple[str, ...]]] = {}
    for sensor, vectors in found.items():
        for owner, paths in vectors:
            owned.setdefault(owner, {}).setdefault(sensor, paths)
    whole = {owner: imu for owner, imu in owned.items() if len(imu) == len(found)}
    if whole or not owned:
        return whole
    if all(len({owner for owner, _ in vectors}) <= 1 for vectors in found.values()):
        return {"": {sensor: paths for imu in owned.values() for sensor, paths in imu.items()}}
    return owned


def _called(fields: Sequence[Field], stem: str) -> list[tuple[str, tuple[str, ...]]]:
    """Return the vectors named `stem`, at any depth, in order: the parent field and the paths."""
    vectors: list[tuple[str, tuple[str, ...]]] = []
    for field in fields:
        owner, _, last = field.path.rpartition(".")
        above, _, name = owner.rpartition(".")
        if field.kind == "array" and field.count == 3 and last == stem and field.code in {"f4", "f8"}:
            vectors.append((owner, (field.path,)))
        elif field.kind == "number" and ((last == "x" and name == stem) or last == stem + "_x"):
            paths = _xyz(fields, field.path.removesuffix("x"))
            vectors += [(above if last == "x" else owner, paths)] if paths else []
    return vectors


def _floats(fields: Sequence[Field]) -> list[str]:
    """Return the paths of single floats."""
    return [field.path for field in fields if field.kind == "number" and field.code in {"f4", "f8"}]


def _xyz(fields: Sequence[Field], prefix: str) -> tuple[str, ...]:
    """Return the paths prefix + x, y, z, or an empty tuple."""
    paths = tuple(prefix + axis for axis in AXES)
    return paths if set(_floats(fields)).issuperset(paths) else ()


def _stamp(fields: Sequence[Field]) -> Stamp | None:
    """Return the first stamp of a header, or another time in the message."""
    for field in fields:
        owner, _, last = field.path.rpartition(".")
        if last in _PARTS and owner.rpartition(".")[2] in {"stamp", "timestamp", "time"}:
            return Stamp(f"{owner}.{_PARTS[last]}", field.path)
    return None
