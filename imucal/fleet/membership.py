"""Is a new unit one of a fleet's? Its coefficient against where the next unit lies."""

from collections.abc import Sequence

import numpy as np

from imucal.fleet.log_value import LogValue, LogValues
from imucal.fleet.posterior import whole_posterior
from imucal.fleet.unit_likelihood import place_of

#: Fewer units tell no spread.
FEWEST = 3


def membership(logs: Sequence[LogValue], new: LogValue) -> float:
    """Return the two-sided chance that a unit of this fleet gives a log like a new one.

    The spread between units, the scatter between logs of a unit and the error of the new log are all in it,
    and how badly the first two are known.

    Parameters
    ----------
    logs
        Of the fleet, of three units at least.
    new
        What the new log says.

    Raises
    ------
    ValueError
        If there are fewer than three units.
    """
    values = LogValues.of(logs)
    if len(values.names) < FEWEST:
        msg = f"a spread between units needs {FEWEST} units at least, got {len(values.names)}"
        raise ValueError(msg)
    posterior = whole_posterior(values, place_of(values))
    one = LogValues.of([new])
    if one.narrow.all():
        return posterior.p_value(*one.unit_centre(0, posterior.omega.ravel()))
    omega = float(posterior.quantiles(posterior.omega, [0.5])[0])
    return float(posterior.p_values(one.squares(), np.array([omega]))[0])
