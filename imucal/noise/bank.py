"""Flicker as a bank of Gauss-Markov terms, for filters that know no flicker.

Terms whose correlation times are spaced evenly on a logarithmic scale by a ratio r, each of
variance B^2 ln(r)/pi, have together the spectrum of flicker B between their shortest and longest
correlation time.

Source: Keshner (1982), "1/f noise", Proc. IEEE 70, 212; the variance follows from the integral of
sigma^2 2T / (1 + (wT)^2) over ln T.
"""

import math

from imucal.noise.terms import GaussMarkov


def gauss_markov_bank(
    B: float, t_min: float, t_max: float, per_decade: float = 2.0
) -> tuple[GaussMarkov, ...]:
    """Return Gauss-Markov terms that together are flicker of bias instability `B`.

    Parameters
    ----------
    B
        Bias instability, in U.
    t_min, t_max
        Shortest and longest correlation time, in s. The density is that of flicker between
        1/(2 pi t_max) and 1/(2 pi t_min), a factor of about 3 inside each; for samples at tau0,
        t_min = tau0 / 2 serves up to the Nyquist frequency.
    per_decade
        Correlation times a decade: the density ripples by 5.5 % at 1, 0.65 % at 1.5, 0.08 % at 2.

    Raises
    ------
    ValueError
        If the times don't rise, or `B` or `per_decade` is not positive.
    """
    if not (0 < t_min < t_max and B > 0 and per_decade > 0):
        msg = f"need 0 < t_min < t_max, B > 0 and per_decade > 0, got {t_min}, {t_max}, {B}, {per_decade}"
        raise ValueError(msg)
    steps = math.ceil(math.log10(t_max / t_min) * per_decade - 1e-9)
    step = math.log(10) / per_decade
    sigma = B * math.sqrt(step / math.pi)
    return tuple(GaussMarkov(sigma=sigma, T=t_min * math.exp(i * step)) for i in range(steps + 1))
