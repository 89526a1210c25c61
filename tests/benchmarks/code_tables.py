"""The tables of findings in docs/messages.md, made of imucal/finding_codes.txt.

    python -m tests.benchmarks.code_tables

Run it after a change of that file; `tests/test_docs.py` fails if the page is stale.
"""

from itertools import groupby
from pathlib import Path

from imucal.findings import code_texts

__all__ = ["PAGE", "renewed_page"]

PAGE = Path(__file__).parents[2] / "docs" / "messages.md"
#: The lines of the page around its tables.
_START, _END = "<!-- made by tests/benchmarks/code_tables.py -->\n", "<!-- end -->\n"


def _table(section: str) -> str:
    """Return the heading and table of a section; its last column only if a row has an advice."""
    rows: list[tuple[list[str], str, str]] = []
    for code, text in code_texts().items():
        if text.section == section and text.found:
            rows.append(([code], text.found, text.advice))
        elif text.section == section:
            rows[-1][0].append(code)
    advised = any(advice for _, _, advice in rows)
    head = "| code | what was found |" + " what to do |" * advised
    lines = [head, "|---" * (2 + advised) + "|"]
    for codes, found, advice in rows:
        names = ", ".join(f"`{code}`" for code in codes)
        lines.append(f"| {names} | {found} |" + f" {advice} |" * advised)
    return f"### {section}\n\n" + "\n".join(lines) + "\n"


def renewed_page() -> str:
    """Return the page with the tables of the codes that the package has now."""
    above, _, rest = PAGE.read_text(encoding="utf-8").partition(_START)
    below = rest.partition(_END)[2]
    sections = [section for section, _ in groupby(text.section for text in code_texts().values())]
    return above + _START + "\n" + "\n".join(map(_table, sections)) + _END + below


if __name__ == "__main__":
    PAGE.write_text(renewed_page(), encoding="utf-8")
