"""Swapped sensors and axes that are copies of each other."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.screening.profile import Profile
from imucal.screening.resolution import excerpt
from imucal.screening.unit_check import gravity, swapped

#: White noise of two axes never correlates like this; a mixed-up column does.
_COPY = 0.999
#: Fewest samples to judge by.
_LEAST = 64


def check_swapped(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error when gravity is in the gyroscope and not in the accelerometer."""
    if not swapped(profiles):
        return ()
    gyro = gravity([p for p in profiles if p.series.sensor is Sensor.GYROSCOPE])
    accel = gravity([p for p in profiles if p.series.sensor is Sensor.ACCELEROMETER])
    return (
        Finding(
            level="error",
            code="swapped-sensors",
            text=(
                f"At rest the gyroscope shows {gyro:.3g}, as gravity would, and the accelerometer "
                f"{accel:.2g}: the two are swapped."
            ),
            advice="Name the columns or topics of each sensor when reading.",
        ),
    )


def check_duplicates(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each two axes that hold the same samples, up to sign, scale and offset."""
    findings = []
    for one, two in combinations(profiles, 2):
        if one.constant or two.constant or one.series.n != two.series.n or one.series.n < _LEAST:
            continue
        correlation = _correlation(one, two)
        if abs(correlation) > _COPY:
            sign = "the same samples" if correlation > 0 else "the same samples with the sign turned"
            findings.append(
                Finding(
                    level="error",
                    code="duplicate-axes",
                    text=f"{one.name} and {two.name} hold {sign} (correlation {correlation:.3f}).",
                    advice="Look at the choice of columns, or at the driver that fills them.",
                )
            )
    return tuple(findings)


def _correlation(one: Profile, two: Profile) -> float:
    """Return the correlation of the steps from sample to sample, over an excerpt."""
    products = np.zeros(3)
    for part in excerpt(one.series.n):
        x, y = np.diff(one.series.samples[part]), np.diff(two.series.samples[part])
        products += (x @ y, x @ x, y @ y)
    xy, xx, yy = products.tolist()
    return xy / (xx**0.5 * yy**0.5) if xx > 0 and yy > 0 else 0.0
