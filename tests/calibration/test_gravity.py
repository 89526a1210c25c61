"""Gravity and the earth's rotation."""

import math

import pytest

from imucal.calibration.gravity import EARTH_RATE, earth_rate, gravity_at
from imucal.errors import ArgumentError


@pytest.mark.parametrize(("latitude", "normal"), [(0.0, 9.7803253359), (90.0, 9.8321849379)])
def test_normal_gravity_is_that_of_wgs84(latitude: float, normal: float) -> None:
    """Values published with the ellipsoid: equator and pole."""
    found = gravity_at(latitude=latitude)
    assert found.value == pytest.approx(normal, abs=2e-8)
    assert (found.sigma, found.origin) == (5e-4, "latitude")


def test_height_reduces_gravity() -> None:
    """By 3.086e-6 m/s² per m."""
    assert gravity_at(latitude=47.0, height=1000.0).value == pytest.approx(
        gravity_at(latitude=47.0).value - 3.086e-3
    )


def test_given_and_unknown_gravity() -> None:
    """A given value is exact; without any information the standard value has a deviation of 0.015."""
    assert gravity_at(gravity=9.81744, latitude=3.0).sigma == 0
    assert gravity_at().origin == "unknown"
    assert gravity_at().sigma == 0.015


@pytest.mark.parametrize(("gravity", "latitude"), [(1.0, None), (None, 91.0)])
def test_impossible_places_are_refused(gravity: float | None, latitude: float | None) -> None:
    """Gravity in g, and a latitude beyond the pole."""
    with pytest.raises(ArgumentError, match="expected"):
        gravity_at(gravity=gravity, latitude=latitude)


def test_earth_rate_has_its_length() -> None:
    """Vertical² + 2 horizontal² is its square; without a latitude the horizontal is the largest."""
    rate = earth_rate(47.4)
    assert math.sqrt(rate.vertical**2 + 2 * rate.horizontal_sigma**2) == pytest.approx(EARTH_RATE)
    assert rate.vertical_sigma == 0
    unknown = earth_rate(None)
    assert unknown.vertical == 0
    assert unknown.vertical_sigma == pytest.approx(EARTH_RATE / math.sqrt(2))
    assert unknown.horizontal_sigma == pytest.approx(earth_rate(0.0).horizontal_sigma)
    assert earth_rate(-30.0).vertical == pytest.approx(-EARTH_RATE / 2)
