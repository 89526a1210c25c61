"""Tests of the search for a high-pass filter."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from imucal.arrays import FloatArray
from imucal.fitting.spectral.blocks import make_blocks
from imucal.fitting.spectral.disturbances.high_pass import find_high_pass
from imucal.recording import AxisSeries
from tests.fitting.fits import fitted
from tests.screening.still import KINDS, flicker


def filtered(corner_hz: float, seed: int, order: int = 1) -> FloatArray:
    """Return 10 min at 100 Hz of N = 0.1 and some flicker, behind a filter."""
    rng = np.random.default_rng([9, seed])
    noise = rng.standard_normal(60_000) + 0.05 * flicker(60_000, rng)
    return np.asarray(lfilter(*butter(order, corner_hz / 50, "high"), noise))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("corner_hz", [0.1, 1.0])
def test_a_high_pass_is_named_and_n_is_right(corner_hz: float, order: int) -> None:
    """B and K are bounded only, because the fit starts above the corner."""
    fit = fitted(filtered(corner_hz, 1, order), rate_hz=100.0)
    (finding,) = (finding for finding in fit.findings if finding.code == "high-pass")
    assert (finding.level, finding.axis) == ("warning", "gyro_x")
    # Three standard errors.
    assert fit["N"].value == pytest.approx(0.1, rel=0.012)
    assert fit["B"].low == fit["K"].low == 0


def vibration(n: int, rng: np.random.Generator) -> FloatArray:
    noise = lfilter(*butter(2, (0.02, 0.3), "band"), rng.standard_normal(n))
    return np.asarray(rng.standard_normal(n) + 4 * noise)


def rounding(n: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(np.diff(rng.standard_normal(n + 1)) + 0.02 * rng.standard_normal(n))


@pytest.mark.parametrize("kind", [*KINDS, "vibration", "rounding"])
def test_noise_without_a_high_pass_has_none(kind: str) -> None:
    """Ten records of each kind."""
    draw = {**KINDS, "vibration": vibration, "rounding": rounding}[kind]
    for seed in range(10):
        samples = draw(20_000, np.random.default_rng([10, seed]))
        blocks = make_blocks(AxisSeries.from_samples(samples, rate_hz=100.0))
        assert find_high_pass(blocks.binned()) is None
