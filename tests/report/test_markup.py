"""Templates: text of others can do no harm, and nothing is left out in silence."""

import jinja2
import pytest
from markupsafe import Markup

from imucal.report.markup import both_units, render


def _cells(text: str | None) -> str:
    """Return a table whose one row is of a text."""
    return render("notebook.html", caption="", titles=(), rows=[(text, [text])])


def test_text_is_escaped_and_markup_is_not() -> None:
    """A tag in a name is text; so is a sign that turns text round."""
    assert '<th scope="row">&lt;i&gt;</th>' in _cells("<i>")
    assert '<th scope="row"><i></th>' in _cells(Markup("<i>"))
    assert '<th scope="row">a\\u202eb</th>' in _cells("a\u202eb")
    assert both_units("<i>", Markup("<u>")) == (
        '<span class="sheet">&lt;i&gt;</span><span class="si"><u></span>'
    )


def test_none_shows_as_nothing() -> None:
    """An empty cell, not a word."""
    assert '<th scope="row"></th>' in _cells(None)


def test_a_value_that_nobody_gave_is_an_error() -> None:
    """Not an empty place on the page."""
    with pytest.raises(jinja2.UndefinedError, match="'caption' is undefined"):
        render("notebook.html")
