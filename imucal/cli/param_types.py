"""Types of option values: texts, numbers, units, times, models and paths."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from imucal.recording import Sensor
from imucal.units import (
    INCREMENT_UNITS,
    SAMPLE_UNITS,
    parse_increment_unit,
    parse_sample_unit,
    time_unit_ns,
)
from imucal.user_input import quantity, seconds_of


class Text(click.ParamType):  # type: ignore[type-arg,unused-ignore] # generic from click 8.4 on
    """A type whose values a function parses from a text; its ValueError becomes the message."""

    def __init__(self, name: str, parse: Callable[[str], object]) -> None:
        self.name, self._parse = name, parse

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        try:
            # A default may already be parsed.
            return self._parse(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Number(click.FloatRange):
    """A finite number in a range; click alone accepts nan and infinity.

    The text may end with the `unit`; with `percent`, a fraction may be written in percent.
    """

    def __init__(
        self,
        *limits: Any,  # noqa: ANN401
        unit: str = "",
        percent: bool = False,
        **attributes: Any,  # noqa: ANN401
    ) -> None:
        super().__init__(*limits, **attributes)
        self.unit, self.percent = unit, percent

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        units = {"": 1.0, self.unit.lower(): 1.0}
        if self.percent:
            units["%"] = 0.01
        number = quantity(text, units, any_case=True)
        if number is None:
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        if self.percent and 1 < number < 100:
            self.fail(f"{value!r} is more than all; did you mean {number / 100:g} or {text}%?", param, ctx)
        return float(super().convert(repr(number), param, ctx))  # type: ignore[arg-type] # click's stub is narrow


#: Units that are accepted in the columns of a log but not from users, who may mean degrees by "degs".
_UNCLEAR = frozenset({"rads", "mrads", "degs", "mdegs"})
#: Unit of raw samples, which only a calibration accepts without a scale.
COUNT = "count"


def _unit_of(sensor: Sensor, text: str) -> str:
    if text.strip().lower() in {COUNT, f"{COUNT}s"}:
        context = click.get_current_context(silent=True)
        if context is not None and context.info_name == "calibrate":
            return COUNT
        msg = f"{text!r} is not a unit of the {sensor}; give the size of a count with --{sensor.short}-scale"
        raise ValueError(f"{msg}, in {sensor.unit}")
    found = parse_sample_unit(text) or parse_increment_unit(text)
    if text.strip().lower() in _UNCLEAR and found is not None:
        raise ValueError(f"{text!r} is ambiguous; did you mean {found[1]!r}?")
    if found is None or found[0] is not sensor:
        msg = f"{text!r} is not a unit of the {sensor}; expected one of {', '.join(SAMPLE_UNITS[sensor])}, "
        msg += f"or {' or '.join(INCREMENT_UNITS[sensor])} per sample"
        raise ValueError(msg)
    return text


def _time_unit(text: str) -> str:
    if time_unit_ns(text) is None:
        raise ValueError(
            f"{text!r} is not a unit of time; expected s, ms, us, ns, min, h, d or a number of them"
        )
    return text


_NAMED_TAUS = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")
_TAU_NAMES = "octave, decade, decade:20 or all"


def _taus(text: str) -> str | tuple[float, ...]:
    name = text.strip()
    if _NAMED_TAUS.fullmatch(name):
        return name
    try:
        seconds = tuple(map(seconds_of, name.split(",")))
    except ValueError:
        seconds = (0.0,)
    if min(seconds) <= 0:
        raise ValueError(f"{name!r} is neither {_TAU_NAMES}, nor a list of times such as 0.1,1,10min")
    return seconds


def angle_of(text: str) -> str:
    """Return the text of a known angle, checked."""
    from imucal.calibration.known_turns import known_angle

    known_angle(text)
    return text


def structure_of(text: str) -> str:
    """Return the terms of a model in their usual order, or auto; a ValueError for any other text."""
    from imucal.noise import parse_structure, structure_text

    return text if text == "auto" else structure_text(parse_structure(text))


def model_of(sensor: Sensor) -> Text:
    """Return the type of a sensor's model."""

    def checked(text: str) -> str:
        from imucal.noise.model import NoiseModel

        NoiseModel.parse(text, sensor)
        return text

    return Text("model", checked)


def sample_unit(sensor: Sensor) -> Text:
    """Return the type of the unit of a sensor's samples."""
    return Text("unit", lambda text: _unit_of(sensor, text))


#: Rate in Hz: no IMU is outside this range, and no product overflows.
RATE = Number(1e-6, 1e9, unit="Hz")
#: Beyond these limits intervals are meaningless.
LEVEL = Number(0.01, 0.999999, percent=True)
SHARE = Number(0, 1, min_open=True, max_open=True, percent=True)
#: Relative half-width of an interval; it may exceed 1.
PRECISION = Number(min=0, min_open=True, percent=True)
SCALE = Number(min=0, min_open=True)
ANGLE = Text("angle", angle_of)
DURATION = Text("duration", seconds_of)
TIME_UNIT = Text("unit", _time_unit)
STRUCTURE = Text("structure", structure_of)
TAUS = Text("taus", _taus)
PATH = click.Path(path_type=Path)
FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
