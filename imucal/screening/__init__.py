"""Recording -> findings: can it be trusted."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

from imucal.arrays import release
from imucal.findings import Finding
from imucal.processes import findings_or_why_not, side_by_side, try_side_work
from imucal.recording import AxisSeries, Recording
from imucal.screening.density import check_roll_off, check_tones
from imucal.screening.level import check_steps, check_temperature, check_warm_up
from imucal.screening.motion import check_motion, check_tremor, check_turned
from imucal.screening.values import (
    check_accelerometer_unit,
    check_duplicates,
    check_gyroscope_unit,
    check_lsb,
    check_no_data,
    check_not_finite,
    check_rate,
    check_repeats,
    check_saturated,
    check_stuck,
    check_swapped,
)
from imucal.screening.windows import Profile, profile

__all__ = ["AxisCheck", "LogCheck", "screen"]

AxisCheck: TypeAlias = Callable[[Profile], tuple[Finding, ...]]
LogCheck: TypeAlias = Callable[[Sequence[Profile]], tuple[Finding, ...]]

#: Code of the finding that a check could not judge.
_FAILED = "not-checked"
#: Checks over all axes that hold data.
_LOG_CHECKS: tuple[LogCheck, ...] = (
    check_rate,
    check_swapped,
    check_duplicates,
    check_accelerometer_unit,
    check_repeats,
)
#: Was the IMU at rest; the first that says no is enough.
_REST_CHECKS: tuple[LogCheck, ...] = (check_tremor, check_turned, check_motion)
#: Checks of one axis that holds data.
_AXIS_CHECKS: tuple[AxisCheck, ...] = (check_not_finite, check_stuck, check_saturated, check_lsb)
#: Checks of the noise of one axis, which mean something only at rest.
_NOISE_CHECKS: tuple[AxisCheck, ...] = (check_steps, check_warm_up, check_tones, check_roll_off)


def screen(recording: Recording, *, workers: int = 1) -> tuple[Finding, ...]:
    """Return what speaks against trusting a recording, worst first; empty for a good one.

    Codes: ``absurd-rate``, ``fast-rate``, ``no-data``, ``not-finite``, ``stuck``, ``saturated``,
    ``held-samples``, ``coarse-lsb``, ``swapped-sensors``, ``duplicate-axes``, ``unit-suspect``,
    ``no-gravity``, ``motion``, ``touch``, ``step``, ``warm-up``, ``temperature``, ``tone``, ``roll-off``.
    What reading the log has said already is not said again. The samples are passed once, in blocks;
    NaN and gaps are left out, and fewer than 16 samples in a row say nothing. So many axes as `workers`
    are passed at a time; the findings are the same for any number.
    """
    said = {(finding.code, finding.axis) for finding in recording.findings}
    every = _all_findings(recording, workers)
    findings = [finding for finding in every if (finding.code, finding.axis) not in said]
    order = ("error", "warning", "info")
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))


def _all_findings(recording: Recording, workers: int) -> Iterator[Finding]:
    """Yield what each check says, in the order of the tables; one that can't judge says that."""

    def made(series: AxisSeries) -> tuple[Profile | None, tuple[Finding, ...]]:
        what = "The axis can't be screened"
        judged = try_side_work(partial(profile, series), None, what=what, code=_FAILED, axis=series.name)
        release(series.samples)
        return judged

    profiles: list[Profile] = []
    for one, failed in side_by_side(made, recording.series, workers=workers):
        profiles += [one] if one else []
        yield from failed
    empty = [finding for p in profiles for finding in check_no_data(p)]
    dead = {finding.axis for finding in empty}
    alive = [p for p in profiles if p.name not in dead and p.windows.size]
    yield from empty
    for log_check in _LOG_CHECKS:
        yield from _judged(log_check, alive)
    moved = _moved(alive)
    yield from moved
    checks = _AXIS_CHECKS
    if not any(finding.level == "error" for finding in moved):
        checks += _NOISE_CHECKS
        yield from _judged(check_gyroscope_unit, alive)
        yield from _judged(check_temperature, alive, recording.temperature)
    for axis_check in checks:
        for p in alive:
            yield from _judged(axis_check, p, axis=p.name)


def _moved(alive: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return what the first check says that sees a motion, and which could not look."""
    moved: tuple[Finding, ...] = ()
    for check in _REST_CHECKS:
        moved += _judged(check, alive)
        if any(finding.code != _FAILED for finding in moved):
            break
    return moved


def _judged(
    check: Callable[..., tuple[Finding, ...]], *checked: object, axis: str | None = None
) -> tuple[Finding, ...]:
    """Return what a check finds, or that it could not look."""
    what = f"No check for {check.__name__.removeprefix('check_').replace('_', ' ')}"
    return findings_or_why_not(partial(check, *checked), what=what, code=_FAILED, axis=axis)
