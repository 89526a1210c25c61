"""Files of keys and numbers: which term a key holds, by which formula, and how its line is spelled."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, quoted, real, vector

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

#: Units of what a sensor's samples grow by in a second.
_GROWTH = {GYRO: "rad/s^2", ACCEL: "m/s^3"}


@dataclass(frozen=True, slots=True)
class Formula:
    """How a number follows from a coefficient c and the rate f of the file's stream, and its unit.

    In the unit, ``{u}`` stands for that of the samples (N) or of their growth in a second (K).
    """

    of: Callable[[float, float], float]
    unit: str


#: Continuous: c, and its square.
DENSITY = Formula(lambda c, f: c, "{u}/sqrt(Hz)")  # noqa: ARG005 - one signature for all
DENSITY_SQUARED = Formula(lambda c, f: c * c, "({u})^2/Hz")  # noqa: ARG005
#: Discrete: of one sample (N), or of a step as code sees it that multiplies it by dt (K); and its square.
SAMPLE = Formula(lambda c, f: c * math.sqrt(f), "{u}")
SAMPLE_SQUARED = Formula(lambda c, f: c * c * f, "({u})^2")


def at_period(seconds: float) -> Formula:
    """Return c / sqrt(dt): discrete at a filter's own period, whatever the rate."""
    return Formula(lambda c, f: c / math.sqrt(seconds), "{u}")  # noqa: ARG005


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a file: the term of a sensor that it holds, by a formula.

    A key for each axis has ``{axis}`` (x, y, z) or ``{i}`` (0, 1, 2) in its name.
    """

    name: str
    sensor: Sensor
    symbol: str
    formula: Formula = DENSITY

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return self.formula.unit.format(u=_GROWTH[self.sensor] if self.symbol == "K" else self.sensor.unit)


class Entry(NamedTuple):
    """A key with its number."""

    name: str
    value: float
    unit: str
    number: Number

    @property
    def remark(self) -> str:
        """Unit and origin."""
        return f"{self.unit}; {self.number.note}"


def four(names: str, white: Formula = DENSITY, walk: Formula | None = None) -> tuple[Key, ...]:
    """Return the four keys that most formats have: N and K of the accelerometer, then of the gyroscope."""
    terms = ((ACCEL, "N"), (ACCEL, "K"), (GYRO, "N"), (GYRO, "K"))
    return tuple(
        Key(name, sensor, symbol, walk or white if symbol == "K" else white)
        for name, (sensor, symbol) in zip(names.split(), terms, strict=True)
    )


def entries(numbers: Numbers, keys: Iterable[Key]) -> list[Entry]:
    """Return the numbers of the keys whose sensor is in the log."""
    found = []
    for key in keys:
        if key.sensor not in numbers.sensors:
            continue
        one_each = "{" in key.name
        chosen = numbers.each(key.sensor, key.symbol) if one_each else (numbers.one(key.sensor, key.symbol),)
        for i, number in enumerate(chosen):
            value = key.formula.of(number.value, numbers.stream_hz)
            found.append(Entry(key.name.format(i=i, axis="xyz"[i]), value, key.unit, number))
    return found


def lines(found: Iterable[Entry], layout: str = "{name}: {value}  # {remark}") -> list[str]:
    """Return one line a number; the layout knows name, value and remark (unit and origin)."""
    return [layout.format(name=e.name, value=real(e.value), remark=e.remark) for e in found]


def yaml_body(
    keys: tuple[Key, ...],
    above: Sequence[str] = (),
    below: Callable[[Numbers], Sequence[str]] = lambda numbers: (),  # noqa: ARG005 - none
    indent: str = "",
) -> Callable[[Numbers], Body]:
    """Return the body of a YAML file: the lines above, the keys, the lines below."""

    def body(numbers: Numbers) -> Body:
        found = entries(numbers, keys)
        middle = lines(found, indent + "{name}: {value}  # {remark}")
        return [entry.number for entry in found], [*above, *middle, *below(numbers)]

    return body


def json_object(name: str, members: Iterable[tuple[str, str]], indent: str = "  ") -> list[str]:
    """Return a member of a JSON object that is an object, one of its members a line."""
    inside = ",\n".join(f"{indent}  {quoted(key)}: {value}" for key, value in members).split("\n")
    return [f"{indent}{quoted(name)}: {{", *inside, f"{indent}}}"]


def json_origins(said: Iterable[str]) -> list[str]:
    """Return where the numbers of a JSON object are from, which has no comments, as its member."""
    inside = ",\n".join(f"    {quoted(each)}" for each in said).split("\n")
    return ['  "_origin": [', *inside, "  ],"]


def triad(numbers: Numbers, key: Key) -> tuple[list[Number], str]:
    """Return the numbers of the three axes, and their list as a file holds it."""
    chosen = numbers.each(key.sensor, key.symbol)
    return list(chosen), vector(key.formula.of(number.value, numbers.stream_hz) for number in chosen)
