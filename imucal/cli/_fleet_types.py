"""Values of the options of ``imucal fleet run``."""

import re
from typing import TYPE_CHECKING

import click

from imucal.cli.parameters.option_types import Duration, Structure
from imucal.cli.parameters.param_type import ParamType
from imucal.resources import parse_size

if TYPE_CHECKING:
    from imucal.fleet_run.logs import LabelPattern


class Size(ParamType[int]):
    """Bytes."""

    name = "size"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        from imucal.fleet_run.plan import LEAST_MEMORY

        try:
            size = value if isinstance(value, int) else parse_size(str(value))
        except ValueError as error:
            self.fail(f"{value!r}: expected {error}", param, ctx)
        if size < LEAST_MEMORY:
            self.fail(f"{value!r} is too little for any log; give {LEAST_MEMORY >> 20}M or more", param, ctx)
        return size


class Patience(Duration):
    """Seconds, or auto."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if value == "auto":
            return -1.0
        seconds = super().convert(value, param, ctx)
        if seconds == 0:
            self.fail("'0' is no time to work; write such as 10min, or auto", param, ctx)
        return seconds


class Shard(ParamType[tuple[int, int]]):
    """i/n, i from 1."""

    name = "shard"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", str(value).strip())
        number, of = (int(match[1]), int(match[2])) if match else (0, 0)
        if not 1 <= number <= of:
            self.fail(f"{value!r} is no part; write i/n with i from 1 to n, such as 1/8", param, ctx)
        return number, of


class Labels(ParamType["LabelPattern"]):
    """A pattern of paths with labels."""

    name = "labels"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> "LabelPattern":
        from imucal.fleet_run.logs import LabelPattern

        try:
            return LabelPattern(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class FixedStructure(Structure):
    """The terms of a model, the same for every log."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value == "auto":
            self.fail("auto would choose by the log; give the terms, such as 'N + B + K'", param, ctx)
        return super().convert(value, param, ctx)
