"""What samples reveal about their unit: gravity, the noise of gyroscopes, and the steps of converters."""

from imucal.units import G0

__all__ = [
    "GYRO_STEPS",
    "MAX_GYRO_NOISE",
    "STEP_TOLERANCE",
    "is_gravity_per_sample",
]

#: Noise of a gyroscope, in rad/s/sqrt(Hz), above which its unit is doubtful: 0.11 deg/s/sqrt(Hz), twice that
#: of
#: the noisiest sensors on sale (0.03 to 0.05).
MAX_GYRO_NOISE = 2e-3

#: InvenSense at 250 deg/s full range, in deg/s per count.
_INVENSENSE_STEP = 1 / 131
#: Bosch and others at 125 deg/s: full range over 15 bits.
_BOSCH_STEP = 125 / 32768
#: ST at 250 deg/s.
_ST_STEP = 8.75e-3
#: BNO055 in fusion mode.
_BNO_STEP = 1 / 16
#: Steps of common converters, in deg/s per count; other ranges differ by powers of two.
GYRO_STEPS = (
    *(_INVENSENSE_STEP * 2.0**k for k in range(-1, 4)),
    *(_BOSCH_STEP * 2.0**k for k in range(6)),
    *(_ST_STEP * 2.0**k for k in range(-1, 5)),
    _BNO_STEP,
)
#: Relative difference of equal steps; data sheets round 32.75 to 32.8 counts per deg/s.
STEP_TOLERANCE = 2e-3

#: Largest relative difference between gravity and increments of velocity times the rate.
_INCREMENT_TOLERANCE = 0.03


def is_gravity_per_sample(length: float, rate_hz: float) -> bool:
    """Return whether vectors of this length are gravity as increments of velocity, in m/s per sample."""
    return abs(length * rate_hz / G0 - 1) <= _INCREMENT_TOLERANCE
