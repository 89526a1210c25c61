"""The errors of imucal, and the exit codes of the command line.

A message states the place, the problem, the expected content, and the next step. An invalid argument raises a
`ValueError`; in the functions of `imucal` it raises an `ArgumentError`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Self

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


#: Code of an error that programs tell apart -> its meaning.
ERROR_CODES = {
    "not-noise": "the log is not noise at rest, so its numbers are not used",
    "uncertain": "N is uncertain by more than a factor of 10",
    "no-result": "no axis could be fitted",
    "only-times": "a file of a table contains times and no samples",
}


@dataclass(frozen=True)
class Fix:
    """One way to fix a problem.

    Attributes
    ----------
    text
        What to do, such as ``give the sampling rate``; empty if the problem's sentence already contains it.
    argument
        The argument of a function that does it, such as ``rate_hz``; empty if there is none.
    value
        The value of the argument, such as ``0.4s``, or a placeholder such as ``HZ``.
    """

    text: str = ""
    argument: str = ""
    value: str = ""


class ImucalError(Exception):
    """Base class of all errors that imucal raises on purpose.

    Parameters
    ----------
    problem
        What was found, and what was expected.
    place
        A path, a URL, a topic or an axis; empty if there is none.
    fix, fixes
        One way to fix the problem, or several of which one is enough.
    code
        A stable, lower-case name with hyphens for programs; empty for most errors.
    """

    exit_code: ClassVar[int] = 1
    #: Whether the results were printed nevertheless.
    printed = False

    def __init__(
        self,
        problem: str = "",
        *,
        place: object = "",
        fix: Fix | None = None,
        fixes: Iterable[Fix] = (),
        code: str = "",
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.place = str(place)
        self.fixes = (*fixes,) if fix is None else (fix, *fixes)
        self.code = code
        #: Further errors that must be fixed, too; their places are within `place`.
        self.also: tuple[ImucalError, ...] = ()

    def __str__(self) -> str:
        """Return ``place: problem; fix; also, the next problem; its fix``."""
        return _placed(self.place, self.sentence)

    @property
    def sentence(self) -> str:
        """The message without the place."""
        return "; also, ".join([self._own_sentence, *map(str, self.also)])

    @property
    def _own_sentence(self) -> str:
        """The problem and its fixes: ``problem; do this, or do that``."""
        texts = [fix.text for fix in self.fixes if fix.text]
        advice = ", ".join(texts[:-1]) + ", or " + texts[-1] if len(texts) > 1 else "".join(texts)
        # The last line of a longer problem is a row of a table.
        separator = "\n" if "\n" in self.problem else "; "
        return separator.join(filter(None, (self.problem, advice)))

    def at(self, place: object) -> Self:
        """Return the error at another place, such as the URL of a downloaded file."""
        return self._with(place=str(place))

    def within(self, outer: object) -> Self:
        """Return the error with an outer place before its place, unless it is there already."""
        inner = _below(self.place, str(outer))
        return self.at(_placed(str(outer), inner) if inner else outer)

    def below(self, outer: object) -> Self:
        """Return the error with its place relative to an outer place, for a reader who knows that one."""
        return self.at(_below(self.place, str(outer)))

    def with_fixes(self, *fixes: Fix) -> Self:
        """Return the error with further ways to fix it."""
        return self._with(fixes=(*self.fixes, *fixes))

    def _with(self, **fields: object) -> Self:
        """Return a copy with other fields."""
        # Not copy.copy: distributed registers another way to copy exceptions.
        other = type(self)(self.problem)
        vars(other).update(vars(self), **fields)
        return other

    def parts(self) -> "tuple[ImucalError, ...]":
        """Return this error alone, then those in `also`, with their full places."""
        return (
            self._with(also=()),
            *(error.within(self.place) if self.place else error for error in self.also),
        )


def _placed(place: str, text: str) -> str:
    return f"{place}: {text}" if place else text


def _below(place: str, outer: str) -> str:
    """Return the part of a place within an outer place."""
    return "" if place == outer else place.removeprefix(f"{outer}: ")


class ReadError(ImucalError):
    """The log can't be read."""

    exit_code = 3


class ChoiceError(ReadError):
    """The topic, sensor or columns are ambiguous; each fix is an argument that decides."""


def joined(place: object, errors: Iterable[ChoiceError]) -> ChoiceError:
    """Return one error at a place with the problems and fixes of all errors, each once."""
    parts = {(part.place, part._own_sentence): part for error in errors for part in error.parts()}  # noqa: SLF001
    first, *others = parts.values()
    inner = _below(first.place, str(place))
    error = ChoiceError(_placed(inner, first.problem), place=place, fixes=first.fixes, code=first.code)
    error.also = tuple(other.at(_below(other.place, str(place))) for other in others)
    return error


class DataError(ImucalError):
    """The log was read, but its data can't be analysed."""

    exit_code = 4


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


class ManifestError(UsageError):
    """The manifest of a fleet can't be read, or its content is invalid."""


class EngineError(ImucalError):
    """The workers of a fleet can't be reached or ended; their results are in the store."""

    exit_code = 5


class StoreError(ImucalError):
    """A file in the folder of a fleet is damaged; the message contains its name."""

    exit_code = 5
