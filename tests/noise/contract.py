"""The contract of a noise term: sentences about missing parts of a new term."""

from collections.abc import Iterator
from pathlib import Path

import imucal
from imucal.fitting import METHODS
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.units import DATASHEET_UNITS

_README = Path(__file__).parents[2] / "README.md"
_SCHEMA = Path(imucal.__file__).parent / "report" / "schema" / "report-4.schema.json"
_ATTRIBUTES = ("symbol", "names", "units", "datasheet", "stroke", "description")


def missing(symbol: str) -> list[str]:
    """Return one sentence per missing part of the term with that symbol."""
    return [*_in_the_class(symbol, TERMS[symbol]), *_in_the_fits(symbol, TERMS[symbol]), *_elsewhere(symbol)]


def _in_the_class(symbol: str, term: type[NoiseTerm]) -> Iterator[str]:
    name = term.__name__
    for attribute in _ATTRIBUTES:
        if not hasattr(term, attribute):
            yield f"{name} lacks `{attribute}`; see NoiseTerm for what it is"
    if not (term.__doc__ or "").strip():
        yield f"{name} has no docstring; say what the noise is, its unit and its slope"
    if getattr(term, "symbol", symbol) != symbol or not symbol.isupper():
        yield f"{name} stands in TERMS under {symbol!r}; its symbol must be the same, in capitals"
    for unit in getattr(term, "datasheet", ()):
        if unit not in DATASHEET_UNITS:
            yield f"{name}: data-sheet unit {unit!r} has no factor in imucal.units.DATASHEET_UNITS"


def _in_the_fits(symbol: str, term: type[NoiseTerm]) -> Iterator[str]:
    name = term.__name__
    for method in sorted(term.fitted_by - set(METHODS)):
        yield f"{name}: {method!r} in `fitted_by` is no method; there are {', '.join(METHODS)}"
    if term.fitted_by and term.parameters()[1:] not in {(), ("T",)}:
        has = ", ".join(term.parameters())
        yield f"{name} has {has}, but a fit (`fitted_by`) estimates a coefficient and at most a time T"
    if "slope" in term.fitted_by and term.slope is None:
        yield f"{name} is read from slopes (`fitted_by`) but has none (`slope`)"
    if "slope" in term.fitted_by and len(symbol) > 1:
        yield f"{name}: what is fitted to curves is named by one letter, got {symbol!r}"


def _elsewhere(symbol: str) -> Iterator[str]:
    if f'"{symbol}"' not in _SCHEMA.read_text(encoding="utf-8"):
        yield f"{_SCHEMA.name} does not list {symbol} among the symbols of a term"
    if f"| `{symbol}` |" not in _README.read_text(encoding="utf-8"):
        yield f"README.md has no row for {symbol} in its table of terms"
