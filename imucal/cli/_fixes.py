"""How the command line spells the fixes of an error: ``gyro_unit`` is ``--gyro-unit UNIT``."""

from collections.abc import Iterable
from typing import Any

from imucal.errors import Fix, ImucalError

#: Argument of a function -> its option. Other arguments have none.
_OPTIONS = {
    "topic": "--topic",
    "columns": "--columns",
    "time": "--time",
    "time_unit": "--time-unit",
    "rate_hz": "--rate",
    "gyro_unit": "--gyro-unit",
    "accel_unit": "--accel-unit",
    "gyro_scale": "--gyro-scale",
    "accel_scale": "--accel-scale",
    "message_definition": "--msg",
    "join": "--join",
    "skip_s": "--skip",
    "take_s": "--take",
    "rest_at_least": "--rest-at-least",
    "in_hand": "--in-hand",
    "model": "--sensor",
    "rests": "--rests",
    "force": "--force",
}


def option_of(fix: Fix) -> str:
    """Return the option of a fix with its value, such as ``--rate HZ``; empty if there is none."""
    option = _OPTIONS.get(fix.argument, "")
    return f"{option} {fix.value}" if option and fix.value else option


def options_for(problems: Iterable[Iterable[Fix]]) -> str:
    """Return the options for problems with alternative fixes, such as ``--rate HZ and --gyro-unit UNIT``."""
    asked = [" or ".join(filter(None, dict.fromkeys(map(option_of, fixes)))) for fixes in problems]
    return " and ".join(filter(None, dict.fromkeys(asked)))


def message_of(error: ImucalError) -> str:
    """Return an error for people: the sentence, and the options that help."""
    hint = options_for(part.fixes for part in error.parts())
    return f"{error}\nUse {hint}." if hint else str(error)


def fields_of(error: BaseException) -> dict[str, Any]:
    """Return the fields of an error for ``--json``; other errors have none."""
    if not isinstance(error, ImucalError):
        return {}
    first, *others = error.parts()
    return {**_fields(first), "also": [_fields(other) for other in others]}


def _fields(error: ImucalError) -> dict[str, Any]:
    fixes = [
        {"text": fix.text, "argument": fix.argument, "value": fix.value, "option": option_of(fix)}
        for fix in error.fixes
    ]
    return {"problem": error.problem, "place": error.place, "code": error.code, "fixes": fixes}
