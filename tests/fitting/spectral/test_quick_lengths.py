"""Tests of the omission of samples at the end, which gives the transform a fast length."""

import numpy as np
import pytest

from imucal.allan.dct import fast_length
from imucal.clock import Clock
from imucal.fitting.spectral import blocks
from imucal.fitting.spectral.blocks import make_blocks
from imucal.recording import AxisSeries, Sensor
from tests.fitting.fits import fitted, simulated


@pytest.mark.parametrize("n", [131_071, 104_729])
def test_results_at_a_fast_length_agree_with_all_samples(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At prime lengths, the largest difference is 0.02 standard errors."""
    samples = simulated("N=1 + K=1e-2", n, 91)
    quick = fitted(samples, "N + K")
    assert 0 < n - make_blocks(AxisSeries.from_samples(samples, rate_hz=1.0)).blocks[0].bins.n <= 1e-4 * n
    monkeypatch.setattr(blocks, "fast_length", lambda size: size)
    full = fitted(samples, "N + K")
    for key, error in zip(full.parameters, np.sqrt(np.diag(full.covariance)).tolist(), strict=True):
        one, other = quick[key].value, full[key].value
        assert one is not None
        assert other is not None
        assert abs(one - other) < 0.02 * error


def test_a_run_with_gaps_is_cut_on_its_grid() -> None:
    """Missing samples count towards the length, and samples after the cut are omitted."""
    n = 131_071
    keep = np.ones(n, dtype=np.bool_)
    keep[[100, 101, 70_000, n - 3]] = False
    clock = Clock.even(n, 1.0).keeping(keep)
    samples = simulated("N=1", n, 92)[keep]
    series = AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=samples, clock=clock)
    (block,) = make_blocks(series).blocks
    assert block.bins.n == fast_length(n) < n
    assert block.ordinates.size == block.bins.n - 1
    assert block.variance is not None
