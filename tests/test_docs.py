"""Tests of the documentation: code, links, and agreement with the program."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imucal.errors import ERROR_CODES
from imucal.findings import code_texts
from imucal.units import INCREMENT_UNITS, LOG_UNITS
from tests.benchmarks import code_tables
from tests.code_blocks import Kept, code_blocks, fill_folder, missing_lines, renewed, run_page

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
PACKAGE = ROOT / "imucal"

#: Languages whose blocks are run; other blocks are only shown.
RUN = {"python", "console", "toml"}
#: The report that several pages begin with, computed once.
KEPT = Kept("imucal fit log.mcap -o report", "report")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


@pytest.mark.slow
@pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_from_top_to_bottom(page: Path, tmp_path: Path) -> None:
    """Blocks run in order in one folder; each text block equals the output of the commands, to all digits."""
    fill_folder(tmp_path, page)
    for block, output in run_page(page, tmp_path, kept=KEPT):
        assert missing_lines(block, output) == [], output


def test_a_line_that_was_not_printed_is_found() -> None:
    """Words and numbers must be equal; line breaks may differ."""
    output = "x  0.34  [0.33,\n0.35] deg/h for 12 min N: 0.0028095255"
    assert missing_lines("x 0.34 [0.33, 0.35] deg/h\n…\nfor 12 min", output) == []
    assert missing_lines("N: 0.0028095256", output) == []
    assert missing_lines("x 0.34 [0.34, 0.35] deg/h", output) == ["x 0.34 [0.34, 0.35] deg/h"]
    assert missing_lines("for 12 h", output) == ["for 12 h"]


def test_numbers_of_a_block_are_renewed() -> None:
    """They are copied from the most similar place, and the line's spaces are kept."""
    output = "x 0.34 [0.33,\n0.35] deg/h\nx 5 [4, 6] deg/h"
    assert renewed("x    0.3  [0.2, 0.5] deg/h", output) == "x    0.34  [0.33, 0.35] deg/h"
    assert renewed("y    0.3  [0.2, 0.5] deg/h\n", output) == "y    0.3  [0.2, 0.5] deg/h\n"


def test_every_block_has_a_language() -> None:
    """Otherwise a block might not be run by accident."""
    known = RUN | {"sh", "text", "csv", "matlab", "yaml", "json", "ini", "xml", "cpp"}
    for page in PAGES:
        for language, text in code_blocks(page):
            assert language in known, f"{page.name}: {text[:60]}"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda p: p.stem)
def test_links_between_files_have_targets(page: Path) -> None:
    """Files and headings exist."""
    for target in _LINK.findall(page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page if not path else page.parent / path
        assert file.exists(), f"{page.name}: {target} leads nowhere"
        if anchor:
            assert anchor in _anchors(file), f"{page.name}: {target} names no heading"


def _anchors(page: Path) -> Iterator[str]:
    for heading in re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        yield re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())


def test_the_pages_build_without_a_warning(tmp_path: Path) -> None:
    """MkDocs in strict mode checks the navigation and links; pages load nothing from the network."""
    pytest.importorskip("mkdocs", reason="mkdocs is part of the dev requirements only")
    site = tmp_path / "site"
    built = subprocess.run(  # noqa: S603 - our own pages
        [sys.executable, "-W", "ignore", "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", site],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    for page in site.rglob("*.html"):
        loaded = re.findall(r'<(?:script|link|img)\b[^>]*\b(?:src|href)="(https?:[^"]*)"', page.read_text())
        assert loaded == [], f"{page.name} loads from the network"


def test_every_finding_is_described() -> None:
    """The source and the page contain the same codes."""
    written = {
        code
        for file in PACKAGE.rglob("*.py")
        for code in re.findall(
            r'\b(?:code=|(?:Finding|_doubtful)\(\s*[^,]+,\s*|_info\(|_warning\()"([a-z-]+)"',
            file.read_text(encoding="utf-8"),
        )
    }
    drift = (PACKAGE / "fitting/spectral/disturbances/not_noise.py").read_text(encoding="utf-8")
    for chosen in re.findall(r"^    code = (.*)$", drift, re.MULTILINE):
        written |= set(re.findall(r'"([a-z-]+)"', chosen))
    for name in ("screening/values.py", "readers/assemble.py"):
        written |= _loose_codes(name)
    assert set(code_texts()) <= written <= {*code_texts(), *ERROR_CODES}


def _loose_codes(name: str) -> set[str]:
    """Return the codes that a module passes to its own function."""
    text = (PACKAGE / name).read_text(encoding="utf-8")
    damage = re.search(r"frozenset\(\s*\{(.*?)\}", text, re.DOTALL)
    listed = re.findall(r'"([a-z-]+)"', damage[1]) if damage else []
    return set(re.findall(r'_error\(\s*"([a-z-]+)"', text)) | set(listed)


def test_every_key_of_the_schema_has_a_description() -> None:
    schema = json.loads((PACKAGE / "report" / "schema" / "report-4.schema.json").read_text(encoding="utf-8"))
    parts = {**schema["$defs"], "report": schema, "with axes": schema["oneOf"][0]}
    lacking = [
        f"{name}: {key}"
        for name, part in parts.items()
        for key, value in part["properties"].items()
        if not value.get("description")
    ]
    assert lacking == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_generated_tables_are_current(page: Path) -> None:
    """Run `python -m tests.benchmarks.code_tables` after a change of the code."""
    text = page.read_text(encoding="utf-8")
    assert code_tables.renewed_page(text) == text


def test_a_stale_table_is_found() -> None:
    """A page with an old row differs from the renewed page."""
    page = "<!-- table: exit codes -->\n| 0 | all is well |\n<!-- end -->\nmore\n"
    assert "| 0 | done | continue |" in code_tables.renewed_page(page)
    assert "all is well" not in code_tables.renewed_page(page)
    assert code_tables.renewed_page("no table\n") == "no table\n"


def test_the_source_of_each_format_is_in_the_table() -> None:
    from imucal.report.exports import TARGETS

    page = (DOCS / "results" / "config-files.md").read_text(encoding="utf-8")
    for target in TARGETS.values():
        assert f"| {target.name} | {target.source} | " in page


def test_every_exit_code_has_a_meaning() -> None:
    """These are the exit codes of errors and of the command line."""
    from imucal import errors

    own = {value.exit_code for value in vars(errors).values() if hasattr(value, "exit_code")}
    assert own | {0, 2, 70, 130, 141} == set(errors.EXIT_CODES)


@pytest.mark.parametrize(
    ("number", "unit"),
    [
        ("2.909·10⁻⁴ rad/s/√Hz", np.radians(1) / 60),
        ("1.745·10⁻² rad/s/√Hz", np.radians(1)),
        ("4.848·10⁻⁶ rad/s", np.radians(1) / 3600),
        ("1.667·10⁻² m/s²/√Hz", 1 / 60),
        ("9.807·10⁻⁶ m/s²/√Hz", 9.80665e-6),
        ("9.807·10⁻³ m/s²", 9.80665e-3),
    ],
)
def test_the_unit_conversions_are_right(number: str, unit: float) -> None:
    """The table of data-sheet units is right to four digits."""
    page = (DOCS / "which-number-goes-in-my-config.md").read_text(encoding="utf-8")
    assert number in page
    digits, power = re.match(r"([\d.]+)·10⁻(.)", number).groups()  # type: ignore[union-attr]
    assert float(digits) * 10.0 ** -"⁰¹²³⁴⁵⁶⁷⁸⁹".index(power) == pytest.approx(unit, rel=5e-4)


def test_units_in_the_pages_are_valid() -> None:
    """Units of --gyro-unit and --accel-unit are valid, except in rows that show an error."""
    # A calibration reads raw counts.
    tables = (*LOG_UNITS.values(), *INCREMENT_UNITS.values())
    known = {unit for units in tables for unit in units} | {"count"}
    for page in PAGES:
        lines = page.read_text(encoding="utf-8").splitlines()
        right = "\n".join(line for line in lines if "| 2 |" not in line)
        named = re.findall(r"--(?:gyro|accel)-unit (\S+)", right)
        assert {unit.strip("`.,:") for unit in named} - {"", "UNIT"} <= known, page.name
