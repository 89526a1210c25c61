"""Sections of the page that others use."""

from imucal.report.html_page import glossary_section, listed_findings

__all__ = ["glossary_section", "listed_findings"]
