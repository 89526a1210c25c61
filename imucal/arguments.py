"""Arguments of public functions: a missing, unknown or wrong one raises an `ArgumentError`."""

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeAlias, TypeVar

from imucal.errors import ArgumentError

__all__ = ["takes"]

P = ParamSpec("P")
T = TypeVar("T")
#: A class, several, or a list of one for a sequence of its values.
_Kind: TypeAlias = type | tuple[type, ...] | list[type]


def takes(example: str, **kinds: _Kind) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Check the arguments of a function before it is called.

    Parameters
    ----------
    example
        A correct call, such as ``imucal.allan_curve(recording["gyro_x"])``, for the message.
    kinds
        Name of an argument -> its types.

    Returns
    -------
    A decorator. The function raises an ArgumentError if an argument is missing, unknown or of another type.
    """
    called = example.partition("(")[0].removeprefix("imucal.")

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                given = signature.bind(*args, **kwargs).arguments
            except TypeError as error:
                raise ArgumentError(f"{called}: {error}; type {example}") from error
            for name, kind in kinds.items():
                if name in given and not _is(given[name], kind):
                    found = f"{name} is {_article(type(given[name]).__name__)}"
                    message = f"{called}: {found}, expected {_named(kind)}; type {example}"
                    raise ArgumentError(message)
            return function(*args, **kwargs)

        return checked

    return decorate


def _is(value: object, kind: _Kind) -> bool:
    if isinstance(kind, list):
        return isinstance(value, Sequence) and all(isinstance(each, kind[0]) for each in value)
    return isinstance(value, kind)


def _named(kind: _Kind) -> str:
    if isinstance(kind, list):
        return f"a list with {_article(kind[0].__name__)} for each"
    return " or ".join(_article(one.__name__) for one in (kind if isinstance(kind, tuple) else (kind,)))


def _article(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"
