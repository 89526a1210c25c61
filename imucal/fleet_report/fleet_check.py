"""Is this log's unit one of the fleet? Each term against where the next unit lies, as rows of a check."""

from imucal.checking.verdict import Measured, Row, Verdict
from imucal.errors import DataError
from imucal.fitting.homogeneity import holm
from imucal.fitting.noise_fit import NoiseFit
from imucal.fleet.pooling import log_values
from imucal.fleet.population import FEWEST, membership
from imucal.fleet.values import LogValue
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.fleet_report.verdict import sheet_unit
from imucal.noise.terms import TERMS
from imucal.report.result import Report

#: What a verdict says of the log.
_SAID: dict[Verdict, str] = {
    "pass": "as a unit of the fleet",
    "fail": "not as a unit of the fleet",
    "undecided": "the log is too short to tell",
}


def check_fleet(
    report: Report, fleet: Fleet, model: str | None = None, *, alpha: float = 0.05
) -> tuple[Row, ...]:
    """Return a row for each term of each axis that both have: whether it lies where the next unit would.

    A term fails where a unit of this model is so far off with a probability, adjusted for all terms (Holm
    1979), below `alpha`: a unit of the fleet fails any with that probability. One that the log only bounds,
    above where units lie, is undecided, and so is one that fewer than three units of the fleet have.

    Parameters
    ----------
    report
        Of the log; fits that carry their bins are fitted anew with the fleet's noise model.
    fleet, model
        As `imucal.load_fleet` and `Fleet.model` have them.
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
    if len(found.units) < FEWEST:
        msg = (
            f"{fleet.folder}: found {len(found.units)} units of {found.title}, expected {FEWEST} at least to "
            "say where the next one lies; add units to the fleet"
        )
        raise DataError(msg)
    common: list[tuple[FleetTerm, LogValue]] = []
    for axis in report.axes:
        terms = [term for term in found.terms if term.name == axis.name]
        values = _values(axis.fit, terms) if terms else {}
        common += [(term, values[term.term]) for term in terms if term.term in values]
    if not common:
        axes = ", ".join(dict.fromkeys(term.name for term in found.terms))
        msg = (
            f"{report.source.path}: no axis and term in common with {found.title} of {fleet.folder}, which "
            f"has {axes}; check a log of the same sensor"
        )
        raise DataError(msg)
    told = [(term, value) for term, value in common if term.population.prediction]
    chances = iter(holm([membership(term.population, value) for term, value in told]))
    return tuple(
        _row(found, term, value, p=next(chances) if term.population.prediction else None, alpha=alpha)
        for term, value in common
    )


def _values(fit: NoiseFit, terms: list[FleetTerm]) -> dict[str, LogValue]:
    """Return what the log says of each term: by the fleet's own noise model where the fit has its bins."""
    if fit.bins is not None:
        symbols = dict.fromkeys(symbol for symbol in TERMS if any(t.symbol == symbol for t in terms))
        return log_values("this log", fit, model=" + ".join(symbols))
    return {
        e.key: LogValue(unit="this log", value=e.value, low=e.low, high=e.high, level=fit.level)
        for e in fit.estimates
    }


def _row(model: SensorModel, term: FleetTerm, value: LogValue, *, p: float | None, alpha: float) -> Row:
    """Return the verdict on a term; without `p` too few units have it, such as of a sensor that most lack."""
    unit, found = sheet_unit(term), term.population
    measured = Measured(value=value.value, low=value.low, high=value.high).scaled(unit.factor)
    verdict: Verdict = "undecided"
    if found.prediction is None or p is None:
        subject, units = term.term, f"{len(found.units)} unit{'s' * (len(found.units) > 1)}"
        expected = f"expected {FEWEST} at least to say where the next one lies"
        said = f"{units} of the fleet with it, {expected}: not judged"
    else:
        low, high = (limit * unit.factor for limit in found.prediction)
        if p < alpha:
            verdict = "fail"
        elif value.value is not None or value.high * unit.factor <= high:
            verdict = "pass"
        where = f"in [{low:.4g}, {high:.4g}]" if low else f"below {high:.4g}"
        subject = f"{term.term} {where if low else f'<= {high:.4g}'} {unit.name}"
        said = (
            f"the next unit of {model.title} lies {where} with 95 % (adjusted p = {p:.2g}): {_SAID[verdict]}"
        )
    return Row(
        where=term.name,
        subject=subject,
        verdict=verdict,
        text=f"{term.name}: {term.term} is {measured.text()} {unit.name}; {said}",
        unit=unit.name,
        measured=measured,
    )
