"""Tests of the method slope, which estimates terms from the slopes of the curve."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.fitting import FitSettings, fit
from imucal.fitting.moments import fit_slope
from tests.fitting.moments.curves import simulated_curve


def test_lines_are_found_at_their_averaging_times() -> None:
    """N is found at short times and K at long times, and the settings contain both windows."""
    curve = simulated_curve("N=1 + K=0.01", 1_000_000, np.random.default_rng(41))
    fit = fit_slope(None, curve, FitSettings())
    assert str(fit.model) == "N + K"
    assert fit.method == "slope"
    assert fit["N"].value == pytest.approx(1, rel=0.02)
    assert fit["K"].value == pytest.approx(0.01, rel=0.25)
    assert fit["B"].status == "bounded"
    windows = fit.settings["windows"]
    assert isinstance(windows, dict)
    assert windows["N"][0] == 1.0
    assert windows["K"][0] > windows["N"][1]
    assert fit.parameters == ("N", "K")
    assert fit.covariance.shape == (2, 2)


def test_b_is_the_floor_divided_by_its_exact_level() -> None:
    """For flicker plus white noise, the floor over 0.664 is B, and the interval allows for N."""
    curve = simulated_curve("N=1 + B=0.2", 500_000, np.random.default_rng(42))
    fit = fit_slope(None, curve, FitSettings())
    estimate = fit["B"]
    assert estimate.value is not None
    assert estimate.value == pytest.approx(0.2, rel=0.1)
    assert estimate.low < 0.2 < estimate.high


def test_given_windows_are_used() -> None:
    """White noise of 1 is fitted between 4 and 64 s."""
    curve = simulated_curve("N=1", 50_000, np.random.default_rng(43))
    fit = fit_slope(None, curve, FitSettings(model="N"), windows={"N": (4, 64)})
    assert fit.settings["windows"] == {"N": [4.0, 64.0]}
    npt.assert_array_equal(fit.curve.tau[fit.used], [4, 8, 16, 32, 64])
    found = fit_slope(None, curve, FitSettings(model="N"))
    assert found["N"].high - found["N"].low < fit["N"].high - fit["N"].low


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "n"),
    [
        ("N=1 + K=1e-2", 20_000),
        ("Q=3 + N=1 + K=3e-3", 50_000),
        ("N=1 + B=0.2", 50_000),
        ("N=1 + R=1e-4", 20_000),
    ],
)
def test_intervals_have_the_nominal_coverage(text: str, n: int) -> None:
    """In 25 records, 95 % intervals cover the truth in at least 82 % (three standard errors are 13 %).

    An absent term has the truth 0, which only a bound covers, so a false B or K is a miss.
    """
    truth = dict.fromkeys("NBK", 0.0)
    truth |= {part.split("=")[0].strip(): float(part.split("=")[1]) for part in text.split("+")}
    rng = np.random.default_rng(44)
    hits: dict[str, list[bool]] = {key: [] for key in truth}
    for _ in range(25):
        fit = fit_slope(None, simulated_curve(text, n, rng), FitSettings())
        for estimate in fit.estimates:
            if estimate.key in truth:
                hits[estimate.key].append(estimate.low <= truth[estimate.key] <= estimate.high)
    for key, hit in hits.items():
        assert np.mean(hit) >= 0.82, key


def test_the_minimum_of_n_and_k_is_not_flicker() -> None:
    """White noise and a random walk form a minimum; at most 1 of 12 records reports B."""
    rng = np.random.default_rng(45)
    fits = [fit_slope(None, simulated_curve("N=1 + K=1e-2", 100_000, rng), FitSettings()) for _ in range(12)]
    assert sum(fit["B"].status == "estimated" for fit in fits) <= 1


def test_a_rescaled_curve_only_rescales_the_estimates() -> None:
    curve = simulated_curve("N=1 + K=0.01", 100_000, np.random.default_rng(46))
    small = type(curve)(tau=curve.tau, m=curve.m, avar=curve.avar * 1e-18, edf=curve.edf, n=curve.n)
    one, other = fit_slope(None, curve, FitSettings()), fit_slope(None, small, FitSettings())
    for a, b in zip(one.estimates, other.estimates, strict=True):
        npt.assert_allclose((b.low, b.high), (a.low * 1e-9, a.high * 1e-9), rtol=1e-9)


def test_gauss_markov_terms_and_empty_windows_are_rejected() -> None:
    curve = simulated_curve("N=1", 1000, np.random.default_rng(47))
    with pytest.raises(ValueError, match=r"^method 'slope' can't fit GM"):
        fit(curve, method="slope", model="N + GM")
    with pytest.raises(
        ValueError,
        match=r"^window of N: .* 0\.1 and 0\.5 s; the curve has 1 to 128 s",
    ):
        fit_slope(None, curve, FitSettings(model="N"), windows={"N": (0.1, 0.5)})


def test_the_covariance_follows_from_the_weights_of_the_points() -> None:
    """A relative standard error equals half the logarithmic width of a 1-sigma interval."""
    curve = simulated_curve("N=1 + K=0.01", 100_000, np.random.default_rng(48))
    found = fit_slope(None, curve, FitSettings(model="N + K", level=0.6826894921))
    deviation = np.sqrt(np.diag(found.covariance))
    assert found.parameters == ("N", "K")
    for name, sigma in zip(found.parameters, deviation.tolist(), strict=True):
        estimate = found[name]
        assert estimate.value is not None
        assert sigma / estimate.value == pytest.approx(np.log(estimate.high / estimate.value), rel=1e-6)
    # Points far apart share little noise.
    assert abs(found.correlation[0, 1]) < 0.2
