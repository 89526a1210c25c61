"""`doctor.html`: verdict, table of all rows, and a picture of each row that failed or warned."""

import base64
from collections.abc import Callable, Mapping

from imucal.errors import Fix
from imucal.health.diagnosis import Diagnosis, Row, Status
from imucal.health.evidence import Evidence
from imucal.report.markup import render

__all__ = ["description_of", "render_page"]

#: Status -> the style of the verdict.
_STYLES: dict[Status, str] = {"pass": "good", "warn": "check", "fail": "not-noise", "unknown": "check"}
#: Status -> its name in the table.
_NAMES: dict[Status, str] = {"pass": "pass", "warn": "warn", "fail": "fail", "unknown": "?"}


def render_page(diagnosis: Diagnosis, pictures: Mapping[str, bytes], option_of: Callable[[Fix], str]) -> str:
    """Return the page.

    `pictures` are PNG files by the codes of their rows. `option_of` returns the option of the command line
    that follows a fix, or an empty text.
    """
    rows = [
        (row, _NAMES[row.status], option_of(row.fix) if row.fix is not None else "") for row in diagnosis.rows
    ]
    shown = [
        (row, f"data:image/png;base64,{base64.b64encode(pictures[row.code]).decode()}", description_of(row))
        for row in diagnosis.rows
        if row.code in pictures
    ]
    return str(
        render(
            "doctor.html",
            package="imucal.health",
            title=f"{diagnosis.source.name} – check of an IMU stream",
            heading=f"Check of {diagnosis.source.name}",
            grade=_STYLES[diagnosis.status],
            sentence=diagnosis.sentence,
            lead=" · ".join(filter(None, (diagnosis.source.format, *diagnosis.source.topics))),
            rows=rows,
            pictures=shown,
            version=diagnosis.version,
        )
    )


def description_of(row: Row) -> str:
    """Return the text of a picture for readers who can't see it."""
    evidence = row.evidence
    return "" if evidence is None else _description(evidence)


def _description(evidence: Evidence) -> str:
    parts = [f"{evidence.title[:1].upper()}{evidence.title[1:]}"]
    if evidence.marks:
        parts.append(f"marked: {', '.join(curve.label for curve in evidence.marks)}")
    if evidence.limits:
        parts.append(f"lines: {', '.join(limit.label for limit in evidence.limits)}")
    if evidence.shaded:
        parts.append(f"shaded: {evidence.shade_label}")
    return f"{'; '.join(parts)}."
