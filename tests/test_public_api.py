"""Tests of the public names: complete, documented and imported lazily."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import imucal

MODULES = sorted(
    m.name for m in pkgutil.walk_packages(imucal.__path__, "imucal.") if m.name != "imucal.__main__"
)


@pytest.mark.parametrize("name", imucal.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    """None is a module."""
    value = getattr(imucal, name)
    assert not isinstance(value, ModuleType)
    if name != "__version__":
        assert value.__doc__


def test_the_page_has_an_example_of_every_public_name() -> None:
    """There are few, so that a user can read them all."""
    page = (Path(__file__).parents[1] / "docs" / "python.md").read_text(encoding="utf-8")
    examples = "".join(re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL))
    names = set(imucal.__all__) - {"__version__"}
    assert names - set(re.findall(r"\bimucal\.(\w+)", examples)) == set()
    assert len(names) <= 28


def test_every_module_has_a_docstring() -> None:
    """The names in `__all__` exist."""
    for name in MODULES:
        module = importlib.import_module(name)
        assert module.__doc__, f"{name} has no docstring"
        for public in getattr(module, "__all__", ()):
            assert hasattr(module, public) or f"{name}.{public}" in MODULES, f"{name} has no {public}"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'imucal' has no attribute 'nothing'"):
        _ = imucal.nothing


@pytest.mark.parametrize("arguments", [["-c", "import imucal"], ["-m", "imucal", "--help"]])
def test_nothing_heavy_is_imported_before_it_is_used(arguments: list[str]) -> None:
    """Neither the import of the package nor its help loads NumPy or larger packages."""
    heavy = ("numpy", "scipy", "matplotlib", "polars", "rosbags", "mcap", "rich")
    run = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True
    )
    loaded = {line.rsplit("|", 1)[-1].strip() for line in run.stderr.splitlines()}
    assert not loaded.intersection(heavy)
