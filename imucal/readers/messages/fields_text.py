"""The text in which a user says which fields of messages are which: ``gyro=gx,gy,gz accel=ax,ay,az``."""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError
from imucal.recording import AXES, Axis, Sensor

_KEYS = {
    **dict.fromkeys(("g", "gyro"), "gyro"),
    **dict.fromkeys(("a", "accel"), "accel"),
    **dict.fromkeys(("t", "time"), "time"),
    **dict.fromkeys(("temp", "temperature"), "temp"),
}
_KEYS |= {f"{name}.{axis}": f"{_KEYS[name]}.{axis}" for name in ("g", "gyro", "a", "accel") for axis in AXES}
#: How many paths each key may have; one of an axis has one.
_COUNTS = {"gyro": (1, 3), "accel": (1, 3), "time": (1, 2)}

_FORM = "gyro=PATH,PATH,PATH accel=PATH,PATH,PATH time=PATH, or gyro.z=PATH"

#: What stands in a path for each element of a list.
EACH = "[]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """The paths of a sensor: of its axes, or one of what holds them; `axes` where the text says which."""

    paths: tuple[str, ...] = ()
    axes: tuple[Axis, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldsText:
    """Paths of fields such as ``imu.gyro.x``, ``gyro[0]``, ``imus[1].gyro_x`` or ``imus[].gyro``.

    A sensor has the three of its axes, or one of what holds them, or some axes by their names; the time one,
    or seconds and nanoseconds.
    """

    gyro: Named = Named()
    accel: Named = Named()
    time: tuple[str, ...] = ()
    temperature: str = ""

    def of(self, sensor: Sensor) -> Named:
        """Return what names a sensor."""
        return self.gyro if sensor is Sensor.GYROSCOPE else self.accel


def parse_fields_text(texts: Sequence[str]) -> FieldsText | None:
    """Return what texts such as ``gyro=gx,gy,gz accel.z=a`` name, or None where there is none.

    Raises
    ------
    ChoiceError
        If a text can't be read.
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
        msg = f"fields text {' '.join(texts)!r} names no sensor; expected the form {_FORM}"
        raise ChoiceError(msg)
    return text


def _named(key: str, found: dict[str, tuple[str, ...]]) -> Named:
    axes = tuple(axis for axis in AXES if f"{key}.{axis}" in found)
    paths = tuple(found[f"{key}.{axis}"][0] for axis in axes)
    return Named(paths=paths or found.get(key, ()), axes=axes)
