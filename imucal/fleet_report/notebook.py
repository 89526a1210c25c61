"""What a notebook shows of a fleet: a line a model, the page's numbers for the config, a data frame."""

from typing import TYPE_CHECKING

from imucal.fleet_report.pages import config_section
from imucal.fleet_report.summary import Fleet
from imucal.fleet_report.verdict import verdict
from imucal.report.markup import Markup, render

if TYPE_CHECKING:
    import polars as pl

__all__ = ["frame_of", "html_of", "text_of"]

#: Most sensor models that the text names.
_MOST = 9


def text_of(fleet: Fleet) -> str:
    """Return what a fleet holds, in at most twelve lines."""
    lines = [f"Fleet of {len(fleet.logs)} logs in {fleet.folder}: {verdict(fleet)[1]}"]
    lines += [
        f"{model.title}: {len(model.units)} units, {len(model.logs)} logs, {len(model.terms)} terms"
        for model in fleet.models[:_MOST]
    ]
    more = len(fleet.models) - _MOST
    return "\n".join([*lines, *([f"and {more} more sensor models"] if more > 0 else [])])


def html_of(fleet: Fleet) -> Markup:
    """Return the page's table of the number for the config of each term and axis."""
    return render("notebook.html", table=config_section(fleet.models), caption=verdict(fleet)[1])


def frame_of(fleet: Fleet) -> "pl.DataFrame":
    """Return a row for each term and axis of each sensor model: median and bound in SI, or null."""
    import polars as pl

    rows = [
        {
            "model": model.name,
            "axis": term.name,
            "term": term.term,
            "units": len(term.population.units),
            "logs": term.population.logs,
            "median": None if term.population.bounded else term.population.median.value,
            "tolerance": term.population.tolerance,
            "unit": term.unit,
        }
        for model in fleet.models
        for term in model.terms
    ]
    return pl.DataFrame(rows, schema_overrides={"median": pl.Float64, "tolerance": pl.Float64})
