"""Renew the printed blocks and pictures of README and docs with the program.

    python -m tests.benchmarks.printed_blocks [PAGE ...]

It runs the commands of each page and writes the program's numbers to the text blocks. Lines whose words the
program does not print are listed and unchanged: edit them by hand. Without a page it also draws the
pictures of the README, tutorial and theory, and writes the tables of docs/messages.md.
It takes some minutes.
"""

import sys
import tempfile
from pathlib import Path

from imucal.report.figure import render
from tests.benchmarks import code_tables, theory_figures, tutorial_figures
from tests.code_blocks import ROOT, fill_folder, missing_lines, renewed, run_page

__all__ = ["renew"]


def renew(page: Path) -> list[str]:
    """Write the numbers of the program to a page; return the lines that it does not print."""
    missing = []
    with tempfile.TemporaryDirectory() as folder:
        fill_folder(Path(folder), page)
        written = page.read_text(encoding="utf-8")
        for shown, output in run_page(page, Path(folder)):
            block = renewed(shown, output)
            written = written.replace(f"\n{shown}```", f"\n{block}```", 1)
            missing += missing_lines(block, output)
    page.write_text(written, encoding="utf-8")
    return missing


def main() -> None:
    """Renew the given pages, or all; exit code 1 if a line is not printed."""
    pages = [Path(name) for name in sys.argv[1:]] or [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
    ]
    missing = 0
    for page in pages:
        lines = renew(page)
        missing += len(lines)
        print(f"{page.name}: {len(lines)} lines are not printed", *lines, sep="\n  ", flush=True)
    if len(sys.argv) == 1:
        code_tables.renew_pages()
        tutorial_figures.draw(ROOT / "docs" / "images")
        for name, draw in theory_figures.FIGURES.items():
            (ROOT / "docs" / "images" / f"{name}.png").write_bytes(render(draw(), "png"))
    sys.exit(missing > 0)


if __name__ == "__main__":
    main()
