"""The generated tables of docs/: findings, exit codes, JSON keys, formats, programs.

A page contains each table between ``<!-- table: NAME -->`` and ``<!-- end -->``.

    python -m tests.benchmarks.code_tables

Run it after a change of the code; `tests/test_docs.py` fails if a page is stale.
"""

import json
import re
from collections.abc import Callable, Iterable
from importlib.resources import files
from itertools import groupby
from pathlib import Path

from imucal.errors import EXIT_CODES
from imucal.findings import code_texts
from imucal.readers.formats import FORMATS
from imucal.report.exports import TARGETS

__all__ = ["PAGES", "renew_pages", "renewed_page"]

PAGES = sorted((Path(__file__).parents[2] / "docs").glob("*.md"))
#: What the kind of a number also says: it is continuous.
_SAME_AT_ANY_RATE = "; no factor of the rate"
_TABLE = re.compile(r"(<!-- table: ([a-z_ -]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def _table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """Return a table in Markdown; `head` contains its column names between bars."""
    lines = [head, "|---" * head.strip("|").count("|") + "|---|"]
    return "\n".join([*lines, *("| " + " | ".join(map(str, row)) + " |" for row in rows)]) + "\n"


def _findings() -> str:
    """Return a table for each section of codes; its last column only if a row has an advice."""
    tables = []
    for section, codes in groupby(code_texts().items(), key=lambda item: item[1].section):
        rows: list[tuple[list[str], str, str]] = []
        for code, text in codes:
            if text.found:
                rows.append(([code], text.found, text.advice))
            else:
                rows[-1][0].append(code)
        advised = any(advice for _, _, advice in rows)
        head = "| code | what was found |" + " what to do |" * advised
        cells = [[_named(names), found, *[advice] * advised] for names, found, advice in rows]
        tables.append(f"### {section}\n\n{_table(head, cells)}")
    return "\n".join(tables)


def _named(codes: Iterable[str]) -> str:
    return ", ".join(f"`{code}`" for code in codes)


def _exit_codes() -> str:
    rows = ((code, *texts) for code, texts in EXIT_CODES.items())
    return _table("| code | meaning | what a script can do |", rows)


def _keys(name: str) -> Callable[[], str]:
    """Return the function that creates the table of the keys of a part of report.json."""

    def table() -> str:
        text = (files("imucal.report") / "schema" / "report-4.schema.json").read_text(encoding="utf-8")
        schema = json.loads(text)
        parts = [schema["$defs"][name]] if name else [schema, schema["oneOf"][0]]
        keys = {key: value for part in parts for key, value in part["properties"].items()}
        rows = ((f"`{key}`", value["description"]) for key, value in keys.items())
        return _table("| key | content |", rows)

    return table


def _formats() -> str:
    return _table("| format | supported |", ((entry.name, _escaped(entry.supported)) for entry in FORMATS))


def _programs() -> str:
    rows = (
        (
            target.title,
            f"`{target.name}`",
            _escaped("; ".join(target.formulas).replace(_SAME_AT_ANY_RATE, "")),
            # Its start; the file has all of it.
            _escaped(re.split("[;,:]", target.kind)[0]),
        )
        for target in TARGETS.values()
    )
    return _table("| file | `--to` | numbers | kind |", rows)


def _escaped(text: str) -> str:
    """Return a text with Markdown's special characters escaped."""
    return re.sub(r"([*|<])", r"\\\1", text)


#: Name of a table -> function that creates it.
_TABLES: dict[str, Callable[[], str]] = {
    "findings": _findings,
    "exit codes": _exit_codes,
    "formats": _formats,
    "programs": _programs,
    "report": _keys(""),
    **{name: _keys(name) for name in ("axis", "fit", "term", "finding")},
}


def renewed_page(text: str) -> str:
    """Return a page with the tables of the present code."""
    return _TABLE.sub(lambda found: f"{found[1]}\n{_TABLES[found[2]]()}{found[3]}", text)


def renew_pages() -> None:
    """Write the tables into all pages of docs/."""
    for page in PAGES:
        page.write_text(renewed_page(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    renew_pages()
