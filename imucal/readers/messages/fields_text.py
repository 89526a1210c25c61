"""The text in which a user says which fields of messages are which: ``gyro=gx,gy,gz accel=ax,ay,az``."""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError
from imucal.recording import Sensor

_KEYS = {
    **dict.fromkeys(("g", "gyro"), "gyro"),
    **dict.fromkeys(("a", "accel"), "accel"),
    **dict.fromkeys(("t", "time"), "time"),
    **dict.fromkeys(("temp", "temperature"), "temp"),
}
#: How many paths each key may have.
_COUNTS = {"gyro": (1, 3), "accel": (1, 3), "time": (1, 2), "temp": (1,)}

_FORM = "gyro=PATH,PATH,PATH accel=PATH,PATH,PATH time=PATH"


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldsText:
    """Paths of fields such as ``imu.gyro.x``, ``gyro[0]`` or ``imus[1].gyro_x``.

    A sensor has the three of its axes, or one of what holds them; the time one, or seconds and nanoseconds.
    """

    gyro: tuple[str, ...] = ()
    accel: tuple[str, ...] = ()
    time: tuple[str, ...] = ()
    temperature: str = ""

    def of(self, sensor: Sensor) -> tuple[str, ...]:
        """Return the paths of a sensor."""
        return self.gyro if sensor is Sensor.GYROSCOPE else self.accel


def parse_fields_text(texts: Sequence[str]) -> FieldsText | None:
    """Return what texts such as ``gyro=gx,gy,gz accel=a`` name, or None where there is none.

    Raises
    ------
    ChoiceError
        If a text can't be read.
    """
    found: dict[str, tuple[str, ...]] = {}
    for part in " ".join(texts).split():
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.lower())
        paths = tuple(path.strip("/") for path in value.split(",") if path)
        if key is None or not equals or key in found or len(paths) not in _COUNTS[key]:
            msg = f"fields text {' '.join(texts)!r}: {part!r} can't be read; expected the form {_FORM}"
            raise ChoiceError(msg)
        found[key] = paths
    if not found:
        return None
    if "gyro" not in found and "accel" not in found:
        msg = f"fields text {' '.join(texts)!r} names no sensor; expected the form {_FORM}"
        raise ChoiceError(msg)
    return FieldsText(
        gyro=found.get("gyro", ()),
        accel=found.get("accel", ()),
        time=found.get("time", ()),
        temperature="".join(found.get("temp", ())),
    )
