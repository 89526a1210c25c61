"""What `imucal.doctor` returns: one row per question about a stream, and the verdict."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from imucal.errors import Fix
from imucal.recording import Source

__all__ = ["WORST_FIRST", "Diagnosis", "Row", "Status"]

#: unknown: this log cannot tell.
Status: TypeAlias = Literal["pass", "warn", "fail", "unknown"]
WORST_FIRST: tuple[Status, ...] = ("fail", "warn", "unknown", "pass")


@dataclass(frozen=True, kw_only=True)
class Row:
    """The answer to one question about a stream.

    Attributes
    ----------
    name
        The question in a few words, such as ``axes and signs``.
    code
        A name for scripts that does not change, such as ``axes``; that of the finding of `imucal.fit`, if
        there is one.
    status
        The answer.
    found
        What was found, as one sentence without a full stop, with numbers.
    advice
        What to do; for ``unknown``, how to record a log that tells. Empty if nothing.
    fix
        The argument of `imucal.read`, and its value, that follows the advice.
    values
        The numbers of the sentence by name, in SI, for scripts.
    """

    name: str
    code: str
    status: Status
    found: str
    advice: str = ""
    fix: Fix | None = None
    values: Mapping[str, float | str | None] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Is a stream fit for a filter? One row per question, in the order of the checks."""

    source: Source
    rows: tuple[Row, ...]
    version: str

    @property
    def status(self) -> Status:
        """The worst status; ``unknown`` does not count, because no log can tell everything."""
        found = {row.status for row in self.rows} - {"unknown"}
        return next((status for status in WORST_FIRST if status in found), "unknown")

    @property
    def sentence(self) -> str:
        """The verdict, such as ``Not fit for a filter: axes and signs, clipping``."""
        named = [", ".join(row.name for row in self.rows if row.status == status) for status in WORST_FIRST]
        fails, warns, _, _ = named
        match self.status:
            case "fail":
                return f"Not fit for a filter: {fails}"
            case "warn":
                return f"Look first: {warns}"
            case "pass":
                return "Fit for a filter, as far as this log tells"
        return "This log tells nothing"

    def __repr__(self) -> str:
        bad = [f"{row.status} {row.name}: {row.found}" for row in self.rows if row.status in {"fail", "warn"}]
        return "\n".join([f"{self.source.name}: {self.sentence}", *bad])
