"""Tests of pages that quote imucal: messages, options, pictures and files."""

import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import allantools
import click
import numpy as np
import numpy.testing as npt
import pytest

from imucal.cli import imucal
from tests.benchmarks import peers, tutorial_figures
from tests.code_blocks import code_blocks

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
#: An option of `ros2 topic echo`, and one of a benchmark.
_OTHERS = {"--csv", "--minutes"}


def options_of(command: click.Command) -> Iterator[str]:
    """Yield the names of all options of a command and of its subcommands."""
    for parameter in command.get_params(click.Context(command)):
        if isinstance(parameter, click.Option):
            yield from (*parameter.opts, *parameter.secondary_opts)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            subcommand = command.get_command(context, name)
            assert subcommand is not None
            yield from options_of(subcommand)


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.glob("*.md"))], ids=lambda page: page.stem)
def test_options_in_the_pages_exist(page: Path) -> None:
    """Options of other programs are excluded."""
    options = set(options_of(imucal))
    assert set(_OPTION.findall(page.read_text(encoding="utf-8"))) <= options | _OTHERS


def test_the_tutorial_contains_the_pictures_of_its_script() -> None:
    """There are no other pictures, and files are small."""
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    assert re.findall(r"\(images/([^)]+\.png)\)", page) == list(tutorial_figures.FIGURES)
    for name in tutorial_figures.FIGURES:
        picture = (DOCS / "images" / name).read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) < 300_000
    typed = "".join(text for language, text in code_blocks(DOCS / "tutorial.md") if language == "console")
    assert "-o tutorial\n" in typed


def test_link_targets_of_the_readme_are_in_the_source_archive() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    shipped = settings["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    links = {link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", readme) if ":" not in link}
    assert "CONTRIBUTING.md" in links
    assert sorted(link for link in links if link and Path(link).parts[0] not in shipped) == []


@pytest.mark.parametrize("tool", peers.TOOLS)
def test_every_compared_tool_finds_white_noise(tool: str) -> None:
    """N is within 15 %, so no tool is compared with a wrong recipe."""
    row, *_ = peers.measure("white", {tool: peers.TOOLS[tool]}, records=2, n=100_000, seed=9)
    name, n, *_ = (cell.strip() for cell in row.strip("|").split("|"))
    assert name == tool
    error = re.match(r"[+-][\d.e+-]+", n)
    assert error is not None
    assert abs(float(error[0])) < 15


@pytest.mark.parametrize(("overlapping", "reference"), [(True, allantools.oadev), (False, allantools.adev)])
def test_deviations_of_the_recipes_agree_with_allantools(
    overlapping: bool,  # noqa: FBT001
    reference: Callable[..., Any],
) -> None:
    """Windows are disjoint or overlapping."""
    samples = np.random.default_rng(4).standard_normal(3000)
    tau, adev, _, _ = reference(samples, rate=1.0, data_type="freq", taus=[1.0, 3.0, 10.0, 500.0])
    found = peers.deviations(samples, tau, overlapping=overlapping)
    npt.assert_allclose(found, adev, rtol=1e-9)


def test_the_comparison_contains_every_tool() -> None:
    """Each table has one row per tool, and the page contains the command."""
    page = (DOCS / "results" / "comparison.md").read_text(encoding="utf-8")
    for tool in peers.TOOLS:
        assert len(re.findall(rf"^\| {re.escape(tool)} \|", page, re.MULTILINE)) == len(peers.TRUTHS) + 1
    for model in peers.TRUTHS.values():
        assert f"`{model}`" in page
    assert "python -m tests.benchmarks.peers" in page
