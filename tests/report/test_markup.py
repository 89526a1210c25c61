"""Templates: text is escaped, and a missing value is an error."""

import jinja2
import pytest
from markupsafe import Markup

from imucal.report.markup import both_units, render


def _cells(text: str | None) -> str:
    """Return a table with one row that contains a text."""
    return render("notebook.html", caption="", titles=(), rows=[(text, [text])])


def test_text_is_escaped_and_markup_is_not() -> None:
    """A tag in a name is text, and characters that reverse text are replaced."""
    assert '<th scope="row">&lt;i&gt;</th>' in _cells("<i>")
    assert '<th scope="row"><i></th>' in _cells(Markup("<i>"))
    assert '<th scope="row">a\\u202eb</th>' in _cells("a\u202eb")
    assert both_units("<i>", Markup("<u>")) == (
        '<span class="sheet">&lt;i&gt;</span><span class="si"><u></span>'
    )


def test_none_is_an_empty_cell() -> None:
    assert '<th scope="row"></th>' in _cells(None)


def test_a_missing_value_is_an_error() -> None:
    """An empty place on the page would go unnoticed."""
    with pytest.raises(jinja2.UndefinedError, match="'caption' is undefined"):
        render("notebook.html")
