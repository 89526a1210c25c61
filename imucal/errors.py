"""The errors of imucal, and the exit codes of the command line.

A message states the place, the problem, the expected content, and the next step. An invalid argument raises a
`ValueError`; in the functions of `imucal` it raises an `ArgumentError`.
"""

from collections.abc import Sequence
from typing import ClassVar

#: Exit code -> its meaning, and the reaction of a script.
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

#: Separator of the requests in a message.
ALSO = "; also, "


class ImucalError(Exception):
    """Base class of all errors that imucal raises on purpose."""

    exit_code: ClassVar[int] = 1
    #: Whether the results were printed nevertheless.
    printed = False


class ReadError(ImucalError):
    """The log can't be read."""

    exit_code = 3


class ChoiceError(ReadError):
    """The topic, sensor or columns are ambiguous; the message lists the candidates."""


def as_one(where: str, lacking: Sequence[ChoiceError]) -> ChoiceError:
    """Join errors whose messages begin with `where` into one with all requests."""
    texts = dict.fromkeys(str(error).removeprefix(f"{where}: ") for error in lacking)
    return lacking[0] if len(texts) == 1 else ChoiceError(f"{where}: {ALSO.join(texts)}")


class DataError(ImucalError):
    """The log was read, but its data can't be analysed.

    `remedy` is an argument that helps, such as ``("rest_at_least", "0.4s")`` or ``("in_hand",)``; empty if
    there is none.
    """

    exit_code = 4

    def __init__(self, *texts: object, remedy: tuple[str, ...] = ()) -> None:
        super().__init__(*texts)
        self.remedy = remedy


class WriteError(ImucalError):
    """An output file can't be written."""

    exit_code = 5


class UsageError(ImucalError):
    """The request makes no sense."""

    exit_code = 2


class LimitsError(UsageError):
    """The limits file or the config file of a check can't be read or used."""


class SettingError(UsageError):
    """An environment variable of imucal has an invalid value."""


class ArgumentError(UsageError, ValueError):
    """An argument is invalid; the message lists valid values."""


class MissingError(UsageError, KeyError):
    """There is no axis or term of this name; the message lists the existing ones."""

    # A KeyError would put quotes around its message.
    __str__ = Exception.__str__


class ManifestError(UsageError):
    """The manifest of a fleet can't be read, or its content is invalid."""


class EngineError(ImucalError):
    """The workers of a fleet can't be reached or ended; their results are in the store."""

    exit_code = 5


class StoreError(ImucalError):
    """A file in the folder of a fleet is damaged; the message contains its name."""

    exit_code = 5
