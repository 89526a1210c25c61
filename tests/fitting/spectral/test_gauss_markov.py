"""Tests of the Gauss-Markov term in the DCT domain."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.fft import dct

from imucal.noise.term import gauss_markov_dct


@pytest.mark.parametrize("time", [0.5, 3.0, 40.0, 1000.0, 1e6])
def test_the_expectation_agrees_with_the_dense_covariance(time: float) -> None:
    """E[X_k²] is the diagonal of C R C' for the AR1 covariance R, for any T/n."""
    n = 64
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    transform = dct(np.eye(n), axis=0, norm="ortho")
    dense = np.diag(transform @ np.exp(-lags / time) @ transform.T)[1:]
    k = np.arange(1, n)
    found, _ = gauss_markov_dct(
        np.full((1, 1), np.log(time)),
        4 * np.sin(np.pi * k / (2 * n)) ** 2,
        np.full(n - 1, float(n)),
        np.where(k % 2 == 0, 1.0, -1.0),
    )
    # The dense sum cancels where the process is nearly constant: 1e-14 of the variance.
    npt.assert_allclose(found[0], dense, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("time", [0.7, 20.0, 5000.0])
def test_slope_is_the_derivative_in_log_time(time: float) -> None:
    """The reference is a central difference of the expectation."""
    n, step = 256, 1e-5
    k = np.arange(1, n)
    lam = 4 * np.sin(np.pi * k / (2 * n)) ** 2
    logs = np.log(time) + np.array([[-step], [0.0], [step]])
    value, slope = gauss_markov_dct(logs, lam, np.full(n - 1, float(n)), np.where(k % 2 == 0, 1.0, -1.0))
    numeric = (value[2] - value[0]) / (2 * step)
    npt.assert_allclose(slope[1], numeric, rtol=1e-5, atol=1e-8 * np.abs(value[1]).max())
