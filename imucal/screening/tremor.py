"""A hand that holds the IMU, or a machine that shakes it, from the first sample to the last."""

from collections.abc import Sequence

import numpy as np

from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.screening.profile import Profile
from imucal.screening.words import amount

#: The band of a hand, a walking person or an engine, in Hz.
_BAND_HZ = (0.5, 10.0)
#: Rate in it, in rad/s rms, that no gyroscope shows at rest: ten times what a poor one does.
_LOUD = 3e-3
#: The band's density must exceed that of the upper half of all frequencies by this: it is no white noise.
_COLOURED = 8.0


def check_tremor(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error when two axes of the gyroscope are shaken all the time.

    No quiet part is there to compare with, so this one check uses absolute figures.
    """
    shaken = [(p, rms) for p in profiles if p.series.sensor is Sensor.GYROSCOPE and (rms := _tremor(p))]
    if len(shaken) < 2:
        return ()
    worst, rms = max(shaken, key=lambda pair: pair[1])
    low, high = _BAND_HZ
    return (
        Finding(
            level="error",
            code="motion",
            text=(
                f"The IMU was not at rest: between {low:g} and {high:g} Hz {worst.name} moves by "
                f"{amount(rms, Sensor.GYROSCOPE)} rms, as in a hand or on a running machine."
            ),
            advice="Record again with the IMU on a firm, quiet surface; these figures are not its noise.",
        ),
    )


def _tremor(profile: Profile) -> float:
    """Return the rms rate in the band, in rad/s, where it is loud and coloured; else 0."""
    density = profile.density
    if density is None:
        return 0.0
    low, high = _BAND_HZ
    band = (density.frequency >= low) & (density.frequency <= high)
    upper = density.frequency > 0.5 * density.frequency[-1]
    if not band.any() or high > 0.5 * density.frequency[-1]:
        return 0.0
    rms = float(np.sqrt(2 * density.psd[band].sum() * density.spacing_hz))
    coloured = density.psd[band].mean() > _COLOURED * density.psd[upper].mean()
    return rms if rms > _LOUD and coloured else 0.0
