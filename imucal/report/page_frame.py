"""The frame of every page: head, verdict, controls, navigation, sections and what they look like."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template

from imucal.report.markup import Markup, element, join

#: Anchor, title and body of a section.
Section = tuple[str, str, Markup]


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """What a page holds.

    Attributes
    ----------
    title, heading
        Of the browser's window, and of the page.
    grade, sentence
        The verdict: ``good``, ``look`` or ``not-noise``, and why.
    lead
        One line on what was recorded.
    sections
        In their order; the first is what a reader with a keyboard skips to.
    version
        imucal's.
    style, script
        What this kind of page has beyond the frame's.
    notices, data
        Elements before the sections, and after everything.
    """

    title: str
    heading: str
    grade: str
    sentence: str
    lead: str
    sections: Sequence[Section]
    version: str
    style: str = ""
    script: str = ""
    notices: Markup | None = None
    data: Markup | None = None


def render_frame(page: Page) -> str:
    """Return the text of a page; it opens without a network and reads without a script."""
    first, name, _ = page.sections[0]
    links = [element("li", element("a", title, href=f"#{anchor}")) for anchor, title, _ in page.sections]
    bodies = [
        element(
            "section",
            element("h2", title, id=f"{anchor}-title"),
            body,
            id=anchor,
            aria_labelledby=f"{anchor}-title",
        )
        for anchor, title, body in page.sections
    ]
    sentence = page.sentence.replace(" %", "\N{NO-BREAK SPACE}%")
    return Template(page_file("frame.html")).substitute(
        title=element("title", page.title),
        skip=element("a", f"Skip to: {name}", class_="skip", href=f"#{first}"),
        heading=element("h1", page.heading),
        verdict=element("p", sentence, class_=f"verdict {page.grade}"),
        lead=element("p", page.lead, class_="lead"),
        navigation=element("ul", *links),
        notices=page.notices or "",
        sections=join(bodies),
        version=element("span", f"imucal {page.version}"),
        style=page_file("frame.css") + page.style,
        data=page.data or "",
        script=page_file("controls.js") + page.script,
    )


def page_file(name: str, package: str = "imucal.report") -> str:
    """Return the text of a part of a page."""
    return files(package).joinpath("page", name).read_text(encoding="utf-8")
