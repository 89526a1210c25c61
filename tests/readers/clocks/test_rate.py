"""The period that steps show: what counts as one step, as a skip, as a burst, as coarse."""

import numpy as np
import pytest

from imucal.arrays import IntArray, median
from imucal.readers.clocks import placing
from imucal.readers.clocks.placing import (
    _conserved,
    _only_late,
    _plateau,
    _skips,
    _slope,
    estimate_period,
)


def steps(*runs: tuple[int, int]) -> IntArray:
    """Return steps, each so many times."""
    return np.concatenate([np.full(times, step, dtype=np.int64) for step, times in runs])


def stamps(found: IntArray) -> IntArray:
    return np.concatenate([[0], np.cumsum(found)])


@pytest.mark.parametrize(
    ("found", "single"),
    [
        (steps((100, 1)), True),
        # Three of ten of one unit are enough, a quarter off at most.
        (steps((100, 3), (200, 7)), True),
        (steps((100, 29), (200, 71)), False),
        (steps((124, 3), (200, 7)), True),
        (steps((125, 3), (200, 7)), False),
        (steps((76, 3), (200, 7)), True),
        (steps((75, 3), (200, 7)), False),
        # Nine of ten longer steps are whole.
        (steps((100, 10), (200, 9), (250, 1)), True),
        (steps((100, 10), (200, 8), (250, 2)), False),
        (steps((100, 10), (224, 9), (300, 1)), True),
        (steps((100, 10), (225, 10)), False),
        # Steps of less than 1.4 units are not longer.
        (steps((100, 10), (200, 9), (140, 9)), True),
        (steps((100, 10), (200, 9), (141, 9)), False),
    ],
)
def test_skips(found: IntArray, single: bool) -> None:  # noqa: FBT001 - of the case
    """Many steps are one unit, the longer ones whole multiples; without longer ones nothing is skipped."""
    assert _skips(found, 100.0) == (single and found.size > 1)


@pytest.mark.parametrize(
    ("longer", "quantum", "late"),
    [
        ((400, 10), 1, True),
        ((399, 10), 1, False),
        # A pair of pauses shows nothing.
        ((400, 2), 1, False),
        ((400, 3), 1, True),
        # A power of ten of more than half a unit is the clock's.
        ((200, 10), 100, True),
        ((200, 10), 10, False),
        ((200, 10), 60, False),
    ],
)
def test_late_or_missing(longer: tuple[int, int], quantum: int, late: bool) -> None:  # noqa: FBT001 - of the case
    """Long pauses after short steps are bursts, stamps of whole ms are coarse; all else is missing."""
    found = np.resize(np.array([100, 100, longer[0]]), 3 * longer[1]).astype(np.int64)
    tau = float(found.mean())
    assert _only_late([stamps(found)], found, tau, 100.0, quantum) == late


def test_half_a_unit_is_not_coarse() -> None:
    """A quantum of a power of ten counts where it is more than half of the unit."""
    found = np.resize(np.array([20, 20, 30]), 60).astype(np.int64)
    late = [_only_late([stamps(found)], found, float(found.mean()), unit, 10) for unit in (19.9, 20.0)]
    assert late == [True, False]


def test_what_is_conserved() -> None:
    """A log in bursts stays within a few pauses, one that loses more and more does not."""
    bursts = np.resize(np.array([1, 1, 1, 37]), 4000).astype(np.int64)
    assert _conserved([stamps(bursts)], 10.0)
    wander = np.concatenate([steps((10, 1500)), steps((11, 500)), steps((10, 1500)), steps((11, 500))])
    assert not _conserved([stamps(wander)], 10.0)
    assert not _conserved([stamps(steps((10, 1)))], 10.0)
    assert _conserved([stamps(steps((10, 2)))], 10.0)


def test_slopes() -> None:
    """The median over windows, of all blocks that are long enough."""
    blocks = [np.array([0, 10, 30, 60]), np.array([0, 7])]
    assert _slope(blocks, 1) == (10 + 20) / 2
    assert _slope(blocks, 2) == 40 / 2
    assert _slope(blocks, 3) == 20.0
    assert np.isnan(_slope(blocks, 4))


def test_the_plateau() -> None:
    """The first width from which a wider window changes nothing; the whole where it is short."""
    assert _plateau([np.array([0, 10, 20, 60]), np.array([0, 1])]) == 20.0
    assert _plateau([stamps(steps((10, 45), (70, 1)))]) == pytest.approx(520 / 46)
    assert _plateau([stamps(steps((10, 46), (70, 1)))]) == 10.0
    bursts = stamps(np.resize(np.array([*[1] * 31, 289]), 2000).astype(np.int64))
    assert _plateau([bursts]) == 10.0


def test_jitter_and_median() -> None:
    """A stamp's share of the deviation of steps; medians of even and odd counts."""
    assert median([3, 1, 2]) == 2.0
    assert median([4, 1, 2, 8]) == 3.0
    period = estimate_period(stamps(np.resize([9, 10, 11, 10, 11, 9], 600)))
    assert period is not None
    assert period.jitter == pytest.approx(1.4826 / np.sqrt(2) / 10, rel=0.01)


@pytest.mark.parametrize(
    ("found", "quantum"),
    [
        (steps((6, 20), (9, 20)), 3),
        (steps((6, 40), (-9, 1)), 3),
        (steps((0, 1), (5, 40)), 5),
        (steps((7, 1)), 7),
    ],
)
def test_resolution(found: IntArray, quantum: int) -> None:
    """The greatest common divisor of the steps, back and forth."""
    period = estimate_period(stamps(found))
    assert period is not None
    assert period.resolution_ns == quantum


@pytest.mark.parametrize(
    ("found", "tau", "burst"),
    [
        (steps((10, 99)), 10.0, 1),
        (steps((1, 1)), 1.0, 1),
        # Whole ms make every second step longer, lost samples do too: the stamps' resolution tells.
        (np.resize([10, 20], 300), 15.0, 1),
        (np.resize([7, 14], 300), 7.0, 1),
        (np.resize([7] * 9 + [14], 1000), 7.0, 1),
        (np.resize([1] * 4 + [46], 1000), 151 / 16, 5),
    ],
)
def test_periods(found: IntArray, tau: float, burst: int) -> None:
    """Of even, of skipped and of bundled samples."""
    period = estimate_period(stamps(found))
    assert period is not None
    assert period.tau_ns == pytest.approx(tau, rel=1e-9)
    assert period.burst == burst


@pytest.mark.parametrize("found", [steps((0, 9)), steps((-1, 9)), steps((-5, 5), (1, 4))])
def test_no_period(found: IntArray) -> None:
    """Stamps that stand still or go back have none."""
    assert estimate_period(stamps(found)) is None


def test_long_logs_are_looked_at_in_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """All samples up to a limit, beyond it some runs from the first to the last."""
    monkeypatch.setattr(placing, "_RUN", 4)
    monkeypatch.setattr(placing, "_RUNS", 3)
    place = np.arange(13)
    assert [block.tolist() for block in placing._runs(place[:12])] == [[*range(12)]]
    assert [block.tolist() for block in placing._runs(place)] == [
        [0, 1, 2, 3],
        [4, 5, 6, 7],
        [9, 10, 11, 12],
    ]
