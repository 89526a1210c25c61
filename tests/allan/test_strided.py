"""Tests of curves of logs larger than memory: strided values at large averaging times are nearly exact."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import AllanCurve, allan_curve, engine
from imucal.allan.variance import variances
from imucal.errors import DataError
from imucal.recording import AxisSeries


@pytest.fixture
def _little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce the memory limit to 25 kB."""
    monkeypatch.setattr(engine, "memory_limit", lambda: 25_000)


def noise(n: int) -> AxisSeries:
    """Return white noise plus a random walk."""
    rng = np.random.default_rng(11)
    return AxisSeries.from_samples(rng.normal(size=n) + 0.02 * np.cumsum(rng.normal(size=n)), rate_hz=100.0)


def within_the_interval(strided: AllanCurve, exact: AllanCurve, share: float) -> bool:
    """Whether two curves of the same factors differ by less than a share of the interval's width."""
    low, high = exact.confidence_interval()
    return bool(np.all(np.abs(strided.adev - exact.adev) < share * (high - low)))


@pytest.mark.parametrize("taus", ["octave", "decade", "decade:40"])
@pytest.mark.parametrize("n", [200_003, 60_000])
def test_strided_values_are_within_a_hundredth_of_the_interval(
    taus: str, n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Factors below 8192 are exact."""
    series = noise(n)
    monkeypatch.setattr(engine, "memory_limit", lambda: 25_000)
    strided = allan_curve(series, taus=taus)
    monkeypatch.undo()
    exact = allan_curve(series, taus=strided.tau.tolist())
    assert strided.computed == "strided"
    assert strided.m[-1] > n // 5 / 2
    npt.assert_array_equal(strided.m, exact.m)
    npt.assert_allclose(strided.tau, strided.m / 100.0)
    assert within_the_interval(strided, exact, 0.01)
    small = strided.m < 8192
    npt.assert_allclose(strided.avar[small], exact.avar[small], rtol=1e-10)


@pytest.mark.usefixtures("_little_memory")
def test_degrees_of_freedom_of_strided_values_are_plausible() -> None:
    """They decrease with m and stay below twice the number of independent windows."""
    curve = allan_curve(noise(300_000))
    assert np.all(np.diff(curve.edf) < 0)
    assert np.all(curve.edf <= 2 * 300_000 / curve.m)


@pytest.mark.usefixtures("_little_memory")
def test_no_difference_spans_a_gap() -> None:
    """A jump at a gap has no effect: the value is the mean over both parts weighted by their terms."""
    parts = (noise(50_000).samples, noise(30_000).samples + 1e3)
    samples = np.concatenate([parts[0], [np.nan], parts[1]])
    curve = allan_curve(AxisSeries.from_samples(samples, rate_hz=1.0))
    small = curve.m[curve.m < 8192]
    terms = [part.size + 1 - 2 * small for part in parts]
    values = [variances(part, small) for part in parts]
    expected = (terms[0] * values[0] + terms[1] * values[1]) / (terms[0] + terms[1])
    npt.assert_allclose(curve.avar[: small.size], expected, rtol=1e-7)
    # At m = 8192, differences start at every 64th sample of each part.
    sums = [part[: part.size // 64 * 64].reshape(-1, 64).sum(axis=1) for part in parts]
    angle = [np.concatenate([[0.0], np.cumsum(part - part.mean())]) for part in sums]
    steps = np.concatenate([x[256:] - 2 * x[128:-128] + x[:-256] for x in angle])
    (at,) = np.flatnonzero(curve.m == 8192)
    assert curve.avar[at] == pytest.approx(float(np.mean(steps**2)) / (2 * 8192**2), rel=1e-9)


@pytest.mark.usefixtures("_little_memory")
def test_samples_of_single_precision_are_summed_in_double() -> None:
    """The mean is much larger than the noise."""
    samples = (noise(40_000).samples + 1e4).astype(np.float32)
    curve = allan_curve(AxisSeries.from_samples(samples, rate_hz=100.0))  # type: ignore[arg-type]
    exact = variances(samples.astype(np.float64), curve.m[curve.m < 8192])
    npt.assert_allclose(curve.avar[curve.m < 8192], exact, rtol=1e-10)


def test_isolated_samples_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no two adjacent samples."""
    monkeypatch.setattr(engine, "memory_limit", lambda: 1)
    series = AxisSeries.from_samples(np.array([1.0, np.nan, 4.0]), rate_hz=10.0)
    with pytest.raises(DataError, match="3 samples are too few for an Allan variance"):
        allan_curve(series)
    two = allan_curve(AxisSeries.from_samples(np.array([1.0, 4.0]), rate_hz=10.0))
    assert (two.m.tolist(), two.avar.tolist(), two.n) == ([1], [4.5], 2)


@pytest.mark.usefixtures("_little_memory")
def test_a_listed_time_is_exact() -> None:
    assert allan_curve(noise(5_000), taus=[0.37]).computed == "exact"


@pytest.mark.usefixtures("_little_memory")
def test_values_with_missing_samples_are_in_the_intervals() -> None:
    """Gaps and NaN are equivalent, and no value is NaN."""
    series = noise(40_000)
    samples = series.samples.copy()
    samples[10_000:10_050] = np.nan
    keep = np.ones(series.n, dtype=np.bool_)
    keep[30_000:30_700] = False
    gappy = AxisSeries.from_samples(samples, rate_hz=100.0).keeping(keep)
    curve = allan_curve(gappy)
    assert curve.computed == "strided"
    assert np.all(np.isfinite(curve.avar))
    full = allan_curve(series)
    shared = min(curve.tau.size, full.tau.size)
    low, high = full.confidence_interval(0.999)
    assert np.all((curve.adev[:shared] > low[:shared]) & (curve.adev[:shared] < high[:shared]))
