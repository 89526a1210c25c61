"""The expectation that an error of imucal is raised, by its fields."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

import pytest

from imucal.errors import ImucalError

__all__ = ["raises"]

Refusal = TypeVar("Refusal", bound=ImucalError)


@contextmanager
def raises(
    kind: type[Refusal],
    match: str | None = None,
    *,
    code: str | None = None,
    place: object = None,
    argument: str | None = None,
) -> Iterator[pytest.ExceptionInfo[Refusal]]:
    """Expect an error of a class, as `pytest.raises`, and compare its fields.

    `place` is the end of the error's place, such as the name of a file. `argument` is the argument of one
    of its fixes.
    """
    with pytest.raises(kind, match=match) as caught:
        yield caught
    error = caught.value
    if code is not None:
        assert error.code == code
    if place is not None:
        assert error.place.endswith(str(place)), f"place: {error.place}"
    if argument is not None:
        assert argument in [fix.argument for fix in error.fixes]
