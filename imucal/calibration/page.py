"""`calibration.html`: table, pictures, findings and how to apply the result, in one file."""

import base64
from collections.abc import Mapping

from imucal._version import __version__
from imucal.calibration.exports import CALIBRATION_TARGETS
from imucal.calibration.figures import FIGURES
from imucal.calibration.frames import FRAMES
from imucal.calibration.result import Calibration
from imucal.calibration.table import headline, remarks, rows
from imucal.findings import phrase_of
from imucal.report.markup import Markup, render
from imucal.report.page import listed_findings

__all__ = ["render_page"]

#: Verdict -> the style of its line.
_STYLES = {"good": "good", "check": "check", "not-usable": "not-noise"}
_DESCRIPTIONS = {
    "rests": "Length of the specific force at each rest minus gravity, before and after the calibration.",
    "attitudes": "Direction of gravity at each rest, and the rest that would help most.",
    "turns": "Error of gravity's direction after each turn, before and after the calibration.",
}


def render_page(found: Calibration, pictures: Mapping[str, bytes]) -> str:
    """Return the page; `pictures` are PNG files by the names in `FIGURES`."""
    shown = [
        (name, f"data:image/png;base64,{base64.b64encode(pictures[name]).decode()}", _DESCRIPTIONS[name])
        for name in FIGURES
        if name in pictures
    ]
    place = found.gravity
    return str(
        render(
            "calibration.html",
            package="imucal.calibration",
            title=f"{found.source.name} – IMU calibration",
            heading=f"Calibration of {found.source.name}",
            grade=_STYLES[found.verdict],
            sentence=_sentence(found),
            lead=headline(found).partition(": ")[2],
            blocks=rows(found),
            remarks=list(remarks(found)),
            pictures=shown,
            findings=listed_findings(found.findings),
            targets=", ".join(name for name in CALIBRATION_TARGETS if name != "python"),
            gravity=f"{place.value:.5f} ± {1.96 * place.sigma:.2g} m/s² ({place.origin})",
            frame=FRAMES[found.frame],
            version=__version__,
        )
    )


def _sentence(found: Calibration) -> Markup:
    codes = dict.fromkeys(each.code for each in found.findings if each.level != "info")
    phrases = list(map(phrase_of, codes))
    reasons = f": {', '.join(phrases)}" if phrases else ""
    return Markup("{}{}").format(found.verdict_text.capitalize(), reasons)
