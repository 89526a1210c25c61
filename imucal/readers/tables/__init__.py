"""Rows -> columns: delimited text, and tables with typed columns."""

__all__: list[str] = []
