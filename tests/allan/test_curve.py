"""Tests of AllanCurve: checks, confidence intervals and the minimum."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import AllanCurve


def _curve(avar: list[float], edf: list[float]) -> AllanCurve:
    m = 2 ** np.arange(len(avar))
    return AllanCurve(tau=m / 100.0, m=m, avar=np.array(avar), edf=np.array(edf), n=0)


@pytest.mark.parametrize("level", [0.68, 0.95])
def test_intervals_have_the_nominal_coverage(level: float) -> None:
    """The estimates scatter like chi-squared about a variance of 1."""
    k, edf = 20_000, 20.0
    avar = np.random.default_rng(65).chisquare(edf, k) / edf
    curve = AllanCurve(tau=np.arange(1.0, k + 1), m=np.arange(1, k + 1), avar=avar, edf=np.full(k, edf), n=0)
    low, high = curve.confidence_interval(level)
    covered = np.mean((low <= 1) & (high >= 1))
    # Three standard errors of a proportion.
    assert covered == pytest.approx(level, abs=3 * np.sqrt(level * (1 - level) / k))


def test_limits_are_chi_squared_quantiles() -> None:
    """With 10 degrees of freedom, the 97.5 and 2.5 % quantiles are 20.483 and 3.247."""
    low, high = _curve([4.0], [10.0]).confidence_interval(0.95)
    npt.assert_allclose(low**2, 40 / 20.4832, rtol=1e-5)
    npt.assert_allclose(high**2, 40 / 3.24697, rtol=1e-5)


def test_one_degree_of_freedom_has_an_interval() -> None:
    """The interval of a single difference is wide; an unknown edf has none."""
    low, high = _curve([1.0, 1.0], [1.0, np.nan]).confidence_interval(0.95)
    assert 0 < low[0] < 1 < high[0] < 40
    assert np.isnan(low[1])
    assert np.isnan(high[1])


def test_the_minimum_ignores_uncertain_values() -> None:
    """A dip with fewer than 2 degrees of freedom is chance, unless all values have fewer."""
    assert _curve([4.0, 1.0, 2.0, 0.01], [90, 40, 20, 1.2]).minimum == (1.0, 0.02)
    assert _curve([4.0, 1.0], [1.0, 1.0]).minimum == (1.0, 0.02)
    assert _curve([4.0, 1.0], [np.nan, np.nan]).minimum == (1.0, 0.02)


def test_arrays_are_read_only_and_of_one_shape() -> None:
    curve = _curve([1.0, 2.0], [9.0, 4.0])
    for name in ("tau", "m", "avar", "edf"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(curve, name)[0] = 7
    with pytest.raises(ValueError, match="must share one shape"):
        AllanCurve(tau=np.ones(1), m=np.ones(2, int), avar=np.ones(1), edf=np.ones(1), n=0)
    with pytest.raises(ValueError, match="tau must increase"):
        AllanCurve(tau=np.ones(2), m=np.ones(2, int), avar=np.ones(2), edf=np.ones(2), n=0)


@pytest.mark.parametrize("level", [0.0, 1.0, -1.0, 95.0])
def test_an_invalid_level_is_rejected(level: float) -> None:
    """A level of 95 is an error, because 0.95 is expected."""
    with pytest.raises(ValueError, match=f"level must be between 0 and 1, got {level}"):
        _curve([1.0], [1.0]).confidence_interval(level)
