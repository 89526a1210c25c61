"""Tests of the power response of the Allan variance."""

import numpy as np
import numpy.testing as npt

from imucal.allan.dct import dct_bins
from imucal.allan.intervals import power_response


def test_single_ordinates_have_the_published_response() -> None:
    """NIST SP 1065, eq. 65, for sampled data: 2 sin(m w/2)^4 / (m sin(w/2))², and its square."""
    bins, m = dct_bins(2000), 3
    half = bins.omega[:100] / 2
    expected = 2 * np.sin(m * half) ** 4 / (m * np.sin(half)) ** 2
    response, squared = power_response(bins, m)
    npt.assert_allclose(response[:100], expected, rtol=1e-9)
    npt.assert_allclose(squared[:100], expected**2, rtol=1e-9)


def test_wide_bins_have_the_mean_of_their_ripples() -> None:
    """The reference is a grid that is fine enough for every ripple, for the response and its square."""
    bins, m = dct_bins(400_000), 40_000
    at = bins.size - 40
    grid = np.pi / bins.n * np.linspace(bins.first[at], bins.first[at] + bins.count[at], 400_001)
    ripple = (2 * np.sin(m * grid / 2)) ** 4
    tail = (2 * np.sin(bins.omega[at] / 2)) ** -2 / (2 * m**2)
    response, squared = power_response(bins, m)
    # The bin contains about 200 ripples, one of which may be truncated.
    npt.assert_allclose(response[at], ripple.mean() * tail, rtol=0.01)
    npt.assert_allclose(squared[at], (ripple**2).mean() * tail**2, rtol=0.01)
