"""Render HTML templates; text is escaped unless it is `Markup`."""

import math
from functools import cache
from typing import TYPE_CHECKING

from markupsafe import Markup

from imucal.printable import printable
from imucal.units import duration, pretty

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["Markup", "both_units", "render"]


def render(template: str, /, *, package: str = "imucal.report", **values: object) -> Markup:
    """Return a template of a package's folder ``templates``, filled with values.

    ``text_of(name)`` returns a file of the folder unchanged. None is shown as an empty text; a missing value
    is an error.
    """
    return Markup(_environment(package).get_template(template).render(values))  # noqa: S704 - escaped


@cache
def _environment(package: str) -> "Environment":
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    places = dict.fromkeys((package, "imucal.report"))
    loader = ChoiceLoader([PackageLoader(place) for place in places])
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["text_of"] = lambda name: Markup(loader.get_source(environment, name)[0])  # noqa: S704
    environment.globals |= {"both_units": both_units, "duration": duration, "pretty": pretty}
    environment.filters["pretty"] = pretty
    environment.tests["nan"] = math.isnan
    return environment


def _shown(value: object) -> object:
    """Escape control characters and changes of the text direction."""
    if value is None:
        return ""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def both_units(sheet: str | Markup, plain: str | Markup) -> Markup:
    """Return a text in both units; the page shows one of the two."""
    return Markup('<span class="sheet">{}</span><span class="si">{}</span>').format(sheet, plain)
