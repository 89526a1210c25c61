"""Rows about the time stamps, from the findings of the reader."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucal.clock import Clock
from imucal.findings import Finding, Level
from imucal.health.diagnosis import Question, Row, Status, Values
from imucal.health.evidence import Curve, Evidence, Limit, thinned
from imucal.recording import Recording, StampTrace
from imucal.screening.values import check_rate
from imucal.screening.windows import Profile

__all__ = ["clock_rows"]

#: Codes of findings about the sampling rate.
_RATE = (
    "absurd-rate",
    "fast-rate",
    "rate-changes",
    "rate-given",
    "rate-differs",
    "two-readings",
    "uneven-stamps",
)
#: Codes of findings about time stamps.
_STAMPS = (
    "clock-jump",
    "duplicate-stamps",
    "extra-samples",
    "stamps-out-of-order",
    "zero-stamps",
    "log-time-used",
    "time-unused",
    "bursts",
    "coarse-stamps",
)
#: Codes of findings about header stamps and log time.
_CLOCKS = ("clocks-differ", "delay")
#: Findings that are errors for a filter, because it integrates over the time between stamps.
_FAILS = {"clock-jump", "absurd-rate", "stamps-out-of-order"}
#: Findings that a filter notices, if a noise fit does not.
_WARNS = {"bursts", "coarse-stamps", "zero-stamps"}
#: What to do about findings for which a noise fit needs no advice.
_ADVICE = {
    "clock-jump": "Stamp the samples with a clock that is never set, such as a monotonic one.",
    "stamps-out-of-order": "Sort the samples by time for the filter, and look for two writers of one topic.",
    "duplicate-stamps": "Log each sample once, with a time of its own.",
    "extra-samples": "Look for a second source of samples in this topic or column.",
    "zero-stamps": "Fill the time stamp of each sample in the driver.",
    "bursts": "Give the filter the times of sampling, not those of arrival.",
    "coarse-stamps": "Log time stamps with a resolution of 1 us.",
    "clocks-differ": "Synchronize the clocks, or give the filter only one of the two times.",
}
#: Share of missing samples above which a filter drifts visibly between samples.
_MANY_MISSING = 0.01
#: Longest gap that a filter bridges, in s: at 3 rad/s the IMU turns by 17° in it.
_LONG_GAP_S = 0.1
#: Number of gaps that are marked in a picture.
_GAPS_SHOWN = 100
#: Standard deviation of the stamps, in sampling periods, below which they are even.
_EVEN = 0.005
#: Standard deviation of the stamps, in sampling periods, above which they are no times of sampling.
_JITTER = 0.2

#: Statuses with a picture.
_SHOWN: tuple[Status, ...] = ("fail", "warn")
_STATUS: dict[Level, Status] = {"error": "fail", "warning": "warn", "info": "pass"}


def clock_rows(recording: Recording, profiles: Sequence[Profile]) -> tuple[Row, ...]:
    """Return the rows of rate, gaps, stamps, and header against log time."""
    findings = (*recording.findings, *check_rate(profiles))
    return (
        _rate_row(recording, findings),
        _gaps_row(recording),
        _stamps_row(recording, findings),
        _clocks_row(recording, findings),
    )


def _worst(findings: Sequence[Finding], codes: Sequence[str]) -> tuple[Finding | None, Status]:
    """Return the worst of the findings with some codes, and its status."""
    order: tuple[Status, ...] = ("fail", "warn", "pass")
    judged = [(order.index(_status(finding)), finding) for finding in findings if finding.code in codes]
    if not judged:
        return None, "pass"
    place, worst = min(judged, key=lambda pair: pair[0])
    return worst, order[place]


def _status(finding: Finding) -> Status:
    if finding.code in _FAILS:
        return "fail"
    if finding.code in _WARNS:
        return "warn"
    return _STATUS[finding.level]


def _answer(question: Question, finding: Finding, status: Status, evidence: Evidence | None) -> Row:
    """Return the row of a finding; most findings about clocks have no advice, because a fit needs none."""
    row = question.answer_by(finding, status, evidence=evidence)
    return replace(row, advice=row.advice or _ADVICE.get(finding.code, ""))


def _rate_row(recording: Recording, findings: Sequence[Finding]) -> Row:
    question = Question("rate", "rate")
    worst, status = _worst(findings, _RATE)
    if worst is not None:
        evidence = _intervals(recording.stamps) if status in _SHOWN else None
        return _answer(question, worst, status, evidence)
    clocks = {id(series.clock): series for series in recording.series}
    rates = list(dict.fromkeys(f"{series.rate_hz:.6g} Hz" for series in clocks.values()))
    jitters = [s.clock.jitter_s * s.rate_hz for s in clocks.values() if s.clock.jitter_s is not None]
    fastest = max((series.rate_hz for series in clocks.values()), default=None)
    values: Values = {"rate_hz": fastest, "jitter_periods": max(jitters, default=None)}
    found = f"the sampling rate is {' and '.join(rates)}"
    if not jitters:
        return question.answer("pass", f"{found}; the log has no time stamps", values=values)
    if max(jitters) < _EVEN:
        return question.answer("pass", f"{found}, and the stamps are on an even grid", values=values)
    found += f", and the stamps differ by {max(jitters):.2g} periods from an even grid (standard deviation)"
    if max(jitters) > _JITTER:
        advice = "Stamp samples by the sensor's interrupt, or give the filter an even grid of time."
        evidence = _intervals(recording.stamps)
        return question.answer("warn", found, advice, values=values, evidence=evidence)
    return question.answer("pass", found, values=values)


def _gaps_row(recording: Recording) -> Row:
    question = Question("gaps", "gaps")
    clocks = list({id(series.clock): series.clock for series in recording.series}.values())
    missing = max((clock.missing / clock.grid_size for clock in clocks if clock.grid_size), default=0.0)
    longest = max((gap.duration_s for clock in clocks for gap in clock.gaps), default=0.0)
    values: Values = {"missing_share": missing, "longest_s": longest}
    if not longest:
        return question.answer("pass", "no sample is missing", values=values)
    found = f"{missing:.2%} of all samples are missing, and the longest gap is {longest:.4g} s"
    advice = "Look for lost messages: a full queue, a slow card, or a driver that polls too late."
    status: Status = "warn"
    if longest > _LONG_GAP_S or missing > _MANY_MISSING:
        status = "fail"
    worst = max(clocks, key=lambda clock: max((gap.missing for gap in clock.gaps), default=0))
    return question.answer(status, found, advice, values=values, evidence=_gaps(worst))


def _gaps(clock: Clock) -> Evidence:
    """Return the time between samples, with the longest gaps marked."""
    places = np.asarray(clock.grid() * clock.tau0, dtype=np.float64)
    x, y = thinned(places[1:], 1e3 * np.diff(places))
    longest = sorted(clock.gaps, key=lambda gap: -gap.missing)[:_GAPS_SHOWN]
    ends = np.array([gap.start_s + gap.duration_s for gap in longest])
    lengths = np.array([gap.duration_s + clock.tau0 for gap in longest])
    return Evidence(
        title="time between samples",
        x_label="time (s)",
        y_label="time since the previous sample (ms)",
        curves=(
            Curve(label="samples", x=x, y=y),
            Curve(label="after a gap", x=ends, y=1e3 * lengths, look="marks"),
        ),
        limits=(Limit(label=f"{1e3 * clock.tau0:.4g} ms", value=1e3 * clock.tau0),),
        log_y=True,
    )


def _stamps_row(recording: Recording, findings: Sequence[Finding]) -> Row:
    question = Question("time stamps", "stamps")
    worst, status = _worst(findings, _STAMPS)
    if worst is not None:
        evidence = _intervals(recording.stamps) if status in _SHOWN else None
        return _answer(question, worst, status, evidence)
    if all(series.clock.start_ns is None for series in recording.series):
        found = "the log has no time stamps"
        advice = "Log the time of each sample."
        return question.answer("unknown", found, advice)
    found = "the time stamps increase, and none repeats"
    return question.answer("pass", found)


def _intervals(traces: Sequence[StampTrace]) -> Evidence | None:
    """Return the time between stamps, with those marked that do not increase."""
    known = [trace for trace in traces if trace.index.size]
    if not known:
        return None
    worst = max(known, key=lambda trace: float(np.ptp(trace.interval_s)))
    x, y = worst.index.astype(np.float64), 1e3 * worst.interval_s
    curves = [Curve(label="stamps", x=x, y=y)]
    late = y <= 0
    if late.any():
        curves.append(Curve(label="equal or earlier", x=x[late], y=y[late], look="marks"))
    usual = float(np.median(y))
    return Evidence(
        title="time between the stamps of successive samples: the extremes of each part of the log",
        x_label="sample",
        y_label="time since the previous stamp (ms)",
        curves=tuple(curves),
        limits=(Limit(label=f"median {usual:.4g} ms", value=usual),),
    )


def _differences(traces: Sequence[StampTrace]) -> Evidence | None:
    """Return log time minus stamp."""
    known = [trace for trace in traces if trace.compared.size]
    if not known:
        return None
    worst = max(known, key=lambda trace: float(np.ptp(trace.late_s)))
    x, y = worst.compared.astype(np.float64), 1e3 * worst.late_s
    return Evidence(
        title="log time minus time stamp: the extremes of each part of the log",
        x_label="sample",
        y_label="log time minus stamp (ms)",
        curves=(Curve(label="difference", x=x, y=y),),
    )


def _clocks_row(recording: Recording, findings: Sequence[Finding]) -> Row:
    question = Question("header against log time", "clocks-differ")
    worst, status = _worst(findings, _CLOCKS)
    if worst is not None:
        evidence = _differences(recording.stamps) if status in _SHOWN else None
        return _answer(question, worst, status, evidence)
    found = "the log has one time for each sample, or two equal ones"
    advice = "Record a bag or MCAP file with header stamps."
    return question.answer("unknown", found, advice)
