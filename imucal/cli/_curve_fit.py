"""Fitting a table of Allan deviations that another tool made: no samples, so no report folder."""

import re
import textwrap
from dataclasses import replace
from itertools import chain
from pathlib import Path

import click

from imucal.allan.deviation_table import NamedCurve, is_adev_table, read_adev_table, read_curve
from imucal.cli._printing import echo, name_of_log, picked, print_findings, print_json, say, width
from imucal.cli.parameters import LogRequest
from imucal.fitting import Estimate, FitSettings, NoiseFit, fit_axis
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import usual_pairs
from imucal.report.json_file import pair_document
from imucal.units import duration

#: Endings of files that may be such a table, and a cell of its heading: a unit may follow in brackets.
_TEXTS = (".csv", ".txt", ".dat", ".tsv")
_TIME = re.compile(r'(?:^|[,;\t])\s*"*(?:taus?|averaging time)"*\s*(?:[\[(,;\t]|$)', re.IGNORECASE)


def is_curve_table(request: LogRequest) -> bool:
    """Say whether the heading of the one log names an averaging time, as a table of deviations does."""
    if len(request.logs) != 1 or not name_of_log(request.logs[0]).lower().endswith(_TEXTS):
        return False
    # Held to the end of the command, so that what is fetched for it is not fetched twice.
    logs = click.get_current_context().with_resource(request.local())
    return all(map(_names_an_averaging_time, logs.paths))


def _names_an_averaging_time(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(4096).decode("utf-8-sig", "replace")
    lines = (line.strip() for line in head.splitlines())
    return _TIME.search(next((line for line in lines if line and line[0] not in "%#"), "")) is not None


def fit_curves(request: LogRequest, settings: FitSettings, *, as_json: bool) -> None:
    """Fit every column of a table and print the terms; `mle` needs samples, so gmwm takes its place."""
    if settings.method == "mle":
        say("The table has no samples: fitting the curve with gmwm instead of mle.")
        settings = replace(settings, method="gmwm")
    with request.local() as logs:
        path, rate_hz = logs.paths[0], request.reading["rate_hz"]
        curves = read_adev_table(path) if is_adev_table(path) else read_curve(path, rate_hz=rate_hz)
    results = [(named, fit_axis(named.curve, settings)) for named in curves]
    found = [
        replace(finding, axis=named.name)
        for named, result in results
        for finding in (*named.findings, *result.findings)
    ]
    print_findings(found)
    if as_json:
        print_json([_document(named, result) for named, result in results], indent=1)
    else:
        echo("\n\n".join(_table(named, result) for named, result in results))
    say("A table of deviations gets no report folder; use --json for all numbers.")


def _unit(named: NamedCurve, symbol: str) -> str:
    """Return the SI unit of a coefficient, or nothing where the table doesn't say what it holds."""
    return "" if not named.unit or named.sensor is None else TERMS[symbol].unit(named.sensor)


def _table(named: NamedCurve, result: NoiseFit) -> str:
    unit = f", {named.unit}" if named.unit else ", unit of the table"
    lines = [f"{named.name}{unit}: {result.model} ({result.method}, {100 * result.level:g} % intervals)"]
    for estimate in result.estimates:
        if estimate.value is None:
            text = f"< {estimate.high:.3g}"
        else:
            text = f"{estimate.value:.4g}  [{estimate.low:.4g}, {estimate.high:.4g}]"
        lines.append(f"  {estimate.key:<4}{text}  {_unit(named, estimate.symbol)}".rstrip())
        if time := estimate.correlation_time:
            lines.append(f"      T = {time.value:.4g}  [{time.low:.4g}, {time.high:.4g}]  s")
    for pair in usual_pairs([result]):
        white, walk = (_unit(named, symbol) for symbol in ("N", "K"))
        numbers = f"white noise {pair.white:.4g} {white}".rstrip() + f", walk {pair.walk:.4g} {walk}".rstrip()
        lines.append(f"  for a filter that coasts for {duration(pair.horizon_s)}: {numbers}")
    later = " " * 6
    broken = (textwrap.wrap(line, width(), subsequent_indent=later, break_on_hyphens=False) for line in lines)
    return "\n".join(chain.from_iterable(broken))


def _document(named: NamedCurve, result: NoiseFit) -> dict[str, object]:
    return {
        "name": named.name,
        "unit": named.unit or None,
        "method": result.method,
        "model": str(result.model),
        "level": result.level,
        "terms": {estimate.key: _term(named, estimate) for estimate in result.estimates},
        "filter_numbers": [pair_document(pair) for pair in usual_pairs([result])],
    }


def _term(named: NamedCurve, estimate: Estimate) -> dict[str, object]:
    term = picked(estimate, "status value low high")
    term["unit"] = _unit(named, estimate.symbol) or None
    if time := estimate.correlation_time:
        term["T_s"] = picked(time, "value low high")
    return term
