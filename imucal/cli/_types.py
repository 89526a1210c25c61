"""Types of options that several commands share: numbers and confidence levels."""

import math
import re

import click


class Number(click.FloatRange):
    """A finite number in a range: click lets nan and infinity through."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(str(value), param, ctx))  # type: ignore[arg-type] # click's stub is narrow
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


#: Hz: no IMU is slower or faster, and no product of these overflows.
RATE = Number(1e-6, 1e9)
#: Written like this, averaging times are a set and not a list.
TAU_SET = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")
#: Beyond these levels an interval is a point or everything.
LEVEL = Number(0.01, 0.999999)
