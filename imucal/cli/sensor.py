"""``imucal sensor``: the noise figures of a part's data sheet."""

from collections.abc import Iterator

import click

from imucal.cli._printing import can_print, echo, print_json, print_note, width, wrapped
from imucal.cli.context import misuse
from imucal.cli.options import OUTPUT, Command, flag, quiet, unwrapped
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.sensors import Figure, Part, PartSensor, TermFigure, cautions, every_part, find_sensor
from imucal.units import find_unit, pretty

SCHEMA = "imucal/sensor/1"

_EPILOG = unwrapped("""
Examples:
  imucal sensor --list
  imucal sensor BMI088
  imucal sensor "RealSense D435i"
  imucal sensor ADIS16448 --json | jq .gyroscope.terms.N.value
  imucal fit still.mcap --sensor BMI088

Exit codes: 0 done, 2 usage, 3 no such part.
""")

#: Unit of N of each sensor in the list, the same for all parts.
_LIST_UNITS = {Sensor.GYROSCOPE: "deg/s/sqrt(Hz)", Sensor.ACCELEROMETER: "ug/sqrt(Hz)"}
#: Name, N of both sensors, manufacturer, confidence; the first 40 columns contain the numbers.
_ROW = "{:<12}{:>14}{:>10}  {:<22}{}".format
#: Sign of data sheets -> ASCII, for terminals that can't print it.
_ASCII = str.maketrans(
    {"°": "deg", "µ": "u", "√": "sqrt", "±": "+-", "²": "^2", "σ": "sigma", "≤": "<=", "Δ": "d", "≥": ">="}
)


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("name", metavar="[NAME]", required=False)
@flag("--list", "listed", help="List all parts.")
@flag("--json", "as_json", group=OUTPUT, help="Print the figures as JSON (SI) on standard output.")
@quiet
def command(*, name: str | None, listed: bool, as_json: bool) -> None:
    """Print the noise figures of a part's data sheet.

    NAME is a chip, a module, or a device that contains one; case, spaces and hyphens do not matter. Each
    figure has a source, and notes explain what it means.
    """
    if listed and name is not None:
        misuse("give a NAME or --list, not both")
    if listed:
        _print_list(as_json=as_json)
        return
    if name is None:
        misuse(
            "give the name of a part, such as 'imucal sensor BMI088', or list all with 'imucal sensor --list'"
        )
    part = find_sensor(name)
    if as_json:
        print_json({"schema": SCHEMA, **_document(part)})
        return
    for indent, text in _page(part):
        for line in wrapped(text, indent=indent):
            _print(line)


def _print(text: str) -> None:
    echo(text if can_print(text) else text.translate(_ASCII).encode("ascii", "replace").decode())


def _print_list(*, as_json: bool) -> None:
    parts = every_part()
    if as_json:
        print_json({"schema": SCHEMA, "parts": [_document(part) for part in parts.values()]})
        return
    units = [pretty(_LIST_UNITS[sensor]) for sensor in Sensor]
    rows = [
        _ROW("name", "gyro N", "accel N", "manufacturer", "figures from"),
        _ROW("", *units, "", ""),
        *(_row(part) for part in parts.values()),
    ]
    columns = width()
    for row in rows:
        _print(row[:columns].rstrip())
    print_note(f"{len(parts)} parts; 'imucal sensor NAME' prints all figures of one with their sources")


def _row(part: Part) -> str:
    numbers = [_listed_white(part, sensor) for sensor in Sensor]
    return _ROW(part.name, *numbers, part.manufacturer[:21], part.confidence.removeprefix("manufacturer "))


def _listed_white(part: Part, sensor: Sensor) -> str:
    """Return N in the unit of the list, with < for a maximum; - if it is not printed."""
    white = part.term(sensor, "N")
    if white is None:
        return "-"
    found = find_unit(_LIST_UNITS[sensor], TERMS["N"].coefficient_units(sensor))
    factor = found[1] if found else 1.0
    return f"{'< ' if white.kind == 'maximum' else ''}{white.value / factor:.3g}"


def _page(part: Part) -> Iterator[tuple[int, str]]:
    """Yield the figures, the notes and the sources of a part, as indent and text."""
    also = f", also {', '.join(part.aliases)}" if part.aliases else ""
    yield 0, f"{part.name}{also}: {part.kind} by {part.manufacturer}; figures from: {part.confidence}"
    sources = part.sources
    for own in part.sensors.values():
        yield 0, ""
        yield 0, str(own.sensor).upper()
        for term in own.terms.values():
            yield 2, _term_line(term, own)
        for name, figure in own.figures.items():
            condition = f" ({figure.condition})" if figure.condition else ""
            number = f" [{sources.index(figure.source) + 1}]" if len(sources) > 1 else ""
            yield 2, f"{name.replace('_', ' ')}: {figure.printed}{condition}{number}"
    yield 0, ""
    yield 0, "NOTES"
    for note in cautions(part):
        yield 2, note
    yield 0, ""
    yield 0, "SOURCES" if len(sources) > 1 else "SOURCE"
    for index, source in enumerate(sources, 1):
        yield 2, f"[{index}] {source}" if len(sources) > 1 else source


def _term_line(term: TermFigure, own: PartSensor) -> str:
    """Return ``N = 0.014 deg/s/√Hz = 2.44e-04 rad/s/√Hz (typical, from the noise density)``."""
    figure = own.figures[term.origin]
    origin = f"{term.kind}, from the {term.origin.replace('_', ' ')}"
    axes = ""
    if term.symbol == "B":
        origin += " / 0.664"
    if figure.si_xyz is not None:
        axes = f"; x, y, z: {', '.join(_in_sheet_unit(term, value) for value in figure.si_xyz)}"
    text = f"{term.symbol} = {_both_units(term, term.value)} ({origin}{axes})"
    if term.maximum is not None:
        text += f"; maximum {_in_sheet_unit(term, term.maximum)}"
    if term.alternative is not None:
        origin = term.alternative_origin.replace("_", " ")
        text += f"; or {_both_units(term, term.alternative)} from the {origin}"
    return text


def _in_sheet_unit(term: TermFigure, value: float) -> str:
    return f"{term.in_unit(value):.4g}"


def _both_units(term: TermFigure, value: float) -> str:
    si = pretty(TERMS[term.symbol].unit(term.sensor))
    return f"{_in_sheet_unit(term, value)} {pretty(term.unit)} = {value:.4g} {si}"


def _document(part: Part) -> dict[str, object]:
    """Return a part as JSON values, SI."""
    document: dict[str, object] = {
        "name": part.name,
        "aliases": list(part.aliases),
        "manufacturer": part.manufacturer,
        "kind": part.kind,
        "confidence": part.confidence,
    }
    for sensor in Sensor:
        own = part.sensors.get(sensor)
        document[str(sensor)] = None if own is None else _sensor_document(own)
    return document | {"notes": list(cautions(part)), "sources": list(part.sources)}


def _sensor_document(own: PartSensor) -> dict[str, object]:
    return {
        "terms": {symbol: _term_document(term) for symbol, term in own.terms.items()},
        "full_scale": list(own.full_scale),
        "full_scale_unit": "deg/s" if own.sensor is Sensor.GYROSCOPE else "g",
        "steps": list(own.steps),
        "figures": {name: _figure_document(figure) for name, figure in own.figures.items()},
    }


def _term_document(term: TermFigure) -> dict[str, object]:
    return {
        "value": term.value,
        "unit": TERMS[term.symbol].unit(term.sensor),
        "kind": term.kind,
        "maximum": term.maximum,
        "from": term.origin,
        "alternative": term.alternative,
        "alternative_from": term.alternative_origin or None,
    }


def _figure_document(figure: Figure) -> dict[str, object]:
    return {
        "printed": figure.printed,
        "si": figure.si,
        "si_xyz": None if figure.si_xyz is None else list(figure.si_xyz),
        "kind": figure.kind,
        "condition": figure.condition or None,
        "definition": figure.definition or None,
        "source": figure.source,
    }
