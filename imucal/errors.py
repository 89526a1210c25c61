"""Every error imucal raises on purpose, and the exit code each one ends a command with.

Codes: 2 usage, 3 reading, 4 the data, 5 writing.

A message reads *where: what was found, what was expected, what to do*.
A caller's mistake (an argument out of range) is a `ValueError`; of what people type in notebooks, an
`ArgumentError`.
"""

from collections.abc import Sequence
from typing import ClassVar

#: What joins the things that a message asks for.
ALSO = "; also, "


class ImucalError(Exception):
    """Anything imucal can't do with what it was given."""

    exit_code: ClassVar[int] = 1
    #: Whether the results were printed all the same, and say what is wrong with them.
    told = False


class ReadError(ImucalError):
    """The log can't be read."""

    exit_code = 3


class ChoiceError(ReadError):
    """Which topic, sensor or columns to read is not clear; the message lists the candidates."""


def as_one(where: str, lacking: Sequence[ChoiceError]) -> ChoiceError:
    """Return errors that begin with `where` as one, which asks for everything at once."""
    texts = dict.fromkeys(str(error).removeprefix(f"{where}: ") for error in lacking)
    return lacking[0] if len(texts) == 1 else ChoiceError(f"{where}: {ALSO.join(texts)}")


class DataError(ImucalError):
    """The log was read, but its data can't be analysed."""

    exit_code = 4


class WriteError(ImucalError):
    """An output file can't be written."""

    exit_code = 5


class UsageError(ImucalError):
    """What was asked for can't be meant."""

    exit_code = 2


class LimitsError(UsageError):
    """The limits file of a check, or the config that it checks, can't be read or checked."""


class SettingError(UsageError):
    """An environment variable that sets imucal up holds what it can't."""


class ArgumentError(UsageError, ValueError):
    """An argument says what can't be meant; the message says what can."""


class MissingError(UsageError, KeyError):
    """There is no axis or term of that name; the message lists those there are."""

    # A KeyError would show its message in quotes.
    __str__ = Exception.__str__


class ManifestError(UsageError):
    """The manifest of a fleet can't be read, or says what can't be meant."""


class EngineError(ImucalError):
    """The workers of a fleet can't be reached, or are gone; what they have done is in the store."""

    exit_code = 5


class StoreError(ImucalError):
    """A file in the folder of a fleet is not as it was written; the message names it."""

    exit_code = 5
