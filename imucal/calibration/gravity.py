"""Gravity and the earth's rotation at a place, with their uncertainty."""

import math
from dataclasses import dataclass

from imucal.errors import ArgumentError

__all__ = ["EARTH_RATE", "EarthRate", "Gravity", "earth_rate", "gravity_at"]

#: Standard gravity, and its deviation over the inhabited earth, in m/s².
_STANDARD, _ANYWHERE = 9.80665, 0.015
#: Deviation from the normal formula, in m/s².
_ANOMALY = 5e-4
#: WGS 84: equatorial gravity, Somigliana's constant, first eccentricity squared, free-air gradient in 1/s².
_EQUATOR, _K, _E2, _FREE_AIR = 9.7803253359, 0.00193185265241, 0.00669437999013, 3.086e-6
#: Rotation of the earth, in rad/s.
EARTH_RATE = 7.292115e-5


@dataclass(frozen=True, kw_only=True)
class Gravity:
    """Length of gravity and its standard deviation, in m/s²; `origin` is `given`, `latitude` or `unknown`."""

    value: float
    sigma: float
    origin: str


@dataclass(frozen=True, kw_only=True)
class EarthRate:
    """The earth's rotation about the vertical, in rad/s, its deviation, and that of each horizontal axis."""

    vertical: float
    vertical_sigma: float
    horizontal_sigma: float


def gravity_at(
    *, gravity: float | None = None, latitude: float | None = None, height: float | None = None
) -> Gravity:
    """Return gravity: as given, by WGS 84 at a latitude in degrees and a height in m, or the standard value.

    An impossible gravity or latitude raises an ArgumentError.

    Source: NIMA TR8350.2 (2000), equation 4-1 (Somigliana), with the free-air gradient.
    """
    if gravity is not None:
        if not 9.0 < gravity < 10.5:
            raise ArgumentError(f"gravity is {gravity} m/s²; expected 9.76 to 9.84 on the earth's surface")
        return Gravity(value=gravity, sigma=0.0, origin="given")
    if latitude is None:
        return Gravity(value=_STANDARD, sigma=_ANYWHERE, origin="unknown")
    if not -90 <= latitude <= 90:
        raise ArgumentError(f"latitude is {latitude}; expected degrees from -90 to 90")
    s2 = math.sin(math.radians(latitude)) ** 2
    normal = _EQUATOR * (1 + _K * s2) / math.sqrt(1 - _E2 * s2)
    return Gravity(value=normal - _FREE_AIR * (height or 0.0), sigma=_ANOMALY, origin="latitude")


def earth_rate(latitude: float | None) -> EarthRate:
    """Return the earth's rotation at a latitude in degrees; without one, only its deviation."""
    if latitude is None:
        share = EARTH_RATE / math.sqrt(2)
        # The deviation must be large enough at the equator too.
        return EarthRate(vertical=0.0, vertical_sigma=share, horizontal_sigma=share)
    phi = math.radians(latitude)
    horizontal = EARTH_RATE * math.cos(phi) / math.sqrt(2)
    return EarthRate(vertical=EARTH_RATE * math.sin(phi), vertical_sigma=0.0, horizontal_sigma=horizontal)
