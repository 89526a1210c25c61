"""Tests of the noise of block means against a slow likelihood, and its recovery behind a curve."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.temperature.ramp import AxisBlocks, Ramp
from imucal.temperature.slow_noise import BlockNoise
from tests.temperature.ramps import known_ramp


def blocks(noise: str, seed: int, shape: str = "none") -> tuple[AxisBlocks, Ramp]:
    ramp = known_ramp(shape, np.random.default_rng(seed), noise=noise)
    found = Ramp.of(ramp.recording)
    return AxisBlocks.of(ramp.recording.series[0], found), found


def restricted(covariance: FloatArray, samples: FloatArray, columns: FloatArray) -> float:
    """Return the restricted log-likelihood by its textbook formula, less a constant."""
    inverse = np.linalg.inv(covariance)
    information = columns.T @ inverse @ columns
    beta = np.linalg.solve(information, columns.T @ inverse @ samples)
    rest = samples - columns @ beta
    logs = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return float(-0.5 * (logs + rest @ inverse @ rest))


def test_the_variances_have_the_highest_restricted_likelihood() -> None:
    """No neighbour is more likely by the textbook formula with an explicit covariance."""
    axis, ramp = blocks("N=1e-4 + K=2e-6", 81)
    noise = BlockNoise.of(axis, ramp.block_s)
    columns = np.vander(ramp.temperature[axis.places] / 50, 3)
    variances = noise.variances(axis.means, columns)
    best = restricted(noise.covariance(variances), axis.means, columns)
    for term in range(3):
        for factor in (0.7, 1.4):
            other = variances.copy()
            other[term] = max(other[term], 1e-3 * variances.max()) * factor
            assert restricted(noise.covariance(other), axis.means, columns) < best + 1e-3


def test_white_noise_is_that_of_the_samples() -> None:
    """The variance of a block is that of a sample over their number."""
    axis, ramp = blocks("N=1e-4", 82)
    noise = BlockNoise.of(axis, ramp.block_s)
    variances = noise.variances(axis.means, np.ones((axis.means.size, 1)))
    expected = 1e-4**2 / ramp.block_s
    assert variances[0] == pytest.approx(expected, rel=0.3)
    assert axis.white_variance / axis.counts.mean() == pytest.approx(expected, rel=0.1)


def test_a_walk_is_found_behind_a_curve() -> None:
    """Regressors do not lower the estimate: the restricted likelihood allows for them."""
    found = []
    for seed in range(83, 93):
        axis, ramp = blocks("N=1e-5 + K=2e-6", seed, "cubic")
        noise = BlockNoise.of(axis, ramp.block_s)
        columns = np.vander((ramp.temperature[axis.places] - 25) / 35, 6)
        # A unit part is the structure over its largest value.
        walk = noise.variances(axis.means, columns)[2]
        found.append(walk / (2e-6**2 * ramp.block_s * (axis.places[-1] - axis.places[0])))
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)


def test_equal_samples_have_no_noise() -> None:
    """A constant axis has variances of zero, and no warning of a division."""
    axis, ramp = blocks("N=1e-4", 94)
    noise = BlockNoise.of(axis, ramp.block_s)
    assert noise.variances(np.full(axis.means.size, 3.0), np.ones((axis.means.size, 1))).tolist() == [0] * 3
