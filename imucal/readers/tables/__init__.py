"""Rows -> columns: delimited text, and tables with typed columns."""

from imucal.readers.tables.columns import ColumnSpec, parse_columns_text
from imucal.readers.tables.dialects import DIALECTS, Dialect
from imucal.readers.tables.text_table import read_many

__all__ = ["DIALECTS", "ColumnSpec", "Dialect", "parse_columns_text", "read_many"]
