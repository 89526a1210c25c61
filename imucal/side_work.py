"""Optional work that may fail: it only judges or draws a result, and a finding reports its failure."""

import os
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from imucal.errors import DataError
from imucal.findings import Finding

__all__ = ["faults_are_raised", "findings_or_why_not", "try_side_work"]

#: Errors of calculations.
_NUMERIC = (ArithmeticError, np.linalg.LinAlgError)

T = TypeVar("T")
R = TypeVar("R")


def try_side_work(
    make: Callable[[], T], otherwise: R, *, what: str, code: str, axis: str | None = None
) -> tuple[T | R, tuple[Finding, ...]]:
    """Return the result of `make` and no finding; or `otherwise` and a finding with the reason.

    A DataError and a failed calculation become a finding. So does a bug, so that it does not cost hours of
    data; with IMUCAL_DEBUG it is raised. The finding begins with `what`, such as ``The fit of the Allan curve
    failed``.
    """
    try:
        return make(), ()
    except DataError as error:
        why = str(error.below(axis) if axis else error)
    except _NUMERIC as error:
        why = f"the calculation failed ({_last_words(error)})"
    except Exception as error:
        if faults_are_raised():
            raise
        why = f"internal error ({_last_words(error)}); please report it, IMUCAL_DEBUG=1 shows where"
    return otherwise, (Finding("warning", code, f"{what}: {why}.", axis=axis),)


def findings_or_why_not(
    judge: Callable[[], tuple[Finding, ...]], *, what: str, code: str, axis: str | None = None
) -> tuple[Finding, ...]:
    """Return the findings of `judge`, or a finding with the reason why it failed."""
    found, failed = try_side_work(judge, (), what=what, code=code, axis=axis)
    return found + failed


def faults_are_raised() -> bool:
    """Return whether bugs are raised: IMUCAL_DEBUG is set."""
    return bool(os.environ.get("IMUCAL_DEBUG"))


def _last_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(". ")
