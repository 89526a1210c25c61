"""The text in which a user says which columns are which: ``t=0,g=1:4,a=4:7``."""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.readers.tables.columns import Rows, ask


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The columns a user gave, by place."""

    time: tuple[int, ...] = ()
    gyro: tuple[int, int, int] | None = None
    accel: tuple[int, int, int] | None = None
    temperature: int | None = None
    gyro_rows: Rows = None
    accel_rows: Rows = None


def parse_columns_text(text: str, headers: Sequence[str], path: str) -> Asked:
    """Return the columns that a text such as ``t=0,g=1:4,a=4:7`` names.

    ``t`` is the time (``t=0+1`` joins seconds and nanoseconds), ``g`` the gyroscope, ``a`` the
    accelerometer, ``temp`` the temperature. Three columns are places from 0 with the end left out
    (``1:4``) or places or names joined by ``+`` (``wx+wy+wz``). ``a=2:5@imu`` takes only the rows
    that have ``imu`` in one of their cells, ``a=2:5@I:0`` those with 0 in column I.

    Raises
    ------
    ChoiceError
        If the text can't be read, or names a column that isn't there.
    """
    found: dict[str, tuple[int, ...]] = {}
    rows: dict[str, Rows] = {}
    for part in (piece for piece in text.split(",") if piece.strip()):
        key, equals, value = part.partition("=")
        key = _KEYS.get(key.strip().lower(), "")
        if not (key and equals):
            raise ask(
                path, f"columns text {text!r}: {part.strip()!r} is not t=…, g=…, a=… or temp=…", headers
            )
        value, at, tag = value.partition("@")
        found[key] = _places(value, headers, path, text)
        if at:
            rows[key] = _tag(tag, headers, path, text)
    for key in ("g", "a"):
        if key in found and len(found[key]) != 3:
            raise ask(
                path, f"columns text {text!r}: {key} names {len(found[key])} columns, expected 3", headers
            )
    if "g" not in found and "a" not in found:
        raise ask(path, f"columns text {text!r}: names neither gyroscope (g) nor accelerometer (a)", headers)
    if len(found.get("t", ())) > 2 or len(found.get("temp", ())) > 1:
        raise ask(path, f"columns text {text!r}: t takes one or two columns, temp one", headers)
    gyro, accel = found.get("g"), found.get("a")
    return Asked(
        time=found.get("t", ()),
        gyro=(gyro[0], gyro[1], gyro[2]) if gyro else None,
        accel=(accel[0], accel[1], accel[2]) if accel else None,
        temperature=found["temp"][0] if found.get("temp") else None,
        gyro_rows=rows.get("g"),
        accel_rows=rows.get("a"),
    )


_KEYS = {
    "t": "t",
    "time": "t",
    "g": "g",
    "gyro": "g",
    "a": "a",
    "accel": "a",
    "temp": "temp",
    "temperature": "temp",
}


def _places(value: str, headers: Sequence[str], path: str, text: str) -> tuple[int, ...]:
    first, colon, stop = value.strip().partition(":")
    if colon and first.strip().isdigit() and stop.strip().isdigit():
        places = tuple(range(int(first), min(int(stop), int(first) + len(headers) + 4)))
    else:
        places = tuple(place_of(name, headers, path, text) for name in value.split("+"))
    for place in places:
        if place >= len(headers):
            raise ask(
                path,
                f"columns text {text!r}: there is no column {place}, the last is {len(headers) - 1}",
                headers,
            )
    return places


def place_of(name: str, headers: Sequence[str], path: str, text: str) -> int:
    """Return the place of a column given by name or place.

    Raises
    ------
    ChoiceError
        If there is no such column, or several.
    """
    name = name.strip()
    plain = [_plain(header) for header in headers]
    matches = [place for place, header in enumerate(plain) if header == _plain(name)]
    if len(matches) == 1:
        return matches[0]
    if name.isdigit() and not matches:
        place = int(name)
        if place < len(headers):
            return place
    found = f"{len(matches)} columns are called {name!r}" if matches else f"there is no column {name!r}"
    raise ask(path, f"columns text {text!r}: {found}", headers)


def _tag(tag: str, headers: Sequence[str], path: str, text: str) -> Rows:
    column, colon, value = tag.partition(":")
    if colon:
        return place_of(column, headers, path, text), value.strip()
    return -1, tag.strip()


def _plain(header: str) -> str:
    return header.strip().strip("\"'\ufeff").lstrip("#%").strip().lower()
