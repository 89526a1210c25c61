"""Tests of the benchmarks that run together and of the page with their tables."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.benchmarks import all as together
from tests.benchmarks.bench_job import REPEATS, STAGES

ROOT = Path(__file__).parents[1]


def test_the_tables_replace_those_in_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Text above the mark is kept; text below is replaced completely."""
    page = tmp_path / "speed.md"
    page.write_text((ROOT / "docs" / "results" / "speed.md").read_text(encoding="utf-8"), encoding="utf-8")
    above, mark, _ = page.read_text(encoding="utf-8").partition("<!-- measured -->\n")
    assert mark
    calls: list[tuple[str, list[str]]] = []

    def run(name: str, arguments: list[str]) -> tuple[str, int]:
        calls.append((name, arguments))
        return f"| {name} | {len(calls)} |\n", 0

    monkeypatch.setattr(together, "run", run)
    monkeypatch.setattr(sys, "argv", ["all.py", "--page", str(page), "--before", "old", "python3"])
    together.main()
    together.main()
    text = page.read_text(encoding="utf-8")
    assert text.startswith(above + mark)
    count = len(together.BENCHMARKS)
    assert re.findall(r"^## (.*)$", text.partition(mark)[2], re.MULTILINE) == [*together.BENCHMARKS.values()]
    assert re.findall(r"\| (\d+) \|", text.partition(mark)[2]) == [str(count + 1 + i) for i in range(count)]
    assert calls[0] == ("bench_job", ["--before", "old", "python3"])
    assert all(not arguments for name, arguments in calls if name != "bench_job")


def test_a_failed_benchmark_keeps_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is reported, and the other benchmarks run."""
    page = tmp_path / "speed.md"
    page.write_text("<!-- measured -->\nas it was\n", encoding="utf-8")
    monkeypatch.setattr(together, "run", lambda name, _: ("", int(name == "bench_axis")))
    monkeypatch.setattr(sys, "argv", ["all.py", "--page", str(page)])
    with pytest.raises(SystemExit, match=r"^bench_axis failed; see above$"):
        together.main()
    assert page.read_text(encoding="utf-8") == "<!-- measured -->\nas it was\n"


@pytest.mark.parametrize("where", [*STAGES.values(), *REPEATS.values()], ids=lambda where: where[1])
def test_a_measured_stage_exists(where: tuple[str, str]) -> None:
    """A renamed function would count for nothing."""
    file, function = where
    if file.endswith(".py"):
        name = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert callable(getattr(import_module(name), function))


@pytest.mark.parametrize("name", together.BENCHMARKS)
def test_a_listed_benchmark_exists(name: str) -> None:
    """It is a module with a `main`."""
    assert callable(import_module(f"tests.benchmarks.{name}").main)
