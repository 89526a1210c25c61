"""Types of options that several commands share: they refuse what is out of range, and say what is right."""

import math
import re
from typing import ClassVar

import click

from imucal.cli.parameters.param_type import ParamType
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, parse_sample_unit

#: Written like this, averaging times are a set and not a list.
_TAU_SET = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")


class Number(click.FloatRange):
    """A finite number in a range: click lets nan and infinity through.

    A `unit` may follow it, and a fraction may be given in percent.
    """

    def __init__(
        self,
        min: float | None = None,  # noqa: A002 - as click calls them
        max: float | None = None,  # noqa: A002
        *,
        min_open: bool = False,
        max_open: bool = False,
        unit: str = "",
        percent: bool = False,
    ) -> None:
        super().__init__(min, max, min_open=min_open, max_open=max_open)
        self.unit, self.percent = unit, percent

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        if self.unit:
            text = re.sub(f"\\s*{self.unit}$", "", text, flags=re.IGNORECASE)
        try:
            number = float(text.removesuffix("%")) / (100 if self.percent and text.endswith("%") else 1)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        if self.percent and 1 < number < 100:
            self.fail(f"{value!r} is more than all; did you mean {number / 100:g} or {text}%?", param, ctx)
        return float(super().convert(repr(number), param, ctx))  # type: ignore[arg-type] # click's stub is narrow


#: Hz: no IMU is slower or faster, and no product of these overflows.
RATE = Number(1e-6, 1e9, unit="Hz")
#: Beyond these levels an interval is a point or everything.
LEVEL = Number(0.01, 0.999999, percent=True)


class Duration(ParamType[float]):
    """Seconds, or a number with s, min, m, h or d."""

    name = "duration"
    _factors: ClassVar[dict[str, float]] = {"s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0}

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, int | float):
            return float(value)
        text = str(value).strip()
        number = text.rstrip("smindh")
        factor = self._factors.get(text[len(number) :] or "s")
        try:
            seconds = float(number) * (factor or float("nan"))
        except ValueError:
            seconds = float("nan")
        if not 0 <= seconds < float("inf"):
            self.fail(f"{text!r} is not a duration; write seconds, or such as 90s, 5min, 2.5h", param, ctx)
        return seconds


class UnitName(ParamType[str]):
    """A unit of one sensor's samples, in a spelling that can't be meant otherwise."""

    name = "unit"
    #: Plurals: a log's column may be called so, but "degs" typed by a person may be degrees.
    _unclear = frozenset({"rads", "mrads", "degs", "mdegs"})

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value)
        found = parse_sample_unit(text)
        known = ", ".join(SAMPLE_UNITS[self.sensor])
        if text.strip().lower() in self._unclear and found is not None:
            self.fail(f"{text!r} is not clear; did you mean {found[1]!r}?", param, ctx)
        if found is None or found[0] is not self.sensor:
            self.fail(f"{text!r} is no unit of the {self.sensor}; expected one of {known}", param, ctx)
        return text


class TauSet(ParamType[str]):
    """A set of averaging times by its name."""

    name = "taus"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value).strip()
        if not _TAU_SET.fullmatch(text):
            self.fail(f"{text!r} is not octave, decade, decade:20 or all", param, ctx)
        return text


class Taus(ParamType[str | tuple[float, ...]]):
    """A set of averaging times by name, or a list of durations."""

    name = "taus"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | tuple[float, ...]:
        text = str(value).strip()
        if _TAU_SET.fullmatch(text):
            return text
        try:
            seconds = tuple(Duration().convert(part, param, ctx) for part in text.split(","))
        except click.BadParameter:
            seconds = (0.0,)
        if min(seconds) <= 0:
            known = "octave, decade, decade:20 or all, nor a list of times such as 0.1,1,10min"
            self.fail(f"{text!r} is neither {known}", param, ctx)
        return seconds


class Structure(ParamType[str]):
    """The terms of a model, or auto."""

    name = "structure"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from imucal.noise import parse_structure, structure_text

        text = str(value)
        try:
            return text if text == "auto" else structure_text(parse_structure(text))
        except ValueError as error:
            self.fail(str(error), param, ctx)
