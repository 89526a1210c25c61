"""Report folders for the commands that take one."""

from pathlib import Path

from imucal.report.json_file import to_document
from imucal.report.result import Report
from imucal.report.typed_json import dumps
from tests.report.synthetic import consumer_report

__all__ = ["write_report"]


def write_report(folder: Path, name: str = "still-imucal", report: Report | None = None) -> str:
    """Write a report folder with its report.json alone; return its name."""
    place = folder / name
    place.mkdir(parents=True)
    text = dumps(to_document(report or consumer_report()))
    (place / "report.json").write_text(text, encoding="utf-8")
    return name
