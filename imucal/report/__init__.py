"""Write results to files: the JSON document, the pictures, the page, and their folder."""

from imucal.report.json_file import load as load_report
from imucal.report.result import AxisReport, Overview, Report
from imucal.report.writer import write_report

__all__ = ["AxisReport", "Overview", "Report", "load_report", "write_report"]
