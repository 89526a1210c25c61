"""The public names are there, complete, and cost nothing until used."""

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest

import imucal

MODULES = sorted(
    m.name for m in pkgutil.walk_packages(imucal.__path__, "imucal.") if m.name != "imucal.__main__"
)


@pytest.mark.parametrize("name", imucal.__all__)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    """Each loads, and none is a module."""
    value = getattr(imucal, name)
    assert not isinstance(value, ModuleType)
    if name != "__version__":
        assert value.__doc__


def test_every_module_has_a_docstring() -> None:
    """Each has a docstring; a folder names what it offers, and offers it."""
    for name in MODULES:
        module = importlib.import_module(name)
        assert module.__doc__, f"{name} has no docstring"
        for public in getattr(module, "__all__", ()):
            assert hasattr(module, public) or f"{name}.{public}" in MODULES, f"{name} has no {public}"


def test_an_unknown_name_is_an_attribute_error() -> None:
    """As for any module."""
    with pytest.raises(AttributeError, match="module 'imucal' has no attribute 'nothing'"):
        _ = imucal.nothing


@pytest.mark.parametrize("arguments", [["-c", "import imucal"], ["-m", "imucal", "--help"]])
def test_nothing_heavy_is_imported_before_it_is_used(arguments: list[str]) -> None:
    """Importing the package or asking for help loads neither NumPy nor anything heavier."""
    heavy = ("numpy", "scipy", "matplotlib", "polars", "rosbags", "mcap", "rich")
    run = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True
    )
    loaded = {line.rsplit("|", 1)[-1].strip() for line in run.stderr.splitlines()}
    assert not loaded.intersection(heavy)
