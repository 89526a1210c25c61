"""Recording -> findings: can it be trusted."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

from imucal.findings import Finding
from imucal.recording import Recording
from imucal.screening.axes import check_duplicates, check_swapped
from imucal.screening.motion import check_motion, check_turned
from imucal.screening.profile import Profile, profile
from imucal.screening.quantisation import check_lsb
from imucal.screening.rolloff import check_roll_off
from imucal.screening.steps import check_steps
from imucal.screening.stuck import (
    check_no_data,
    check_not_finite,
    check_repeats,
    check_saturated,
    check_stuck,
)
from imucal.screening.temperature import check_temperature
from imucal.screening.tones import check_tones
from imucal.screening.tremor import check_tremor
from imucal.screening.unit_check import check_accelerometer_unit, check_gyroscope_unit
from imucal.screening.warmup import check_warm_up

__all__ = ["screen"]

AxisCheck: TypeAlias = Callable[[Profile], tuple[Finding, ...]]
LogCheck: TypeAlias = Callable[[Sequence[Profile]], tuple[Finding, ...]]

#: Checks over all axes that hold data.
_LOG_CHECKS: tuple[LogCheck, ...] = (
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


def screen(recording: Recording) -> tuple[Finding, ...]:
    """Return what speaks against trusting a recording, worst first; empty for a good one.

    Codes: ``no-data``, ``not-finite``, ``stuck``, ``saturated``, ``held-samples``, ``coarse-lsb``,
    ``swapped-sensors``, ``duplicate-axes``, ``unit-suspect``, ``no-gravity``, ``motion``,
    ``touch``, ``step``, ``warm-up``, ``temperature``, ``tone``, ``roll-off``.
    What reading the log has said already is not said again. The samples are passed once, in blocks;
    NaN and gaps are left out, and fewer than 16 samples in a row say nothing.
    """
    profiles = [profile(series) for series in recording.series]
    findings = [finding for p in profiles for finding in check_no_data(p)]
    dead = {finding.axis for finding in findings}
    alive = [p for p in profiles if p.name not in dead and p.windows.size]
    findings += [finding for check in _LOG_CHECKS for finding in check(alive)]
    rest = next((found for check in _REST_CHECKS if (found := check(alive))), ())
    findings += rest
    checks = _AXIS_CHECKS
    if not any(finding.level == "error" for finding in rest):
        checks += _NOISE_CHECKS
        findings += check_gyroscope_unit(alive)
        findings += check_temperature(alive, recording.temperature)
    findings += [finding for check in checks for p in alive for finding in check(p)]
    said = {(finding.code, finding.axis) for finding in recording.findings}
    findings = [finding for finding in findings if (finding.code, finding.axis) not in said]
    order = ("error", "warning", "info")
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))
