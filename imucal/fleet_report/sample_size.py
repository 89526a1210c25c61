"""What more units would buy: how far a tolerance bound lies above the quantile that it bounds.

Where units are known well, the bound is k deviations above the mean in the logarithm, and the quantile z:
Krishnamoorthy & Mathew (2009), Statistical Tolerance Regions, eq. (2.2.3): k is a quantile of the noncentral
t law. Exp(tau (k - z)) is the price of having tested n units only.
"""

import math

from imucal.fleet.population import Population

#: The bound that is near enough, and the most units that are thought of.
NEAR = 1.1
_MOST = 10_000


def tolerance_excess(units: int, spread: float, *, content: float = 0.95, confidence: float = 0.95) -> float:
    """Return the median bound of `units` units over the quantile that it bounds.

    Parameters
    ----------
    units
        At least 2.
    spread
        Standard deviation between units, in the logarithm.
    content, confidence
        Of the bound.
    """
    from scipy.special import nctdtrit, ndtri

    z = float(ndtri(content))
    root = math.sqrt(units)
    factor = float(nctdtrit(units - 1, z * root, confidence)) / root
    return math.exp(spread * (factor - z))


def prices(found: Population) -> tuple[tuple[int, float], ...]:
    """Return numbers of units with what they cost: these, twice as many, and those that come near enough.

    Empty where the spread between units is not known.
    """
    if found.spread is None:
        return ()
    tau, n = found.spread.value, len(found.units)

    def excess(units: int) -> float:
        return tolerance_excess(units, tau, content=found.content, confidence=found.confidence)

    wanted = {n, 2 * n}
    if excess(n) > NEAR >= excess(_MOST):
        low, high = n, _MOST
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if excess(middle) <= NEAR else (middle, high)
        wanted.add(high)
    return tuple((units, excess(units)) for units in sorted(wanted))
