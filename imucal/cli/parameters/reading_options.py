"""Options of how to read a log, where it doesn't say itself."""

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from imucal.cli.parameters.option_types import RATE, Number, UnitName
from imucal.recording import Sensor

Command = TypeVar("Command", bound=Callable[..., Any])

#: How to read a log, where it doesn't say itself.
READING = (
    click.option("--time", metavar="CLOCK", help="'header' or 'log' stamps; a table's time column."),
    click.option(
        "--time-unit",
        type=click.Choice(["s", "ms", "us", "ns"]),
        help="Unit of the time, where the log doesn't say.",
    ),
    click.option(
        "--rate",
        type=RATE,
        metavar="HZ",
        help="Sampling rate, where the log's own is missing or wrong.",
    ),
    click.option(
        "--gyro-unit",
        type=UnitName(Sensor.GYROSCOPE),
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, …, where the log doesn't say.",
    ),
    click.option(
        "--accel-unit",
        type=UnitName(Sensor.ACCELEROMETER),
        metavar="UNIT",
        help="m/s^2, g, mg, …, where the log doesn't say.",
    ),
    click.option(
        "--gyro-scale",
        type=Number(min=0, min_open=True),
        metavar="X",
        help="rad/s per count, for raw counts.",
    ),
    click.option(
        "--accel-scale",
        type=Number(min=0, min_open=True),
        metavar="X",
        help="m/s^2 per count, for raw counts.",
    ),
    click.option("--columns", metavar="TEXT", help="Columns of a table: t=0,g=1:4,a=4:7 or t=0,gz=1."),
    click.option(
        "--fields",
        multiple=True,
        metavar="TEXT",
        help="Fields of messages, such as 'gyro=gx,gy,gz accel=imu.a' or gyro.z=turn; info -v lists them.",
    ),
    click.option(
        "--msg",
        multiple=True,
        type=click.Path(exists=True, path_type=Path),
        metavar="FILE",
        help="Definition (.msg) of a type the log doesn't define, or a folder of them.",
    ),
)
#: What a fields text starts with.
_FIELDS = re.compile(r"(g|gyro|a|accel|t|time|temp|temperature)=")
#: Name of an option of `READING` -> argument of `imucal.read`, where they differ.
_ARGUMENTS = {"rate": "rate_hz", "msg": "message_definition"}
_READING = (
    *("time", "time_unit", "rate", "gyro_unit", "accel_unit", "gyro_scale", "accel_scale"),
    *("columns", "fields", "msg"),
)


def reading_options(command: Command) -> Callable[..., Any]:
    """Add the options of reading a log; the command gets them as `reading`, arguments of `imucal.read`."""

    @functools.wraps(command)
    def wrapper(**values: Any) -> object:  # noqa: ANN401 - click passes every option by name
        values = with_all_fields(values)
        reading = {_ARGUMENTS.get(name, name): values.pop(name) for name in _READING}
        return command(reading=reading, **values)

    decorated: Callable[..., Any] = wrapper
    for option in reversed(READING):
        decorated = option(decorated)
    return decorated


def with_all_fields(values: dict[str, Any]) -> dict[str, Any]:
    """Take what stands behind --fields without quotes, as in ``--fields gyro=g accel=a``, out of the logs."""
    if not values["fields"]:
        return values
    more = tuple(log for log in values["logs"] if _FIELDS.match(log) and not Path(log).exists())
    logs = tuple(log for log in values["logs"] if log not in more)
    return {**values, "logs": logs, "fields": (*values["fields"], *more)}
