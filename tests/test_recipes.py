"""Tests of the recipes in CONTRIBUTING.md, which are followed in a copy of the project."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
#: Files that the tests of a recipe need.
COPIED = ("imucal", "tests", "docs", "sample_logs", "README.md", "CONTRIBUTING.md", "pyproject.toml")
_RECIPES = re.compile(r"^### (?P<name>.+)\n(?P<text>(?:(?!^#{2,3} ).*\n)+)", re.MULTILINE)
_STEP = re.compile(
    r"^\*\*`(?P<file>[^`]+)`\*\*, (?P<how>new|before|after)(?: `(?P<place>[^\n]+)`)?:\n\n"
    r"```\w*\n(?P<block>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_CHECK = re.compile(r"^`pytest (.+)` passes\.$", re.MULTILINE)


class Step(NamedTuple):
    """Lines of a new file, or lines to insert before or after the line that contains `place`."""

    file: str
    how: str
    place: str
    block: str

    def take(self, folder: Path) -> None:
        """Write the lines."""
        path = folder / self.file
        if self.how == "new":
            assert not path.exists(), f"{self.file} is there already"
            path.write_text(self.block, encoding="utf-8")
            return
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        found = [number for number, line in enumerate(lines) if self.place in line]
        assert len(found) == 1, f"{self.file} has {len(found)} lines with {self.place!r}"
        apart = "\n\n" if self.block.startswith(("def ", "@", "class ")) else ""
        lines.insert(found[0] + (self.how == "after"), self.block + apart)
        path.write_text("".join(lines), encoding="utf-8")


def recipes() -> dict[str, str]:
    """Return the text of every recipe by its name."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("\n## Recipes\n")[2]
    return {found["name"]: found["text"] for found in _RECIPES.finditer(text)}


@pytest.mark.slow
@pytest.mark.parametrize("name", recipes())
def test_a_recipe_is_complete(name: str, tmp_path: Path) -> None:
    """After all steps, the tests of the recipe pass."""
    for part in COPIED:
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(
                source, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__", "benchmarks")
            )
        else:
            shutil.copy(source, tmp_path)
    steps = [Step(*found.groups(default="")) for found in _STEP.finditer(recipes()[name])]
    assert len(steps) >= 3, f"{name}: {len(steps)} steps were found"
    for step in steps:
        step.take(tmp_path)
    (check,) = _CHECK.findall(recipes()[name])
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *shlex.split(check)]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(  # noqa: S603 - our own interpreter
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\b[1-9]\d* passed", done.stdout), done.stdout


def test_there_is_a_recipe_for_each_family() -> None:
    assert list(recipes()) == ["A noise term", "A text dialect", "A container", "A config file"]
