"""Tests of packed bins: rounding, size, content and rejected data."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

import imucal
from imucal import DataError, NoiseFit
from imucal.fitting.bins import PACKED_VERSION, Bins, pack, unpack
from imucal.fitting.spectral.given_model import fit_bins
from imucal.fleet_run import plan
from imucal.recording import AxisSeries
from tests.fleet.records import RATE, bins_from, fit_of, simulated
from tests.fleet.test_pooling import one_record

MIXED = "N=1e-3 + B=2e-4 + K=4e-5"


def _packed(fit: NoiseFit) -> NoiseFit:
    assert fit.bins is not None
    return replace(fit, bins=unpack(pack(fit.bins)))


def _same_fit(bins: Bins, model: tuple[str, ...] = ("N", "B", "K"), rtol: float = 1e-6) -> None:
    one, other = (fit_bins([each], model, level=0.95) for each in (bins, unpack(pack(bins))))
    for ours, theirs in zip(other.estimates, one.estimates, strict=True):
        assert ours.status == theirs.status
        for name in ("value", "low", "high"):
            npt.assert_allclose(getattr(ours, name) or 0.0, getattr(theirs, name) or 0.0, rtol=rtol)


@pytest.mark.parametrize("model", ["N + B + K", "N + K + R"])
def test_a_pool_of_packed_bins_agrees_with_one_fit_of_all_records(model: str) -> None:
    """The reference is one record with long gaps between the parts; unpacked bins also agree to 1e-6."""
    parts = [simulated("N=1e-3 + K=4e-4", n, 5, n) for n in (6000, 4000, 7500)]
    whole = fit_of(one_record(parts), model)
    pooled = imucal.pool([_packed(fit_of(part, model)) for part in parts], model=model)
    assert not any(test.differs for test in pooled.homogeneity)
    for ours, theirs in zip(pooled.estimates, whole.estimates, strict=True):
        npt.assert_allclose(ours.value or 0.0, theirs.value or 0.0, rtol=1e-6)
        npt.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], rtol=1e-6)


@pytest.mark.parametrize(("n", "most"), [(1_000, 3_100), (10_000, 5_100), (100_000, 7_150)])
def test_packed_bins_of_an_axis_have_at_most_seven_kilobytes(n: int, most: int) -> None:
    """The fit of the unpacked bins is the same."""
    bins = bins_from(simulated(MIXED, n, 72))
    assert len(pack(bins)) < most
    _same_fit(bins)


def test_a_drift_far_above_the_noise_does_not_change_the_fit() -> None:
    """The ramp's square is 1e8 of the noise in the lowest ordinate, so double precision limits the fit."""
    for seed in range(73, 78):
        samples = simulated("N=1e-3 + K=1e-4", 5000, seed) + 1e2 * np.linspace(0, 1, 5000)
        _same_fit(bins_from(samples), ("N", "K", "R"), rtol=2e-5)


def test_regressors_and_gaps_are_kept() -> None:
    """The record has a temperature effect, a step, a completed short gap and a long gap between blocks."""
    rng = np.random.default_rng(74)
    n = 12_000
    temperature = 25 + 5 * np.sin(np.arange(n) / 2500) + 0.01 * rng.standard_normal(n)
    samples = simulated("N=1e-3 + K=2e-5", n, 75) + 0.05 * (temperature - 25)
    samples[7000:] += 0.1
    samples[100:130] = np.nan
    samples[3000:3400] = np.nan
    series = AxisSeries.from_samples(samples, rate_hz=RATE)
    bins = imucal.fit(series, model="N + K", segments=1, temperature=temperature).bins
    assert bins is not None
    assert len(bins.names) > 2
    assert bins.n.size == 2
    _same_fit(bins, ("N", "K"))
    again = unpack(pack(bins))
    assert again.names == bins.names
    for name in ("n", "start", "first"):
        npt.assert_array_equal(getattr(again, name), getattr(bins, name))
    for name in ("scale", "tau0", "widening", "version"):
        assert getattr(again, name) == getattr(bins, name)
    npt.assert_allclose(again.size, bins.size, rtol=1e-6)


def test_packing_again_changes_the_last_digit_at_most() -> None:
    once = unpack(pack(bins_from(simulated(MIXED, 3000, 76))))
    npt.assert_allclose(unpack(pack(once)).power, once.power, rtol=2e-6)


def test_a_store_with_bins_of_another_version_is_fitted_again() -> None:
    """The keys of its results contain the version of the packed bins."""
    assert plan._BINS == PACKED_VERSION


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda data: data[:0], "found version no bytes, expected 2.1"),
        (lambda data: b"\x09" + data[1:], "found version 9.1, expected 2.1; fit the log again"),
        (lambda data: b"\x01" + data[1:], "found version 1.1, expected 2.1; fit the log again"),
        (lambda data: data[:1] + b"\x07" + data[2:], "found version 2.7"),
        (lambda data: data[:20], "found damaged bytes"),
        (lambda data: data[:-9], "found damaged bytes"),
        (lambda data: data[:200] + b"??" + data[202:], "found damaged bytes"),
    ],
)
def test_other_versions_and_damage_are_rejected(change: Callable[[bytes], bytes], text: str) -> None:
    """The error is a DataError; wrong numbers are never returned."""
    data = pack(bins_from(simulated("N=1", 500, 78)))
    with pytest.raises(DataError, match=text):
        unpack(change(data))
