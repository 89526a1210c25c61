"""Findings about the stamps of a clock, except gaps."""

import numpy as np

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.clocks.period import SAME, Period
from imucal.readers.clocks.placing import Breaks, Steps
from imucal.readers.clocks.wander import MAX_WANDER

#: Relative difference of tick and period up to which few ticks are empty or double.
_SAME_AS_A_TICK = 0.05
#: Jitter of stamps that are whole ticks, in periods.
_NO_JITTER = 1e-3
#: Share of regular ticks that is found, in standard deviations of the mean count of a tick: the sum of 32
#: lines exceeds the limit of `ticks` from 1.2 on.
_HIDDEN = 1.2
#: Advice if the rate is uncertain.
_GIVE = "Log the samples as the sensor delivers them, or give the sampling rate."


def stamp_notes(steps: Steps, n: int, breaks: Breaks, period: Period) -> list[Finding]:
    """Return findings about the stamps, except gaps, jumps and jitter."""
    notes: list[Finding] = []
    same, back, tau, doubled = steps.same, steps.back, period.tau_ns, breaks.doubled.size
    if tau / 50 < period.resolution_ns < 0.999 * tau or (period.resolution_ns >= tau and same):
        text = (
            f"The time stamps have a resolution of {period.resolution_ns / 1e6:.4g} ms at a sampling "
            f"period of {tau / 1e6:.4g} ms; the rate is measured over many samples."
        )
        notes.append(Finding("info", "coarse-stamps", text))
    if period.burst > 1:
        text = (
            f"Samples arrive in bursts of about {period.burst}; they are evenly spaced at {1e9 / tau:.6g} Hz."
        )
        notes.append(Finding("info", "bursts", text))
    elif same and not period.loose and (doubled or period.resolution_ns < tau / 50):
        fate = f"{doubled} surplus samples are dropped" if doubled else "all are kept"
        text = f"{same} of {n} samples repeat the previous time stamp; {fate}."
        notes.append(Finding("warning", "duplicate-stamps", text))
    elif doubled:
        text = f"{doubled} of {n} samples are surplus at this rate and are dropped."
        notes.append(Finding("warning", "extra-samples", text))
    if period.other_ns:
        text = (
            f"The time stamps fit two rates: {period.rate_hz:.6g} Hz, which is used, or "
            f"{1e9 / period.other_ns:.6g} Hz with {_kind(period)}. N is proportional to the square root of "
            "the rate."
        )
        advice = "Give the sampling rate if the other one is right."
        notes.append(Finding("warning", "two-readings", text, advice))
    if back:
        text = (
            f"{back} of {n} time stamps are earlier than the previous one; the samples keep the order of "
            "the log."
        )
        notes.append(Finding("info", "stamps-out-of-order", text))
    return notes


def _kind(period: Period) -> str:
    if period.other_ns > period.tau_ns:
        return f"no missing samples and a clock with ticks of {period.tau_ns / 1e6:.4g} ms"
    return f"{1 - period.other_ns / period.tau_ns:.2g} of the samples missing"


def jitter_notes(period: Period, jitter_ns: float, n: int) -> list[Finding]:
    """Return a finding if stamps are not the times of sampling."""
    tau, usual = period.tau_ns, period.usual_ns
    # With ticks of a coarse clock, the usual step is the next whole number of ticks.
    is_surplus = usual > max(1.02 * tau, tau + period.resolution_ns)
    text = ""
    if period.coherent:
        text = (
            f"The time stamps jitter by {period.jitter:.2g} sampling periods, and samples are missing. The "
            f"rate, {1e9 / tau:.6g} Hz, follows from the phases of the time stamps; the places of the gaps "
            "are uncertain."
        )
    elif jitter_ns > tau:
        text = (
            f"The time stamps differ from an even grid by {jitter_ns / tau:.3g} sampling periods (standard "
            f"deviation): the samples were stamped late. The rate, {1e9 / tau:.6g} Hz, is the mean, with a "
            f"relative error of about {2 * jitter_ns / (tau * n):.1g}; N is proportional to the square "
            "root of the rate."
        )
    elif period.wander > MAX_WANDER:
        text = (
            "The time stamps do not fit an even grid: the sampling was uneven, or samples are "
            f"missing. The rate, {1e9 / tau:.6g} Hz, is the mean of the samples in the log; N is "
            "proportional to the square root of the rate."
        )
    elif is_surplus and period.burst == 1 and not period.loose and not period.tick_ns:
        text = (
            f"Most steps are {usual / 1e6:.4g} ms, as at {1e9 / usual:.6g} Hz, but there are "
            f"{1e9 / tau:.6g} samples per second: some are between the others, as if interpolated at the "
            "times of a camera. The mean rate is used; with the rate of the steps, N would change by "
            f"{np.sqrt(usual / tau) - 1:+.1%}."
        )
    return [Finding("warning", "uneven-stamps", text, _GIVE)] if text else []


def tick_notes(period: Period, n: int, missing: int, *, same: int, doubled: int) -> list[Finding]:
    """Return a finding if samples are missing on a clock with ticks of a period, and the log is short.

    Of the `n` samples, `same` have the stamp of the previous one, and `doubled` are dropped. A period of
    almost a tick leaves ticks empty, or with two samples, regularly. Random losses hide a small share of
    these: their noise is higher than the lines of the share in the spectrum of the counts.
    """
    is_resolution = abs(period.resolution_ns / period.tau_ns - 1) < _SAME_AS_A_TICK
    # Ticks such as 1/1024 s are not a whole number of ns.
    are_whole = same > 0 and period.jitter < _NO_JITTER
    if not (is_resolution or are_whole) or period.tick_ns or not missing:
        return []
    lost = missing / (n + missing)
    hidden = _HIDDEN * np.sqrt(lost / (1 - lost) / (n + missing)) + doubled / n
    if hidden < SAME:
        return []
    text = (
        f"The resolution of the time stamps is about a sampling period, and {lost:.0%} of the samples are "
        f"missing. The rate, {period.rate_hz:.6g} Hz, may be wrong by up to {hidden:.1%}, because some ticks "
        "without a sample may be regular; N is proportional to the square root of the rate."
    )
    return [Finding("warning", "uneven-stamps", text, _GIVE)]


def jump_notes(stamps: IntArray, jumps: dict[int, int]) -> list[Finding]:
    """Return a finding if the clock was set."""
    if not jumps:
        return []
    step, at = max(
        ((int(stamps[at]) - int(stamps[at - 1]), at) for at in jumps), key=lambda jump: abs(jump[0])
    )
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    text = (
        f"The clock was set {times}, at most by {step / 1e9:+.6g} s at sample {at}; the samples before and "
        "after are not joined."
    )
    return [Finding("warning", "clock-jump", text)]


def rate_notes(measured: float, given: float | None) -> list[Finding]:
    """Return a finding if the given rate differs from the measured one, both in Hz."""
    if given is None or abs(measured / given - 1) <= 0.01:
        return []
    text = f"The given rate, {given:g} Hz, differs from the rate of the time stamps, {measured:.6g} Hz."
    return [Finding("warning", "rate-given", text)]
