"""The errors that imucal raises on purpose, and the exit codes of the command line.

A message reads *where: what was found, what was expected, what to do*.
A caller's mistake (an argument out of range) is a `ValueError`; of what people type in notebooks, an
`ArgumentError`.
"""

from collections.abc import Sequence
from typing import ClassVar

#: Exit code -> its meaning, and what a script can do.
EXIT_CODES = {
    0: ("done", "continue"),
    1: ("a check failed, or a comparison found a difference", "stop: this is the result"),
    2: ("the command line, a limits file or an environment variable is wrong", "correct the call"),
    3: ("the log can't be read", "read the message: it lists what was found"),
    4: ("the data can't be analysed or are not noise at rest", "record again"),
    5: ("the output can't be written", "run it again: no file is incomplete"),
    70: ("a bug in imucal", "report it; IMUCAL_DEBUG=1 shows the place"),
    130: ("interrupted with Ctrl-C", "run it again: no file is incomplete"),
    141: ("the reader of standard output closed it", "nothing"),
}

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
