"""HTML from templates: text is escaped unless it is `Markup` already."""

from collections.abc import Iterable
from functools import cache
from html import escape
from typing import TYPE_CHECKING, TypeAlias

from markupsafe import Markup

from imucal.printable import printable

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["Child", "Markup", "both_units", "element", "join", "labelled", "render", "row", "table"]


def render(template: str, /, *, package: str = "imucal.report", **values: object) -> Markup:
    """Return a template of a package's folder ``templates``, filled.

    Templates extend, include and import those of their own package and of this one; ``text_of(name)`` is the
    text of a file beside them as it is, for styles and scripts. None shows as nothing; a value that a
    template names and nobody gave is an error.
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
    environment.globals["both_units"] = both_units
    return environment


def _shown(value: object) -> object:
    """Return a value as a page may show it: signs that steer or turn text round stand as escapes."""
    if value is None:
        return ""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def both_units(sheet: str | Markup, plain: str | Markup) -> Markup:
    """Return a text in data-sheet units and in SI, of which the page shows one."""
    return Markup('<span class="sheet">{}</span><span class="si">{}</span>').format(sheet, plain)


_VOID = frozenset({"br", "hr", "img", "input", "link", "meta"})
Child: TypeAlias = "str | Markup | None"


def element(tag: str, *children: Child, **attributes: str | bool | None) -> Markup:
    """Return ``<tag attributes>children</tag>``.

    A trailing underscore of an attribute is dropped (``class_``), inner ones become hyphens
    (``aria_label``); True stands for a bare attribute; None and False leave it out.
    """
    written = "".join(_attribute(name, value) for name, value in attributes.items())
    if tag in _VOID:
        return Markup(f"<{tag}{written}>")  # noqa: S704
    return Markup(f"<{tag}{written}>{join(children)}</{tag}>")  # noqa: S704


def join(children: Iterable[Child]) -> Markup:
    """Return the children one after the other, plain text escaped."""
    return Markup("".join(_escaped(child) for child in children if child is not None))  # noqa: S704


def row(*cells: Markup) -> Markup:
    """Return a table row."""
    return element("tr", *cells)


def labelled(titles: Iterable[str], cells: Iterable[Child]) -> list[Markup]:
    """Return cells that carry the titles of their columns, for screens too narrow for a row."""
    pairs = zip(titles, cells, strict=True)
    return [element("td", element("span", cell), data_label=title) for title, cell in pairs]


def table(caption: Child, head: Iterable[Markup], body: Iterable[Markup], *, class_: str = "") -> Markup:
    """Return a table with a caption, in a box that scrolls sideways where it is too wide all the same."""
    inner = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", *head),
        element("tbody", *body),
        class_=class_ or None,
    )
    return element("div", inner, class_="scroll", tabindex="0", role="group", aria_label=_plain(caption))


def _escaped(child: str) -> str:
    return child if isinstance(child, Markup) else escape(printable(child), quote=False)


def _attribute(name: str, value: str | bool | None) -> str:  # noqa: FBT001 - as HTML has them
    if value is None or value is False:
        return ""
    key = name.rstrip("_").replace("_", "-")
    return f" {key}" if value is True else f' {key}="{escape(value)}"'


def _plain(caption: Child) -> str | None:
    return None if caption is None or isinstance(caption, Markup) else caption
