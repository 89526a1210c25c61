"""Tests that the README's command for tests installs all modules that they import."""

import ast
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: Benchmarks are not tests, and probes run under interpreters that their users choose.
TESTS = sorted(
    path
    for path in (ROOT / "tests").rglob("*.py")
    if "benchmarks" not in path.parts and not path.name.endswith("_probe.py")
)
#: Modules of extras without which a test is skipped by `importorskip`.
OPTIONAL = frozenset({"adlfs", "gcsfs"})
#: Methods that import a module of another distribution when they are called.
BEHIND = {"cssselect": "cssselect"}


@cache
def named(extra: str) -> frozenset[str]:
    """Return the distributions of an extra, including those of its own extras and of the project."""
    found: set[str] = set()
    for text in PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]:
        requirement = Requirement(text)
        if requirement.name == PROJECT["name"]:
            found |= named("").union(*map(named, requirement.extras))
        else:
            found.add(normal(requirement.name))
    return frozenset(found)


def normal(name: str) -> str:
    """Return a distribution's name as the package index compares it."""
    return name.lower().replace("_", "-").replace(".", "-")


def imported(tree: ast.AST) -> set[str]:
    """Return the top-level names of the modules that a test imports, requests, or reaches by a method."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if node.func.attr == "importorskip" and isinstance(node.args[0], ast.Constant):
                found.add(str(node.args[0].value))
            elif node.func.attr in BEHIND:
                found.add(BEHIND[node.func.attr])
    firsts = {name.partition(".")[0] for name in found}
    return firsts - sys.stdlib_module_names - {"imucal", "tests"} - OPTIONAL


def test_the_test_extra_contains_all_imported_modules() -> None:
    """A module of another extra is missing on a fresh machine."""
    homes = packages_distributions()
    for path in TESTS:
        for module in imported(ast.parse(path.read_text(encoding="utf-8"))):
            distributions = {normal(name) for name in homes.get(module, ())}
            origin = f"{module} comes with {distributions or 'nothing'}"
            assert distributions & named("test"), f"{path.name}: {origin}; name it in the extra [test]"


def test_a_module_outside_the_extras_is_reported() -> None:
    """Modules that only a method needs are found too."""
    tree = ast.parse("import numpy.random\nfrom mypy import api\npage.cssselect('a')\nimport ast")
    assert imported(tree) == {"numpy", "mypy", "cssselect"}
    assert "mypy" not in named("test")
    assert {"numpy", "cssselect", "dask", "s3fs"} <= named("test")
