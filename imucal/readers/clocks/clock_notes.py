"""What stamps look like, as findings."""

from dataclasses import replace

from imucal.arrays import IntArray, median
from imucal.clock import Clock
from imucal.findings import Finding
from imucal.mapped import blocks
from imucal.readers.clocks.placing import Breaks, Steps
from imucal.readers.clocks.rate import Period
from imucal.readers.room import equal
from imucal.recording import Recording

#: Share of missing samples up to which gaps are not worth a warning.
_FEW = 1e-3
#: Samples looked at, evenly spread.
_MOST = 100_000
#: Shortest log whose clocks are compared, in s, and difference worth a word, as a fraction.
_SHORTEST, _DRIFT = 60.0, 5e-4


def zero_note(zeros: int, n: int) -> Finding:
    """Return the finding of a few stamps that are zero."""
    text = f"{zeros} of {n} stamps are zero; those samples are placed between their neighbours."
    return Finding(level="info", code="zero-stamps", text=text)


def rate_note(given: float, measured: float) -> Finding:
    """Return the finding of a given rate, in Hz, that the stamps contradict."""
    text = f"The rate given, {given:g} Hz, is not the one the stamps show, {measured:.6g} Hz."
    return Finding(level="warning", code="rate-given", text=text)


def log_time_note(why: str) -> Finding:
    """Return the finding of stamps that can't be used, which `why` says."""
    text = f"{why}; the time at which messages were recorded is used instead."
    advice = "Log time carries the delays of the computer; let the driver stamp the messages."
    return Finding(level="warning", code="log-time-used", text=text, advice=advice)


def repeated_note(count: int, n: int) -> Finding:
    """Return the finding of messages recorded twice."""
    text = f"{count} of {n} samples repeat the stamp and the values of the one before; they are dropped."
    return Finding(level="warning", code="duplicate-stamps", text=text)


def stamp_notes(steps: Steps, n: int, breaks: Breaks, period: Period) -> list[Finding]:
    """Return what the stamps show apart from gaps and jumps."""
    notes = []
    same, back, tau = steps.same, steps.back, period.tau_ns
    if tau / 50 < period.resolution_ns < 0.999 * tau or (period.resolution_ns >= tau and same):
        text = (
            f"Stamps have a resolution of {period.resolution_ns / 1e6:.4g} ms at a sampling period of "
            f"{tau / 1e6:.4g} ms; the rate is measured over many samples."
        )
        notes.append(Finding(level="info", code="coarse-stamps", text=text))
    if period.burst > 1:
        text = (
            f"Samples arrive in bursts of about {period.burst}; they are taken as evenly spaced at "
            f"{1e9 / tau:.6g} Hz."
        )
        notes.append(Finding(level="info", code="bursts", text=text))
    elif same and (breaks.doubled.size or period.resolution_ns < tau / 50):
        fate = (
            f"{breaks.doubled.size} that are one too many are dropped"
            if breaks.doubled.size
            else "all are kept"
        )
        text = f"{same} of {n} samples carry the stamp of the one before; {fate}."
        notes.append(Finding(level="warning", code="duplicate-stamps", text=text))
    elif breaks.doubled.size:
        text = f"{breaks.doubled.size} of {n} samples are one too many for the clock and are dropped."
        notes.append(Finding(level="warning", code="extra-samples", text=text))
    if back:
        text = f"{back} of {n} stamps are earlier than the one before; samples keep the log's order."
        notes.append(Finding(level="info", code="stamps-out-of-order", text=text))
    return notes


def jump_notes(stamps: IntArray, jumps: dict[int, int]) -> list[Finding]:
    """Return a finding for the settings of the clock, with the largest."""
    if not jumps:
        return []
    steps = {at: (int(stamps[at]) - int(stamps[at - 1])) / 1e9 for at in jumps}
    largest = max(steps, key=lambda at: abs(steps[at]))
    text = (
        f"The clock was set {_times(len(jumps))}, at most by {steps[largest]:+.6g} s "
        f"at sample {largest}; samples before and after are kept apart."
    )
    return [Finding(level="warning", code="clock-jump", text=text)]


def gap_notes(clock: Clock) -> list[Finding]:
    """Return a finding for the missing samples, with the longest gap."""
    gaps = clock.gaps
    if not gaps:
        return []
    longest = max(gaps, key=lambda gap: gap.missing)
    share = clock.missing / clock.grid_size
    text = (
        f"{_samples(clock.missing, share)} missing in {_gaps(len(gaps))}; "
        f"the longest is {longest.duration_s:.4g} s at {longest.start_s:.6g} s."
    )
    return [Finding(level="warning" if share > _FEW else "info", code="gaps", text=text)]


def compare_clocks(stamps: IntArray, log: IntArray) -> list[Finding]:
    """Compare header stamps with log time: the delay, and whether the clocks agree on a second."""
    if stamps.size < 2 or equal(stamps, log) or not any(log[part].any() for part in blocks(log.size, log)):
        return []
    step = max(stamps.size // _MOST, 1)
    some, recorded = stamps[::step], log[::step]
    delay = (recorded - some) / 1e9
    usual, most = median(delay), float(delay.max())
    text = f"Messages were recorded {usual * 1e3:.4g} ms after their stamps, at most {most * 1e3:.4g} ms."
    if abs(usual) > 86_400:
        text = f"Stamps and log time count from different times: {usual:.6g} s apart."
    findings = [Finding(level="info", code="delay", text=text)]
    own, other = (int(some[-1]) - int(some[0])) / 1e9, (int(recorded[-1]) - int(recorded[0])) / 1e9
    if min(own, other) > _SHORTEST and abs(own / other - 1) > _DRIFT:
        ratio = f"{own / other - 1:+.2%}"
        text = f"The stamps span {own:.6g} s, the log time {other:.6g} s: the clocks differ by {ratio}."
        findings.append(Finding(level="warning", code="clocks-differ", text=text))
    return findings


def _samples(count: int, share: float) -> str:
    """Return ``12 samples (0.003 of all) are``."""
    return f"{count} sample{'' if count == 1 else 's'} ({share:.2g} of all) {'is' if count == 1 else 'are'}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _gaps(count: int) -> str:
    return "one gap" if count == 1 else f"{count} gaps"


def part_between(recording: Recording, start_s: float, end_s: float) -> Recording:
    """Return a part of a log with the finding of its own gaps, not of those that were left out.

    Raises
    ------
    DataError
        As `Recording.between`.
    """
    part = recording.between(start_s, end_s)
    clocks = {id(series.clock): series.clock for series in part.series}
    gaps = [note for clock in clocks.values() for note in gap_notes(clock)]
    others = [finding for finding in part.findings if finding.code != "gaps"]
    return replace(part, findings=tuple(dict.fromkeys([*others, *gaps])))
