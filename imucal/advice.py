"""Advice for a log that was disturbed: the part to keep, its rests, or another recording.

Each check proposes the part without its kind of disturbance. Their intersection is screened again.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.grading import DISTURBED, is_motion
from imucal.recording import Recording
from imucal.report.result import Report
from imucal.rests import at_rest
from imucal.screening import screen_values

__all__ = ["advised", "advised_report"]

#: A part is proposed if it is longer than this, in s, or than half of the log.
_LONG_S = 30.0
#: Distance from a jump, in s: its time is an estimate.
_CLEAR_S = {"step": 1.0}
#: Codes of a drift that dies away.
_WARM_UPS = frozenset({"warm-up", "warm-up-fitted"})
#: Maximum number of screenings, each without the disturbances found before.
_TRIES = 4
_Part = tuple[float, float]


def advised_report(report: Report, recording: Recording) -> Report:
    """Return the report of a recording with one piece of advice in all its findings."""
    own = iter(advised(recording, report.all_findings))
    log = tuple(next(own) for _ in report.findings)
    axes = tuple(replace(axis, findings=tuple(next(own) for _ in axis.findings)) for axis in report.axes)
    return replace(report, findings=log, axes=axes)


def advised(recording: Recording, findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Replace the parts worth keeping in findings by one part, which is free of all disturbances.

    Parameters
    ----------
    recording
        The screened and fitted recording.
    findings
        Findings of the log and its axes; `keep_s` counts from the first sample of the recording.

    Returns
    -------
    tuple of Finding
        In the same order. `keep_s` counts from the start of the log, rounded inwards to 0.1 s; it is None if
        no part is long enough, or the rests of a drive were fitted. If no part is left of a log that was
        moved, but it has several rests, the advice names ``--rests``.
    """
    found = tuple(findings)
    part, rests = (None, False) if any(f.code == "rests" for f in found) else _choice(recording, found)
    start = recording.source.read.from_s if recording.source.read else 0.0
    kept = part and _rounded(start + part[0], start + part[1])
    return tuple(_with(finding, kept, rests=rests) for finding in found)


def _choice(recording: Recording, findings: Sequence[Finding]) -> tuple[_Part | None, bool]:
    """Return the part to keep, in s from the first sample, and whether to fit the rests instead."""
    moved = any(is_motion(finding) for finding in findings)
    # A motion at the start looks like a warm-up to the fit of an axis.
    proposals = [finding for finding in findings if not (moved and finding.code in _WARM_UPS)]
    part = _common_part(recording, proposals)
    short = part is None or part[1] - part[0] < _duration_s(recording) / 2
    return (None, True) if moved and short and _has_rests(recording) else (part, False)


def _duration_s(recording: Recording) -> float:
    return max((series.duration_s for series in recording.series), default=0.0)


def _with(finding: Finding, kept: _Part | None, *, rests: bool) -> Finding:
    if rests and is_motion(finding):
        advice = f"{finding.advice} Fit its rests together with --rests.".lstrip()
        finding = replace(finding, advice=advice, fix=Fix("", "rests"))
    return replace(finding, keep_s=kept if finding.keep_s else None)


def _common_part(recording: Recording, findings: Sequence[Finding]) -> _Part | None:
    """Return the intersection of all proposals after a check; None if short."""
    duration = _duration_s(recording)
    part = _within((0.0, duration), findings, duration)
    if part == (0.0, duration):
        return None
    for _ in range(_TRIES):
        if part[1] - part[0] < min(_LONG_S, duration / 2):
            return None
        again = screen_values(recording.between(*part))
        wrong = [finding for finding in again if finding.code in DISTURBED or finding.keep_s]
        if not wrong:
            return part
        if any(finding.keep_s is None for finding in wrong):
            return None
        start, end = _within((0.0, part[1] - part[0]), wrong, part[1] - part[0])
        part = part[0] + start, part[0] + end
    return None


def _within(part: _Part, findings: Sequence[Finding], duration: float) -> _Part:
    """Apply the proposals of some findings to a part."""
    start, end = part
    for finding in findings:
        if finding.keep_s is None:
            continue
        clear, (first, last) = _CLEAR_S.get(finding.code, 0.0), finding.keep_s
        # The ends of the recording are no jumps.
        start = max(start, first + clear if first > 0 else first)
        end = min(end, last - clear if last < duration - clear else last)
    return start, max(start, end)


def _has_rests(recording: Recording) -> bool:
    try:
        rests = at_rest(recording)
    except DataError:
        return False
    return not any(finding.level == "error" for finding in screen_values(rests))


def _rounded(start: float, end: float) -> _Part:
    # The last bits must not move a multiple of 0.1 s.
    return math.ceil(start * 10 - 1e-6) / 10, math.floor(end * 10 + 1e-6) / 10
