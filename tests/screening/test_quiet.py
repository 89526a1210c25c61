"""Tests of the false alarm rate of the screening for logs at rest."""

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
def test_noise_of_any_kind_has_no_warning(kind: str) -> None:
    """By chance, at most one in seven of these fourteen logs of six axes may have a warning.

    tests/benchmarks/screening.py measures the rate on many logs: below 1 % of logs for each check over all
    kinds; none of these logs has one.
    """
    found = screen(recording(*still(20_000, 1000, kind), temperature=unrelated_temperature(20_000, 1000)))
    assert [finding.code for finding in found if finding.level != "info"] == []


def test_clean_white_noise_has_no_finding() -> None:
    """There is not even a finding of level info."""
    assert screen(recording(*still(30_000, 7))) == ()


@pytest.mark.parametrize("rate_hz", [10.0, 1000.0])
def test_other_rates_have_no_finding(rate_hz: float) -> None:
    """Slow and fast sensors have other windows."""
    gyro, accel = still(30_000, 8)
    found = screen(recording(gyro, accel, clock=Clock.even(30_000, rate_hz)))
    assert found == ()


def test_gaps_have_no_warning() -> None:
    """Bursts and single samples are missing, and a few are NaN."""
    rng = np.random.default_rng(9)
    complete = recording(*still(40_000, 9))
    keep = rng.random(40_000) > 0.01
    keep[10_000:14_000] = False
    series = tuple(s.keeping(keep) for s in complete.series)
    samples = series[0].samples.copy()
    samples[::2000] = np.nan
    series = (replace(series[0], samples=samples), *series[1:])
    assert [f for f in screen(replace(complete, series=series)) if f.level != "info"] == []


@pytest.mark.parametrize("n", [0, 1, 2, 15, 16, 17, 40, 200, 1000])
def test_short_logs_have_no_warning(n: int) -> None:
    """A log without samples is reported as no data."""
    found = screen(recording(*still(n, 10)))
    assert {f.code for f in found} == (set() if n else {"no-data"})


def test_an_empty_recording_has_no_finding() -> None:
    """Readers reject files without axes, so the caller has removed them."""
    assert screen(Recording(source=Source(path="empty", format="csv"), series=())) == ()


def test_a_single_axis_is_screened() -> None:
    """Checks that need three axes are skipped."""
    series = AxisSeries.from_samples(np.random.default_rng(11).normal(size=20_000), rate_hz=100.0)
    found = screen(Recording(source=Source(path="one", format="array"), series=(series,)))
    # No gyroscope has noise with a deviation of 1 rad/s.
    assert [f.code for f in found] == ["unit-suspect"]


#: Samples that no sensor produces but damaged logs contain.
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
    """Six wild axes have findings with finite figures; each kind is in six of the tests.

    Warnings are errors here.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 2000))
    # These differ by all numbers up to twelve, so any two kinds occur together in some test.
    table = np.stack([WILD[(seed + step) % len(WILD)](n, rng) for step in (0, 1, 3, 4, 9, 11)])
    for finding in screen(recording(table[:3], table[3:])):
        assert not {"nan", "inf", "-inf"} & set(finding.text.split())
        assert finding.keep_s is None or np.all(np.isfinite(finding.keep_s))
