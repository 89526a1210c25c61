"""A sensor model of a fleet as a Report: so that a fleet is exported and compared as a log is."""

from typing import Literal, TypeAlias, get_args

import numpy as np

from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.fleet_report.verdict import bound_name
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Source
from imucal.report.given import given_axis
from imucal.report.result import AxisReport, Report

FleetValue: TypeAlias = Literal["tolerance", "median"]


def fleet_as_report(fleet: Fleet, model: str | None = None, *, value: FleetValue = "tolerance") -> Report:
    """Return what a fleet says of a sensor model, in the form of the report of one log.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    model
        Name of the sensor model; may be left out where there is one.
    value
        Of each term: the ``tolerance`` bound, which is the number for the config of every unit, or the
        ``median`` unit with its interval.

    Raises
    ------
    ChoiceError
        If there is no such model, or several and none is named.
    DataError
        If the bound is asked for and there are fewer than three units.
    ValueError
        If `value` is unknown.
    """
    if value not in get_args(FleetValue):
        msg = f"value {value!r} is not one of {', '.join(get_args(FleetValue))}"
        raise ValueError(msg)
    found = fleet.model(model)
    if not found.terms:
        msg = f"{fleet.folder}: {found.title} has no numbers, expected logs that count; run the fleet again"
        raise DataError(msg)
    axes: dict[str, list[FleetTerm]] = {}
    for term in found.terms:
        axes.setdefault(term.name, []).append(term)
    of_units = f"fleet of {len(found.units)} units{f' of {found.name}' if found.name else ''}"
    what = f"{bound_name(found.terms[0])} tolerance bound" if value == "tolerance" else "median unit"
    seconds = sorted(log.seconds for log in found.logs if log.seconds and not log.left_out)
    duration = seconds[len(seconds) // 2] if seconds else 0.0
    return Report(
        source=Source(path=str(fleet.folder), format=f"{of_units}; every number is the {what}"),
        axes=tuple(
            _axis(
                found,
                terms[0],
                {term.term: _estimate(fleet, term, value, what) for term in terms if _is_shown(term)},
                duration,
                fleet=fleet,
            )
            for terms in axes.values()
        ),
        settings={"fleet": str(fleet.folder), "model": found.name, "value": value},
        version=fleet.version,
    )


def _axis(
    model: SensorModel, term: FleetTerm, estimates: dict[str, Estimate], duration: float, *, fleet: Fleet
) -> AxisReport:
    missing = [symbol for symbol in ALWAYS if symbol not in estimates]
    if missing:
        msg = (
            f"{fleet.folder}: {term.name} of {model.title} has no {', '.join(missing)}, expected "
            f"{', '.join(ALWAYS)}; run the fleet with --model 'N + B + K'"
        )
        raise DataError(msg)
    return given_axis(
        term.sensor,
        term.axis,
        tuple(estimates.values()),
        rate_hz=model.rate_hz,
        duration_s=duration,
        method="fleet",
    )


def _estimate(fleet: Fleet, term: FleetTerm, value: FleetValue, what: str) -> Estimate:
    found = term.population
    if value == "median" and found.bounded:
        return Estimate.bounded(term.term, term.symbol, found.median.high)
    if value == "median":
        limits = found.median.value, found.median.low, found.median.high
    elif found.tolerance is None or found.quantile is None:
        msg = (
            f"{fleet.folder}: found {len(found.units)} units, expected 3 at least for a tolerance bound; "
            "take the median, or test more units: 10 are worth testing"
        )
        raise DataError(msg)
    else:
        limits = found.tolerance, min(found.quantile, found.tolerance), found.tolerance
    middle, low, high = limits
    return Estimate(
        key=term.term,
        symbol=term.symbol,
        status="estimated",
        value=middle,
        low=low,
        high=high,
        correlation_time=_correlation_time(term) if TERMS[term.symbol].repeatable else None,
        origin=f"{what} of {len(found.units)} units" if value == "tolerance" else "",
    )


def _is_shown(term: FleetTerm) -> bool:
    """Return whether a term is always there, or some log shows it: a bounded Gauss-Markov term is none."""
    return not TERMS[term.symbol].repeatable or any(log.value for log in term.logs)


def _correlation_time(term: FleetTerm) -> Interval:
    """Return the median of the logs' correlation times, and where 95 % of them lie."""
    times = [log.correlation_time for log in term.logs if log.value and log.correlation_time]
    low, value, high = np.exp(np.quantile(np.log(times), (0.025, 0.5, 0.975))).tolist()
    return Interval(value=value, low=low, high=high)
