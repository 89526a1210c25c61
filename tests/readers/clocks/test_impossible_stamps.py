"""Stamps of damaged logs: wild values, jumps of years and constant parts never crash."""

import numpy as np
import pytest

from imucal.arrays import IntArray
from imucal.errors import DataError, ImucalError
from imucal.readers.clocks import clock_from_stamps


def _damaged(rng: np.random.Generator) -> IntArray:
    """Return stamps of up to 400 samples with up to 24 damages."""
    n = int(rng.integers(1, 400))
    first = int(rng.choice([0, 1, 10**6, 1_700_000_000 * 10**9]))
    period = int(rng.choice([1, 1000, 5_000_000, 10**9, 10**12]))
    stamps = first + np.arange(n, dtype=np.int64) * period
    for _ in range(int(rng.integers(0, 25))):
        place = int(rng.integers(n))
        kind = str(rng.choice(["any", "jump", "zero", "stopped", "far"]))
        if kind == "any":
            stamps[place] = int(rng.integers(-(2**63), 2**63 - 1))
        elif kind == "jump":
            stamps[place:] += int(rng.integers(-(10**18), 10**18))
        elif kind == "zero":
            stamps[place] = 0
        elif kind == "stopped":
            stamps[place:] = stamps[place]
        else:
            stamps[place] = int(rng.integers(0, 2**62))
    return stamps


def test_damaged_stamps_are_read_or_refused() -> None:
    """A rate is always positive, and all other errors are those of imucal."""
    rng = np.random.default_rng(61144)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(1500):
        try:
            reading = clock_from_stamps(_damaged(rng), source="stamps")
        except ImucalError:
            outcomes["refused"] += 1
        else:
            assert 0 < reading.clock.rate_hz < np.inf
            outcomes["read"] += 1
    assert min(outcomes.values()) > 300


def test_a_stamp_far_from_1970_is_no_time() -> None:
    """One wild stamp is interpolated, and the rate stays the same."""
    stamps = 1_700_000_000 * 10**9 + np.arange(2000, dtype=np.int64) * 5_000_000
    stamps[700] = -(2**63)
    reading = clock_from_stamps(stamps, source="stamps")
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-6)
    assert "1 of 2000 time stamps (stamps) are more than 146 years from 1970" in reading.findings[0].text


def test_stamps_that_are_years_apart_are_no_clock() -> None:
    with pytest.raises(DataError, match=r"are 3\.15e\+07 s apart; expected an IMU's clock, check its unit"):
        clock_from_stamps(np.arange(100, dtype=np.int64) * 31_536_000 * 10**9, source="stamps")
