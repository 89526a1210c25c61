"""Tests of the completion of scattered missing samples."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.fft import dct

from imucal.allan.dct import dct_bins
from imucal.fitting.spectral.disturbances import gaps
from imucal.fitting.spectral.disturbances.gaps import _conjugate, _groups, _Pairs, _precision, complete


def test_conjugate_gradients_solve_the_system() -> None:
    """On a well-conditioned matrix, the residual is below the requested fraction of the noise."""
    rng = np.random.default_rng(1)
    matrix = np.eye(30) + 0.1 * np.cov(rng.standard_normal((30, 60)))
    right = rng.standard_normal(30)
    found = _conjugate(lambda x: matrix @ x, right, 1.0)
    npt.assert_allclose(matrix @ found, right, atol=5e-3)


def test_missing_samples_are_estimated_from_their_neighbours() -> None:
    """A smooth signal is filled to 5 % of its deviation, and observed samples do not change."""
    n = 512
    signal = np.cumsum(np.cumsum(np.random.default_rng(2).standard_normal(n))) / 50
    seen = np.ones(n, dtype=bool)
    seen[20:500:17] = False
    ordinates, _, loss, drawn = complete(np.where(seen, signal, 1e9), seen, dct_bins(n))
    filled = np.concatenate([[0.0], ordinates])
    transform = dct(np.eye(n), axis=0, norm="ortho")
    back = transform.T @ filled
    npt.assert_allclose(back - back.mean(), signal - signal.mean(), atol=0.05 * signal.std())
    assert np.all((loss >= 0) & (loss < 1))
    assert drawn.shape == (np.count_nonzero(~seen),)
    npt.assert_allclose(drawn, signal[~seen], atol=0.2 * signal.std())


def test_white_noise_loses_the_missing_share_of_information() -> None:
    """A fifth of the samples is missing, so the bins lose a fifth of their information."""
    rng = np.random.default_rng(3)
    seen = rng.random(20_000) > 0.2
    ordinates, variance, loss, drawn = complete(rng.standard_normal(20_000), seen, dct_bins(20_000))
    assert np.median(loss[200:]) == np.clip(np.median(loss[200:]), 0.15, 0.25)
    # The mean square of the completed ordinates is 1 within four standard errors.
    assert abs(np.mean(ordinates**2 + variance) - 1) < 4 * np.sqrt(2 / 16_000)
    # A draw has the variance of a missing sample; the limit is four standard errors of 4000 samples.
    assert abs(np.mean(drawn**2) - 1) < 4 * np.sqrt(2 / 4000)


@pytest.mark.parametrize("direct", [0.0, 1e9])
def test_the_precision_of_missing_samples_agrees_with_its_definition(
    direct: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the missing block of C' diag(w) C, computed by cosine sums or by transforms."""
    monkeypatch.setattr(gaps, "_DIRECT", direct)
    n, missing = 400, np.array([0, 1, 57, 58, 59, 200, 399])
    groups = _groups(dct_bins(n))
    weight = np.random.default_rng(1310).uniform(0.1, 5.0, groups.size)
    each = np.append(0.0, np.repeat(weight, np.diff(groups, append=n - 1)))
    transform = dct(np.eye(n), axis=0, norm="ortho")
    block = (transform.T @ (each[:, np.newaxis] * transform))[np.ix_(missing, missing)]
    pairs = _Pairs.of(missing, n, groups)
    assert (pairs is None) == (direct == 0)
    apply = _precision(missing, pairs, weight, groups, n)
    found = np.stack([apply(unit) for unit in np.eye(missing.size)], axis=1)
    npt.assert_allclose(found, block, atol=1e-13 * np.abs(block).max())


def test_few_and_many_missing_samples_are_completed_equally(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of cosines and transforms give the same expectation, also for the first and the last sample."""
    rng = np.random.default_rng(1311)
    samples = rng.standard_normal(5000) + 0.01 * np.cumsum(rng.standard_normal(5000))
    seen = np.ones(5000, dtype=bool)
    for part in (slice(0, 2), slice(1000, 1007), slice(4999, 5000)):
        seen[part] = False
    found = []
    for direct in (0.0, 1e9):
        monkeypatch.setattr(gaps, "_DIRECT", direct)
        found.append(complete(samples.copy(), seen, dct_bins(5000)))
    for one, other in zip(*found, strict=True):
        npt.assert_allclose(one, other, atol=1e-12 * np.abs(other).max())
