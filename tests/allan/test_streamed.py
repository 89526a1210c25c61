"""A log beyond memory: the curve is streamed, and hardly differs from the exact one."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import AllanCurve, allan_curve, engine
from imucal.recording import AxisSeries


@pytest.fixture
def _little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that the machine has a hundred kilobytes."""
    monkeypatch.setattr(engine, "memory_limit", lambda: 25_000)


def noise(n: int) -> AxisSeries:
    """White noise on a walk."""
    rng = np.random.default_rng(11)
    return AxisSeries.from_samples(rng.normal(size=n) + 0.02 * np.cumsum(rng.normal(size=n)), rate_hz=100.0)


def within_the_interval(streamed: AllanCurve, exact: AllanCurve, share: float) -> bool:
    """Say whether two curves of the same factors differ by less than a share of the interval's width."""
    low, high = exact.confidence_interval()
    return bool(np.all(np.abs(streamed.adev - exact.adev) < share * (high - low)))


@pytest.mark.parametrize("taus", ["octave", "decade"])
def test_a_streamed_curve_is_within_a_hundredth_of_the_interval(
    taus: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bound is engine.md's for the cascade; below m = 256 both are the same sums."""
    series = noise(60_000)
    monkeypatch.setattr(engine, "memory_limit", lambda: 25_000)
    streamed = allan_curve(series, taus=taus)
    monkeypatch.undo()
    exact = allan_curve(series, taus=(streamed.tau).tolist())
    assert streamed.computed == "cascade"
    npt.assert_array_equal(streamed.m, exact.m)
    assert within_the_interval(streamed, exact, 0.01)


@pytest.mark.usefixtures("_little_memory")
def test_a_listed_time_is_never_streamed() -> None:
    """Who asks for one averaging time gets that one, exactly."""
    assert allan_curve(noise(5_000), taus=[0.37]).computed == "exact"


@pytest.mark.usefixtures("_little_memory")
def test_missing_samples_part_a_streamed_log() -> None:
    """Gaps and NaN alike: no difference spans them, and no value is NaN."""
    series = noise(40_000)
    samples = series.samples.copy()
    samples[10_000:10_050] = np.nan
    keep = np.ones(series.n, dtype=np.bool_)
    keep[30_000:30_700] = False
    gappy = AxisSeries.from_samples(samples, rate_hz=100.0).keeping(keep)
    curve = allan_curve(gappy)
    assert curve.computed == "cascade"
    assert np.all(np.isfinite(curve.avar))
    whole = allan_curve(series)
    shared = min(curve.tau.size, whole.tau.size)
    low, high = whole.confidence_interval(0.999)
    assert np.all((curve.adev[:shared] > low[:shared]) & (curve.adev[:shared] < high[:shared]))
