"""Recording -> findings: checks of a recording that need no noise model."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

from imucal.findings import Finding
from imucal.parallel import side_by_side
from imucal.recording import AxisSeries, Recording
from imucal.screening.interleaved import check_interleaved
from imucal.screening.motion import check_motion, check_shaken, check_tremor, check_turned
from imucal.screening.values import (
    check_accelerometer_unit,
    check_duplicates,
    check_filled,
    check_gyroscope_unit,
    check_lsb,
    check_no_data,
    check_not_finite,
    check_rate,
    check_saturated,
    check_stuck,
    check_swapped,
    temperature_finding,
)
from imucal.screening.windows import Measured, Profile, amount, measured, profile
from imucal.side_work import findings_or_why_not, try_side_work

__all__ = ["amount", "screen_units", "screen_values", "worst_first"]

AxisCheck: TypeAlias = Callable[[Profile], tuple[Finding, ...]]
LogCheck: TypeAlias = Callable[[Sequence[Profile]], tuple[Finding, ...]]

#: Code of a check that failed to run.
_FAILED = "not-checked"
#: Checks over all axes with data.
_LOG_CHECKS: tuple[LogCheck, ...] = (
    check_rate,
    check_swapped,
    check_duplicates,
    check_accelerometer_unit,
    check_filled,
    check_interleaved,
)
#: Checks that the IMU was at rest, up to the first that finds motion.
_REST_CHECKS: tuple[LogCheck, ...] = (check_tremor, check_shaken, check_turned, check_motion)
#: Checks of one axis with data.
_AXIS_CHECKS: tuple[AxisCheck, ...] = (check_not_finite, check_stuck, check_saturated, check_lsb)


def screen_values(recording: Recording, *, workers: int = 1) -> tuple[Finding, ...]:
    """Return findings about a recording's values and about motion during it; worst first.

    The samples are read once, in blocks, up to `workers` axes at a time.
    """

    def tried(series: AxisSeries) -> tuple[Measured | None, tuple[Finding, ...]]:
        what = "The axis can't be screened"
        return try_side_work(partial(measured, series), None, what=what, code=_FAILED, axis=series.name)

    made_of = side_by_side(tried, recording.series, workers=workers)
    pairs = zip(recording.series, made_of, strict=True)
    profiles = [Profile.of(series, found) for series, (found, _) in pairs if found]
    empty = [finding for p in profiles for finding in check_no_data(p)]
    dead = {finding.axis for finding in empty}
    alive = [p for p in profiles if p.name not in dead and p.windows.size]
    findings = [finding for _, failed in made_of for finding in failed] + empty
    findings += temperature_finding(recording.temperature)
    return worst_first(recording, [*findings, *_checked(alive)])


def screen_units(recording: Recording) -> tuple[Finding, ...]:
    """Return findings if the accelerometer's samples are not its whole acceleration in m/s²."""
    return _judged(check_accelerometer_unit, [profile(series) for series in recording.series])


def _checked(alive: Sequence[Profile]) -> Iterator[Finding]:
    for log_check in _LOG_CHECKS:
        yield from _judged(log_check, alive)
    moved = _moved(alive)
    yield from moved
    if not any(finding.level == "error" for finding in moved):
        yield from _judged(check_gyroscope_unit, alive)
    for axis_check in _AXIS_CHECKS:
        for p in alive:
            yield from _judged(axis_check, p, axis=p.name)


def worst_first(recording: Recording, findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, errors first, without those already in `recording.findings`."""
    text = {(finding.code, finding.axis) for finding in recording.findings}
    order = ("error", "warning", "info")
    new = (finding for finding in findings if (finding.code, finding.axis) not in text)
    return tuple(sorted(new, key=lambda finding: order.index(finding.level)))


def _moved(alive: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return the findings of the first check that finds motion, and of failed checks before it."""
    moved: tuple[Finding, ...] = ()
    for check in _REST_CHECKS:
        moved += _judged(check, alive)
        if any(finding.code != _FAILED for finding in moved):
            break
    return moved


def _judged(
    check: Callable[..., tuple[Finding, ...]], *checked: object, axis: str | None = None
) -> tuple[Finding, ...]:
    what = f"No check for {check.__name__.removeprefix('check_').replace('_', ' ')}"
    return findings_or_why_not(partial(check, *checked), what=what, code=_FAILED, axis=axis)
