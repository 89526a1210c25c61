"""HTML as values: text is escaped unless it is `Markup` already."""

from collections.abc import Iterable
from html import escape
from typing import TypeAlias

from imucal.printable import printable

_VOID = frozenset({"br", "hr", "img", "input", "link", "meta"})


class Markup(str):
    """Text that is HTML and needs no escaping."""

    __slots__ = ()


Child: TypeAlias = "str | Markup | None"


def element(tag: str, *children: Child, **attributes: str | bool | None) -> Markup:
    """Return ``<tag attributes>children</tag>``.

    A trailing underscore of an attribute is dropped (``class_``), inner ones become hyphens
    (``aria_label``); True stands for a bare attribute; None and False leave it out.
    """
    written = "".join(_attribute(name, value) for name, value in attributes.items())
    if tag in _VOID:
        return Markup(f"<{tag}{written}>")
    return Markup(f"<{tag}{written}>{join(children)}</{tag}>")


def join(children: Iterable[Child]) -> Markup:
    """Return the children one after the other, plain text escaped."""
    return Markup("".join(_escaped(child) for child in children if child is not None))


def both_units(sheet: str | Markup, plain: str | Markup) -> Markup:
    """Return a text in data-sheet units and in SI, of which the page shows one."""
    return join([element("span", sheet, class_="sheet"), element("span", plain, class_="si")])


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
