"""Tests of `allan_curve`, from an axis to its curve."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import AllanCurve, allan_curve
from imucal.clock import Clock, Segment
from imucal.errors import DataError
from imucal.recording import AxisSeries, Sensor
from tests.allan.witness import naive_moav
from tests.raising import raises

SAMPLES = np.random.default_rng(0).standard_normal(1000) + 9.8
SERIES = AxisSeries.from_samples(SAMPLES, rate_hz=200.0, sensor="accelerometer", axis="z")


def test_the_default_curve() -> None:
    """It is exact at octaves up to n/4, with hybrid degrees of freedom above 2."""
    curve = allan_curve(SERIES)
    npt.assert_array_equal(curve.m, [1, 2, 4, 8, 16, 32, 64, 128])
    npt.assert_allclose(curve.tau, curve.m / 200.0)
    npt.assert_allclose(curve.avar, [naive_moav(SAMPLES, k) for k in curve.m.tolist()], rtol=1e-11)
    assert (curve.n, curve.estimator) == (1000, "overlapping")
    assert (curve.computed, curve.edf_method) == ("exact", "hybrid")
    assert np.all(curve.edf > 2)
    low, high = curve.confidence_interval()
    assert np.all((low > 0) & (low < curve.adev) & (curve.adev < high))


@pytest.mark.parametrize("taus", ["octave", "decade:5", "all", [0.005, 0.1]])
def test_every_set_of_times_gives_a_curve(taus: str | list[float]) -> None:
    """Times increase, values are positive, and degrees of freedom are finite."""
    series = AxisSeries.from_samples(SAMPLES[:200], rate_hz=200.0)
    curve = allan_curve(series, taus=taus)
    assert isinstance(curve, AllanCurve)
    assert np.all(curve.avar > 0)
    assert np.all(curve.edf >= 1)
    assert curve.m[-1] <= 100


def test_requested_times_go_up_to_half_of_the_record() -> None:
    """``all`` and a list reach m = n/2, where a single difference remains."""
    everything = allan_curve(SERIES, taus="all")
    assert everything.m[-1] == 500
    assert everything.edf[-1] == pytest.approx(1.0)
    assert allan_curve(SERIES, taus=[2.5]).m.tolist() == [500]


def test_non_finite_samples_count_as_missing() -> None:
    """The curve equals that without these samples and contains no NaN."""
    spoiled = SAMPLES.copy()
    spoiled[[10, 11, 700]] = [np.nan, np.inf, -np.inf]
    keep = np.ones(1000, dtype=bool)
    keep[[10, 11, 700]] = False
    curve = allan_curve(AxisSeries.from_samples(spoiled, rate_hz=200.0))
    expected = allan_curve(SERIES.keeping(keep))
    npt.assert_array_equal(curve.avar, expected.avar)
    assert curve.computed == "windows"
    assert curve.edf_method == "model"
    assert curve.n == 997
    assert np.all(np.isfinite(curve.edf))


def test_adjacent_segments_are_not_a_gap() -> None:
    """A clock may have several segments without missing samples."""
    segments = (Segment(start=0, stop=400, offset=0), Segment(start=400, stop=1000, offset=400))
    clock = Clock(source="test", rate_hz=200.0, segments=segments)
    series = AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=SAMPLES, clock=clock)
    curve = allan_curve(series)
    assert curve.computed == "exact"
    npt.assert_array_equal(curve.avar, allan_curve(SERIES).avar)


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_samples_are_rejected(n: int) -> None:
    """The error contains the given and the required number."""
    with pytest.raises(DataError) as caught:
        allan_curve(AxisSeries.from_samples(SAMPLES[:n], rate_hz=1.0))
    assert str(caught.value) == (
        f"gyro_x: {n} neighbouring samples are too few for an Allan variance; at least 2 are needed"
    )


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8, 9, 16])
def test_the_shortest_series_have_a_curve(n: int) -> None:
    """Two samples give one value with one degree of freedom."""
    curve = allan_curve(AxisSeries.from_samples(SAMPLES[:n], rate_hz=1.0))
    assert curve.m[0] == 1
    npt.assert_allclose(curve.avar, [naive_moav(SAMPLES[:n], k) for k in curve.m.tolist()], rtol=1e-9)


def test_samples_without_finite_values_are_rejected() -> None:
    with raises(DataError, "0 neighbouring samples", place="gyro_x"):
        allan_curve(AxisSeries.from_samples(np.full(10, np.nan), rate_hz=1.0))


def test_an_unknown_set_of_times_is_rejected() -> None:
    with pytest.raises(ValueError, match="'log'"):
        allan_curve(SERIES, taus="log")


def test_the_samples_are_not_modified() -> None:
    before = SAMPLES.copy()
    allan_curve(SERIES, taus="all")
    npt.assert_array_equal(SAMPLES, before)
