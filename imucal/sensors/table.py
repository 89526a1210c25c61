"""The table of parts, `parts.toml`, which is read on first use; the search by name."""

import difflib
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from imucal.errors import ChoiceError, Fix
from imucal.recording import Sensor
from imucal.sensors.part import RANGE_UNITS, Figure, Part, PartSensor, TermFigure

__all__ = ["every_part", "find_sensor"]

#: Least similarity of a name that is suggested; BMI08 and BMI088 have 0.91.
_SIMILAR = 0.6
#: How many similar names are suggested.
_SUGGESTED = 3
_LIST = "list all parts with 'imucal sensor --list'"


@cache
def _table() -> Mapping[str, Any]:
    text = files("imucal.sensors").joinpath("parts.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


@cache
def every_part() -> Mapping[str, Part]:
    """Return name -> part, in the order of the file: by manufacturer."""
    sources = _table()["sources"]
    return MappingProxyType({name: _part(name, table, sources) for name, table in _table()["parts"].items()})


def find_sensor(name: str) -> Part:
    """Return a part by its name, an alias or the device that contains it; errors as of `imucal.sensor`."""
    wanted = _key(name)
    known = {_key(each): part for part in every_part().values() for each in (*part.aliases, part.name)}
    if wanted in known:
        return known[wanted]
    devices = {_key(device): device for device in _table()["devices"]}
    if wanted in devices:
        return _inside(devices[wanted])
    spellings = {_key(each): each for part in every_part().values() for each in (part.name, *part.aliases)}
    spellings |= devices
    raise _unknown(name, wanted, spellings)


def _unknown(name: str, wanted: str, spellings: Mapping[str, str]) -> ChoiceError:
    """Return the error about an unknown name, with variants of the part or similar names."""
    variants = [spelling for key, spelling in spellings.items() if wanted and key.startswith(wanted)]
    similar = difflib.get_close_matches(wanted, spellings, n=_SUGGESTED, cutoff=_SIMILAR)
    near = variants or [spellings[key] for key in similar]
    problem = f"no part {name!r}"
    if not near:
        return ChoiceError(problem, fix=Fix(_LIST, "name"))
    return ChoiceError(problem, fix=Fix(f"did you mean {' or '.join(near)}?", "name", near[0]))


def _inside(device: str) -> Part:
    """Return the part in a device."""
    contained = _table()["devices"][device]["parts"]
    there = [name for name in contained if name in every_part()]
    if len(there) == len(contained) == 1:
        return every_part()[there[0]]
    problem = f"{device} contains {' or '.join(contained)}"
    if not there:
        raise ChoiceError(f"{problem}, of which no figures are known", fix=Fix(_LIST, "name"))
    text = f"name the part: {' or '.join(there)}"
    raise ChoiceError(problem, fix=Fix(text, "name", there[0]))


def _key(name: str) -> str:
    """Return letters and digits in lower case."""
    return "".join(sign for sign in name.lower() if sign.isalnum())


def _part(name: str, table: Mapping[str, Any], sources: Mapping[str, str]) -> Part:
    sensors = {
        sensor: _sensor(sensor, table[sensor.short], sources) for sensor in Sensor if sensor.short in table
    }
    return Part(
        name=name,
        manufacturer=table["manufacturer"],
        kind=table["kind"],
        confidence=table["confidence"],
        aliases=tuple(table.get("aliases", ())),
        note=table.get("note", ""),
        sensors=MappingProxyType(sensors),
    )


def _sensor(sensor: Sensor, table: Mapping[str, Any], sources: Mapping[str, str]) -> PartSensor:
    unit = RANGE_UNITS[sensor].replace("/", "_")
    terms = {symbol: _term(symbol, sensor, table[symbol]) for symbol in ("N", "B", "K") if symbol in table}
    figures = {name: _figure(figure, sources) for name, figure in table["printed"].items()}
    return PartSensor(
        sensor=sensor,
        terms=MappingProxyType(terms),
        full_scale=tuple(map(float, table.get(f"full_scale_{unit}", ()))),
        lsb_per_unit=tuple(map(float, table.get(f"lsb_per_{unit}", ()))),
        figures=MappingProxyType(figures),
    )


def _term(symbol: str, sensor: Sensor, table: Mapping[str, Any]) -> TermFigure:
    return TermFigure(
        symbol=symbol,
        sensor=sensor,
        value=table["value"],
        kind=table.get("kind", "typical"),
        maximum=table.get("maximum"),
        origin=table["from"],
        alternative=table.get("alternative"),
        alternative_origin=table.get("alternative_from", ""),
    )


def _figure(table: Mapping[str, Any], sources: Mapping[str, str]) -> Figure:
    xyz = table.get("si_xyz")
    return Figure(
        printed=table["printed"],
        si=table.get("si"),
        si_xyz=None if xyz is None else (xyz[0], xyz[1], xyz[2]),
        kind=table.get("kind", "typical"),
        condition=table.get("condition", ""),
        definition=table.get("definition", ""),
        source=sources[table["source"]],
    )
