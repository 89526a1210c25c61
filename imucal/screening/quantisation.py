"""Is the LSB fine enough for the noise."""

from imucal.findings import Finding
from imucal.screening.profile import Profile
from imucal.screening.words import amount

#: Noise below this many LSB no longer dithers the rounding: N can't be corrected by LSB^2/12 any more.
_COARSE = 0.5


def check_lsb(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding where the noise is below half an LSB.

    Rounding adds LSB²/12 to the variance of well-dithered noise (Sheppard's correction); it is
    taken off before comparing.
    """
    lsb, series = profile.lsb, profile.series
    if lsb is None or not profile.noise**2 < lsb**2 * (_COARSE**2 + 1 / 12):
        return ()
    noise = max(0.0, profile.noise**2 - lsb**2 / 12) ** 0.5
    figure = f"about {noise / lsb:.1f}" if noise > 0.2 * lsb else "less than 0.2"
    return (
        Finding(
            level="warning",
            code="coarse-lsb",
            text=(
                f"The steps of {series.name}, {amount(lsb, series.sensor)}, are coarse: its noise is "
                f"{figure} LSB, and rounding distorts N and hides slow changes."
            ),
            advice="Choose a smaller range of the sensor, log more digits, or average less before logging.",
            axis=series.name,
        ),
    )
