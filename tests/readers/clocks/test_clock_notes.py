"""Findings about stamps: their thresholds, texts and numbers."""

import numpy as np
import pytest

from imucal.arrays import IntArray
from imucal.clock import Clock, Segment
from imucal.readers.clocks import compare_clocks
from imucal.readers.clocks.notes import jump_notes, stamp_notes
from imucal.readers.clocks.period import Period
from imucal.readers.clocks.placing import Breaks, Steps
from imucal.recording import gap_findings

NONE = np.zeros(0, dtype=np.int64)
TAU = 5_000_000
#: Stamps of a log of 100 s at 200 Hz.
STAMPS = np.arange(20_001, dtype=np.int64) * TAU


def noted(
    *, same: int = 0, back: int = 0, doubled: int = 0, burst: int = 1, resolution: int = 1
) -> list[tuple[str, str, str]]:
    steps = Steps(same=same, back=back, resets=NONE, even=False)
    breaks = Breaks(at=NONE, missing=NONE, doubled=np.arange(doubled))
    period = Period(tau_ns=float(TAU), jitter=0.0, burst=burst, resolution_ns=resolution)
    return [(note.level, note.code, note.text) for note in stamp_notes(steps, 1000, breaks, period)]


@pytest.mark.parametrize(
    ("resolution", "same", "coarse"),
    [
        (TAU // 50, 0, False),
        (TAU // 50 + 1, 0, True),
        (4_994_999, 0, True),
        (4_995_000, 0, False),
        (TAU - 1, 3, False),
        (TAU, 0, False),
        (TAU, 3, True),
        (2 * TAU, 3, True),
    ],
)
def test_steps_above_two_percent_of_the_period_are_coarse(resolution: int, same: int, coarse: bool) -> None:  # noqa: FBT001 - of the case
    """Steps that all equal the period are not coarse."""
    assert ("coarse-stamps" in [code for _, code, _ in noted(resolution=resolution, same=same)]) == coarse


_COARSE = (
    "The time stamps have a resolution of 1 ms at a sampling period of 5 ms; the rate is measured over "
    "many samples."
)


@pytest.mark.parametrize(
    ("given", "level", "code", "text"),
    [
        ({"resolution": 1_000_000}, "info", "coarse-stamps", _COARSE),
        (
            {"burst": 2, "same": 3, "doubled": 4},
            "info",
            "bursts",
            "Samples arrive in bursts of about 2; they are evenly spaced at 200 Hz.",
        ),
        (
            {"same": 3},
            "warning",
            "duplicate-stamps",
            "3 of 1000 samples repeat the previous time stamp; all are kept.",
        ),
        (
            {"same": 3, "doubled": 2, "resolution": TAU // 50},
            "warning",
            "duplicate-stamps",
            "3 of 1000 samples repeat the previous time stamp; 2 surplus samples are dropped.",
        ),
        (
            {"doubled": 1},
            "warning",
            "extra-samples",
            "1 of 1000 samples are surplus at this rate and are dropped.",
        ),
        (
            {"back": 1},
            "info",
            "stamps-out-of-order",
            "1 of 1000 time stamps are earlier than the previous one; the samples keep the order of the log.",
        ),
    ],
)
def test_each_fault_of_the_stamps_is_reported(
    given: dict[str, int], level: str, code: str, text: str
) -> None:
    """The text explains the effect on the samples."""
    assert noted(**given) == [(level, code, text)]


@pytest.mark.parametrize("given", [{}, {"same": 3, "resolution": TAU // 50}])
def test_negligible_deviations_are_not_reported(given: dict[str, int]) -> None:
    """Cases: even stamps, and a few equal stamps of a clock that is fine enough."""
    assert noted(**given) == []


def test_settings_of_the_clock_are_reported() -> None:
    """The finding contains their number, the largest one with its sign, and its sample."""
    stamps = np.array([0, 1, 3, 2, 1], dtype=np.int64) * 10**9
    assert jump_notes(stamps, {}) == []
    (note,) = jump_notes(stamps, {3: 1})
    assert (note.level, note.code) == ("warning", "clock-jump")
    assert note.text == (
        "The clock was set once, at most by -1 s at sample 3; the samples before and after are not joined."
    )
    (note,) = jump_notes(stamps, {3: 1, 2: 1})
    assert note.text.startswith("The clock was set 2 times, at most by +2 s at sample 2;")


@pytest.mark.parametrize(
    ("offsets", "level", "text"),
    [
        ((0, 501), "info", "1 sample (0.001 of all) is missing in one gap; the longest is 0.005 s at 2.5 s."),
        (
            (0, 502),
            "warning",
            "2 samples (0.002 of all) are missing in one gap; the longest is 0.01 s at 2.5 s.",
        ),
        (
            (0, 502, 603),
            "warning",
            "3 samples (0.003 of all) are missing in 2 gaps; the longest is 0.01 s at 2.5 s.",
        ),
    ],
)
def test_gaps_above_a_thousandth_of_the_samples_are_a_warning(
    offsets: tuple[int, ...], level: str, text: str
) -> None:
    stops = (500, 600, 1000) if len(offsets) > 2 else (500, 999)
    starts = (0, *stops[:-1])
    clock = Clock(
        source="stamps",
        rate_hz=200.0,
        segments=tuple(
            Segment(start=start, stop=stop, offset=offset)
            for start, stop, offset in zip(starts, stops, offsets, strict=True)
        ),
        start_ns=0,
        jitter_s=0.0,
    )
    (note,) = gap_findings([clock])
    assert (note.level, note.code, note.text) == (level, "gaps", text)
    assert list(gap_findings([Clock.even(1000, 200.0)])) == []


@pytest.mark.parametrize(
    ("stamps", "log"),
    [(STAMPS[:1], STAMPS[:1] + 5), (STAMPS[:0], STAMPS[:0]), (STAMPS, STAMPS), (STAMPS, 0 * STAMPS)],
)
def test_clocks_without_a_second_clock_are_not_compared(stamps: IntArray, log: IntArray) -> None:
    """Cases: one sample, a single clock, and no log time."""
    assert compare_clocks(stamps, log) == []


def test_the_median_and_largest_delay_of_messages_are_reported() -> None:
    """A difference of more than a day is not a delay."""
    two = STAMPS[:2]
    (note,) = compare_clocks(two, two + np.array([1_000_000, 3_000_000]))
    assert (note.level, note.code) == ("info", "delay")
    assert note.text == "Messages were recorded 2 ms after their time stamps, at most 3 ms."
    (note,) = compare_clocks(two, two + 86_400 * 10**9)
    assert note.text == "Messages were recorded 8.64e+07 ms after their time stamps, at most 8.64e+07 ms."
    for sign in (1, -1):
        (note,) = compare_clocks(two, two + sign * (86_400 * 10**9 + 10**8))
        assert note.text == f"Time stamps and log time have different origins, {sign * 86_400.1:.6g} s apart."


@pytest.mark.parametrize(
    ("n", "drift", "ratio"),
    [
        (20_001, 0.0, None),
        (20_001, 4.9e-4, None),
        (20_001, -6e-4, "-0.06%"),
        (20_001, 6e-4, "+0.06%"),
        # The log has exactly one minute, and one sample more.
        (12_001, 6e-4, None),
        (12_002, 6e-4, "+0.06%"),
        # The shorter of the two durations counts.
        (12_002, -6e-4, None),
        (12_102, -6e-4, "-0.06%"),
    ],
)
def test_clocks_that_differ_by_more_than_half_a_per_mille_are_reported(
    n: int, drift: float, ratio: str | None
) -> None:
    """The log must be longer than a minute."""
    log = STAMPS[:n]
    own = np.round(log * (1 + drift)).astype(np.int64)
    found = compare_clocks(own, log + 10**6)
    assert [note.code for note in found] == ["delay", *(["clocks-differ"] if ratio else [])]
    if ratio:
        assert found[1].level == "warning"
        assert found[1].text == (
            f"The time stamps span {own[-1] / 1e9:.6g} s, the log time {log[-1] / 1e9:.6g} s: "
            f"the clocks differ by {ratio}."
        )
