"""What only judges or draws a result: where it fails, the result stays and a finding says so.

Second opinions, screening and pictures are such work. That they can't judge some data, as a DataError
or a failed calculation says, is a finding. A fault of the program is one too, so that it costs nobody
hours of data; with IMUCAL_DEBUG set it is raised instead, where it happened.
"""

import os
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from imucal.errors import DataError
from imucal.findings import Finding

T = TypeVar("T")
U = TypeVar("U")

#: How calculations end on data that they were not made for.
_NUMERIC = (ArithmeticError, np.linalg.LinAlgError)


def try_side_work(
    make: Callable[[], T], otherwise: U, *, what: str, code: str, axis: str | None = None
) -> tuple[T | U, tuple[Finding, ...]]:
    """Return what `make` gives and no finding; or `otherwise` and the finding that it could not.

    Parameters
    ----------
    what
        The sentence's beginning, such as ``The Allan curve gives no second opinion``.
    code, axis
        Of the finding.
    """
    try:
        return make(), ()
    except DataError as error:
        why = str(error).removeprefix(f"{axis}: ")
    except _NUMERIC as error:
        why = f"the calculation failed ({_last_words(error)})"
    except Exception as error:
        if faults_are_raised():
            raise
        why = f"internal error ({_last_words(error)}); please report it, IMUCAL_DEBUG=1 shows where"
    return otherwise, (Finding(level="warning", code=code, axis=axis, text=f"{what}: {why}."),)


def findings_or_why_not(
    judge: Callable[[], tuple[Finding, ...]], *, what: str, code: str, axis: str | None = None
) -> tuple[Finding, ...]:
    """Return the findings of a judge, or the one that it could not judge."""
    found, failed = try_side_work(judge, (), what=what, code=code, axis=axis)
    return found + failed


def faults_are_raised() -> bool:
    """Whether faults of the program are raised: IMUCAL_DEBUG is set."""
    return bool(os.environ.get("IMUCAL_DEBUG"))


def _last_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(". ")
