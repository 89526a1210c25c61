"""What `imucal.doctor` returns: one row per question about a stream, and the verdict."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from imucal.errors import Fix
from imucal.findings import Finding
from imucal.health.evidence import Evidence
from imucal.recording import Source

__all__ = ["WORST_FIRST", "Diagnosis", "Question", "Row", "Status", "Values"]

#: unknown: this log cannot tell.
Status: TypeAlias = Literal["pass", "warn", "fail", "unknown"]
#: Numbers and names of a row, for scripts.
Values: TypeAlias = dict[str, float | str | None]
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
        What was found, as one sentence with numbers.
    advice
        What to do, as one sentence; for ``unknown``, how to record a log that tells. Empty if nothing.
    fix
        The argument of `imucal.read`, and its value, that follows the advice.
    values
        The numbers of the sentence by name, in SI, for scripts.
    evidence
        What a picture of the row shows; None if the row passed or is unknown, or if nothing can be drawn.
    """

    name: str
    code: str
    status: Status
    found: str
    advice: str = ""
    fix: Fix | None = None
    values: Values = field(default_factory=dict)
    evidence: Evidence | None = field(default=None, compare=False, repr=False)

    @property
    def text(self) -> str:
        """What was found, and what to do."""
        return f"{self.found} {self.advice}".rstrip()


@dataclass(frozen=True)
class Question:
    """A question about every stream: the name and the code of its row."""

    name: str
    code: str

    def answer(
        self,
        status: Status,
        found: str,
        advice: str = "",
        *,
        fix: Fix | None = None,
        values: Values | None = None,
        evidence: Evidence | None = None,
    ) -> Row:
        """Return the row; `found` is without its full stop."""
        return Row(
            name=self.name,
            code=self.code,
            status=status,
            found=f"{found}.",
            advice=advice,
            fix=fix,
            values=values or {},
            evidence=evidence,
        )

    def answer_by(
        self,
        finding: Finding,
        status: Status,
        values: Values | None = None,
        evidence: Evidence | None = None,
    ) -> Row:
        """Return the row of a finding of `imucal.fit`, with its words."""
        return Row(
            name=self.name,
            code=self.code,
            status=status,
            found=finding.text,
            advice=finding.advice,
            fix=finding.fix,
            values={**(values or {}), "axis": finding.axis, "finding": finding.code},
            evidence=evidence,
        )


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
        fails, warns, unknowns, _ = ([r.name for r in self.rows if r.status == s] for s in WORST_FIRST)
        match self.status:
            case "fail":
                return f"Not fit for a filter: {', '.join(fails)}"
            case "warn":
                return f"Check first: {', '.join(warns)}"
            case "pass":
                return f"Fit for a filter, as far as this log tells{_open(len(unknowns), len(self.rows))}"
        return "This log answers no question"

    def __repr__(self) -> str:
        bad = [f"{row.status} {row.name}: {row.found}" for row in self.rows if row.status in {"fail", "warn"}]
        return "\n".join([f"{self.source.name}: {self.sentence}", *bad])


def _open(unknown: int, questions: int) -> str:
    return f"; it leaves {unknown} of {questions} questions open" if unknown else ""
