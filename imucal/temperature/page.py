"""`thermal.html`: table, pictures, findings and how to use the curve, in one file."""

import base64
from collections.abc import Mapping

from imucal._version import __version__
from imucal.recording import Sensor
from imucal.report.markup import render
from imucal.report.page import listed_findings
from imucal.temperature.figures import DESCRIPTION
from imucal.temperature.result import Thermal, ThermalVerdict
from imucal.temperature.table import COLUMNS, headline, rows, sentence

__all__ = ["render_page"]

#: Verdict -> the style of its line.
_STYLES: dict[ThermalVerdict, str] = {"good": "good", "check": "check", "not-usable": "not-noise"}


def render_page(found: Thermal, pictures: Mapping[Sensor, bytes]) -> str:
    """Return the page; `pictures` are PNG files."""
    shown = [
        (str(sensor), f"data:image/png;base64,{base64.b64encode(content).decode()}")
        for sensor, content in pictures.items()
    ]
    return str(
        render(
            "thermal.html",
            package="imucal.temperature",
            title=f"{found.source.name} – bias over temperature",
            heading=f"Bias over temperature of {found.source.name}",
            grade=_STYLES[found.verdict],
            sentence=sentence(found),
            lead=headline(found).partition(": ")[2],
            columns=COLUMNS,
            rows=rows(found),
            pictures=shown,
            description=DESCRIPTION,
            findings=listed_findings(found.findings),
            low=f"{found.low_c:.1f}",
            high=f"{found.high_c:.1f}",
            version=__version__,
        )
    )
