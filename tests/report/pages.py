"""Pages for several tests, rendered once per process, because their pictures take seconds."""

import functools

from imucal.report.page import render_page
from tests.report.synthetic import consumer_report, small_report

__all__ = ["consumer_page", "small_page"]


@functools.cache
def consumer_page() -> str:
    """Return the page of a report with all features."""
    return render_page(consumer_report())


@functools.cache
def small_page() -> str:
    """Return the page of one short axis."""
    return render_page(small_report())
