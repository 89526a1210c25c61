"""Logs at rest: how rarely the screening cries wolf."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.pipeline import screen
from imucal.recording import AxisSeries, Recording, Source
from tests.screening.still import KINDS, recording, still, unrelated_temperature
from tests.slow_cases import first_by_default


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_any_kind_is_no_fault(kind: str) -> None:
    """A log of six axes: none warned of; of fourteen, one in seven may have an alarm by chance at most.

    tests/benchmarks/screening.py measures the rate on many logs: below 1 % of logs for each check
    over all kinds; of these logs none has one.
    """
    found = screen(recording(*still(20_000, 1000, kind), temperature=unrelated_temperature(20_000, 1000)))
    assert [finding.code for finding in found if finding.level != "info"] == []


def test_clean_white_noise_has_no_finding_at_all() -> None:
    """Not even a note: nothing is wrong and nothing is coloured."""
    assert screen(recording(*still(30_000, 7))) == ()


@pytest.mark.parametrize("rate_hz", [10.0, 1000.0])
def test_other_rates_are_as_quiet(rate_hz: float) -> None:
    """Slow and quick sensors have other windows; none of them is disturbed."""
    gyro, accel = still(30_000, 8)
    found = screen(recording(gyro, accel, clock=Clock.even(30_000, rate_hz)))
    assert found == ()


def test_gaps_are_no_fault() -> None:
    """Bursts and single samples missing, a few NaN left in: nothing to warn of."""
    rng = np.random.default_rng(9)
    whole = recording(*still(40_000, 9))
    keep = rng.random(40_000) > 0.01
    keep[10_000:14_000] = False
    series = tuple(s.keeping(keep) for s in whole.series)
    samples = series[0].samples.copy()
    samples[::2000] = np.nan
    series = (replace(series[0], samples=samples), *series[1:])
    assert [f for f in screen(replace(whole, series=series)) if f.level != "info"] == []


@pytest.mark.parametrize("n", [0, 1, 2, 15, 16, 17, 40, 200, 1000])
def test_short_logs_neither_crash_nor_alarm(n: int) -> None:
    """What little there is raises no warning; nothing at all is said to be no data."""
    found = screen(recording(*still(n, 10)))
    assert {f.code for f in found} == (set() if n else {"no-data"})


def test_an_empty_recording_has_no_finding() -> None:
    """No axes, nothing to say: the reader has refused it, or the caller has left them out."""
    assert screen(Recording(source=Source(path="empty", format="csv"), series=())) == ()


def test_one_axis_alone_is_screened() -> None:
    """Checks that need three axes pass over it."""
    series = AxisSeries.from_samples(np.random.default_rng(11).normal(size=20_000), rate_hz=100.0)
    found = screen(Recording(source=Source(path="one", format="array"), series=(series,)))
    # Noise of deviation 1 rad/s is no gyroscope's.
    assert [f.code for f in found] == ["unit-suspect"]


#: Samples that no sensor gives, but damaged logs hold.
WILD: list[Callable[[int, np.random.Generator], FloatArray]] = [
    lambda n, rng: rng.normal(size=n) * 10.0 ** rng.integers(-300, 300),
    lambda n, _: np.zeros(n),
    lambda n, _: np.full(n, 1e308),
    lambda n, rng: rng.choice([-1.7e308, 1.7e308], n),
    lambda n, rng: np.full(n, 5e-324) * rng.integers(0, 3, n),
    lambda n, rng: np.where(rng.random(n) < 0.5, np.nan, rng.normal(size=n)),
    lambda n, rng: np.where(np.arange(n) < n // 2, np.inf, rng.normal(size=n)),
    lambda n, rng: rng.standard_cauchy(n),
    lambda n, rng: rng.normal(size=n).cumsum().cumsum(),
    lambda n, _: np.arange(n, dtype=np.float64),
    lambda n, _: np.sin(np.arange(n)),
    lambda n, rng: np.repeat(rng.normal(size=n // 10 + 1), 10)[:n],
    lambda n, rng: 1e16 + rng.normal(size=n),
]


@pytest.mark.parametrize("seed", first_by_default(range(13), 5))
def test_damaged_data_neither_crash_nor_print_nan(seed: int) -> None:
    """Six of the wild axes, each kind in six of the tests, give findings whose figures are numbers.

    Warnings are errors here.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 2000))
    # These differ by every number up to twelve: each two kinds stand beside one another in some test.
    table = np.stack([WILD[(seed + step) % len(WILD)](n, rng) for step in (0, 1, 3, 4, 9, 11)])
    for finding in screen(recording(table[:3], table[3:])):
        assert not {"nan", "inf", "-inf"} & set(finding.text.split())
        assert finding.keep_s is None or np.all(np.isfinite(finding.keep_s))
