"""A sensor model of a fleet in the form of a log's `Report`, and the check of a log against the fleet."""

from dataclasses import asdict
from typing import Literal, TypeAlias, get_args

import numpy as np

from imucal.checking.verdict import Row, Verdict
from imucal.errors import DataError, Fix
from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit
from imucal.fleet.page import bound_name, sheet_unit
from imucal.fleet.population import MIN_UNITS, membership
from imucal.fleet.summary import Fleet, FleetTerm, SensorModel
from imucal.fleet.values import LogValue, log_values
from imucal.multiple_tests import holm
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Source
from imucal.report.given import given_axis
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report

FleetValue: TypeAlias = Literal["tolerance", "median"]
_VERDICTS: dict[Verdict, str] = {
    "pass": "as a unit of the fleet",
    "fail": "unlike the units of the fleet",
    "undecided": "the interval reaches beyond; record for longer to decide",
}


def fleet_as_report(fleet: Fleet, model: str | None = None, *, value: FleetValue = "tolerance") -> Report:
    """Return the values of a sensor model in the form of the report of one log.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    model
        Name of the sensor model; may be omitted if there is only one.
    value
        Of each term: the ``tolerance`` bound, which is the number for the config of every unit, or the
        ``median`` unit with its interval.

    Raises
    ------
    ChoiceError
        If there is no such model, or several and none is named.
    DataError
        If `value` is ``tolerance`` and there are fewer than three units.
    ValueError
        If `value` is unknown.
    """
    if value not in get_args(FleetValue):
        raise ValueError(f"value {value!r} is not one of {', '.join(get_args(FleetValue))}")
    found = fleet.model(model)
    if not found.terms:
        problem = f"{found.title} has no numbers, expected logs that count"
        raise DataError(problem, place=fleet.folder, fix=Fix("run the fleet again"))
    axes: dict[str, list[FleetTerm]] = {}
    for term in found.terms:
        axes.setdefault(term.name, []).append(term)
    of_units = f"fleet of {len(found.units)} units{f' of {found.name}' if found.name else ''}"
    what = f"{bound_name(found.terms[0])} tolerance bound" if value == "tolerance" else "median unit"
    return Report(
        source=Source(path=str(fleet.folder), format=f"{of_units}; every number is the {what}"),
        axes=tuple(_axis(fleet, found, terms, value, what) for terms in axes.values()),
        settings={"fleet": str(fleet.folder), "model": found.name, "value": value},
        version=fleet.version,
    )


def _axis(
    fleet: Fleet, model: SensorModel, terms: list[FleetTerm], value: FleetValue, what: str
) -> AxisReport:
    # Omit a Gauss-Markov term that no log shows.
    shown = (t for t in terms if not TERMS[t.symbol].repeatable or any(log.value for log in t.logs))
    estimates = {term.term: _estimate(fleet, term, value, what) for term in shown}
    if missing := [symbol for symbol in ALWAYS if symbol not in estimates]:
        lacking = (
            f"{terms[0].name} of {model.title} has no {', '.join(missing)}, expected {', '.join(ALWAYS)}"
        )
        raise DataError(lacking, place=fleet.folder, fix=Fix("run the fleet with --model 'N + B + K'"))
    seconds = sorted(log.seconds for log in model.logs if log.seconds and not log.left_out)
    return given_axis(
        *(terms[0].sensor, terms[0].axis, tuple(estimates.values())),
        rate_hz=model.rate_hz,
        duration_s=seconds[len(seconds) // 2] if seconds else 0.0,
        method="fleet",
    )


def _estimate(fleet: Fleet, term: FleetTerm, value: FleetValue, what: str) -> Estimate:
    found, time = term.population, None
    if value == "median" and found.bounded:
        return Estimate.bounded(term.term, term.symbol, found.median.high)
    if value == "tolerance" and (found.tolerance is None or found.quantile is None):
        few = f"found {len(found.units)} units, expected at least 3 for a tolerance bound"
        raise DataError(few, place=fleet.folder, fix=Fix("use the median, or test about 10 units"))
    limits = found.median
    if found.tolerance and found.quantile and value == "tolerance":
        bound, low = found.tolerance, min(found.quantile, found.tolerance)
        limits = Interval(value=bound, low=low, high=bound)
    if TERMS[term.symbol].repeatable:
        times = [log.correlation_time for log in term.logs if log.value and log.correlation_time]
        low, middle, high = np.exp(np.quantile(np.log(times), (0.025, 0.5, 0.975))).tolist()
        time = Interval(value=middle, low=low, high=high)
    return Estimate(
        key=term.term,
        symbol=term.symbol,
        status="estimated",
        **asdict(limits),
        correlation_time=time,
        origin=f"{what} of {len(found.units)} units" if value == "tolerance" else "",
    )


def check_fleet(
    report: Report, fleet: Fleet, model: str | None = None, *, alpha: float = 0.05
) -> tuple[Row, ...]:
    """Return a row for each common term of each axis: a comparison with the range of the next unit.

    A term passes if its whole interval is in this range. It fails if the probability of this difference in a
    unit of the model is below `alpha`, adjusted for all terms (Holm 1979). Other terms are undecided.

    Parameters
    ----------
    report
        The report of the log; fits with bins are repeated with the fleet's noise model.
    fleet, model
        The fleet, and the name of its sensor model.
    alpha
        Probability that a unit of the fleet fails.

    Raises
    ------
    ChoiceError
        If there is no such model, or several and none is named.
    DataError
        If there are fewer than three units, or no axis and term in common.
    """
    found = fleet.model(model)
    if len(found.units) < MIN_UNITS:
        few = f"found {len(found.units)} units of {found.title}, expected at least {MIN_UNITS}"
        problem = f"{few} to predict the next unit"
        raise DataError(problem, place=fleet.folder, fix=Fix("add units to the fleet"))
    common: list[tuple[FleetTerm, LogValue]] = []
    for axis in report.axes:
        terms = [term for term in found.terms if term.name == axis.name]
        values = _values(axis.fit, terms) if terms else {}
        common += [(term, values[term.term]) for term in terms if term.term in values]
    if not common:
        axes = ", ".join(dict.fromkeys(term.name for term in found.terms))
        what = f"no axis and term in common with {found.title} of {fleet.folder}, which has {axes}"
        raise DataError(what, place=report.source.path, fix=Fix("check a log of the same sensor"))
    tested = [(term, value) for term, value in common if term.population.prediction]
    chances = iter(holm([membership(term.population, value) for term, value in tested]))
    return tuple(
        _row(found, term, value, p=next(chances) if term.population.prediction else None, alpha=alpha)
        for term, value in common
    )


def _values(fit: NoiseFit, terms: list[FleetTerm]) -> dict[str, LogValue]:
    """Return the values of the log: of the fleet's noise model if the fit has its bins."""
    if fit.bins is not None:
        symbols = dict.fromkeys(symbol for symbol in TERMS if any(t.symbol == symbol for t in terms))
        return log_values("this log", fit, model=" + ".join(symbols))
    return {
        e.key: LogValue(unit="this log", value=e.value, low=e.low, high=e.high, level=fit.level)
        for e in fit.estimates
    }


def _row(model: SensorModel, term: FleetTerm, value: LogValue, *, p: float | None, alpha: float) -> Row:
    """Return the verdict on a term; `p` is None if too few units have it."""
    unit, found = sheet_unit(term), term.population
    measured = Quantity.of(value).scaled(unit.factor)
    verdict: Verdict = "undecided"
    if found.prediction is None or p is None:
        subject, units = term.term, f"{len(found.units)} unit{'s' * (len(found.units) > 1)}"
        expected = f"expected at least {MIN_UNITS} to predict the next unit"
        text = f"{units} of the fleet with it, {expected}: not judged"
    else:
        low, high = (limit * unit.factor for limit in found.prediction)
        if p < alpha:
            verdict = "fail"
        elif low <= measured.low and measured.high <= high:
            verdict = "pass"
        where = f"in [{low:.4g}, {high:.4g}]" if low else f"below {high:.4g}"
        subject = f"{term.term} {where if low else f'<= {high:.4g}'} {unit.name}"
        text = (
            f"the next unit of {model.title} is {where} with 95 % chance (adjusted p = {p:.2g}): "
            f"{_VERDICTS[verdict]}"
        )
    return Row(
        where=term.name,
        subject=subject,
        verdict=verdict,
        found=f"{term.term} is {measured.text()} {unit.name}; {text}",
        unit=unit.name,
        measured=measured,
    )
