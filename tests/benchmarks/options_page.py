"""The page docs/options.md: the `--help` of every command.

    python -m tests.benchmarks.options_page

Run it after a change of a help text; `tests/test_docs_pages.py` fails if the page is stale.
"""

from pathlib import Path

from imucal.cli import COMMANDS
from tests.cli.run import run

__all__ = ["PAGE", "page"]

PAGE = Path(__file__).parents[2] / "docs" / "options.md"
_FLEET = ("run", "report", "status")


def page() -> str:
    """Return the Markdown of the page, at 80 columns."""
    commands: list[tuple[str, ...]] = [(), *((name,) for name in COMMANDS)]
    commands += [("fleet", name) for name in _FLEET]
    parts = ["# Options\n\nThe output of `imucal COMMAND --help` for every command.\n"]
    for command in commands:
        text = run(*command, "--help", cwd=PAGE.parent, COLUMNS="80").stdout
        lines = "\n".join(line.rstrip() for line in text.strip().splitlines())
        parts.append(f"## {' '.join(('imucal', *command))}\n\n```text\n{lines}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
