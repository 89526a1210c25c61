"""The benchmarks that are run together, and the page that their tables go to."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.benchmarks import all as together
from tests.benchmarks.bench_job import REPEATS, STAGES

ROOT = Path(__file__).parents[1]


def test_the_tables_replace_those_in_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands above the mark stays; another run replaces the whole of what stands below it."""
    page = tmp_path / "speed.md"
    page.write_text((ROOT / "docs" / "results" / "speed.md").read_text(encoding="utf-8"), encoding="utf-8")
    above, mark, _ = page.read_text(encoding="utf-8").partition("<!-- measured -->\n")
    assert mark
    asked: list[tuple[str, list[str]]] = []

    def run(name: str, arguments: list[str]) -> tuple[str, int]:
        asked.append((name, arguments))
        return f"| {name} | {len(asked)} |\n", 0

    monkeypatch.setattr(together, "run", run)
    monkeypatch.setattr(sys, "argv", ["all.py", "--page", str(page), "--before", "old", "python3"])
    together.main()
    together.main()
    text = page.read_text(encoding="utf-8")
    assert text.startswith(above + mark)
    count = len(together.BENCHMARKS)
    assert re.findall(r"^## (.*)$", text.partition(mark)[2], re.MULTILINE) == [*together.BENCHMARKS.values()]
    assert re.findall(r"\| (\d+) \|", text.partition(mark)[2]) == [str(count + 1 + i) for i in range(count)]
    assert asked[0] == ("bench_job", ["--before", "old", "python3"])
    assert all(not arguments for name, arguments in asked if name != "bench_job")


def test_a_benchmark_that_fails_leaves_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is named, and the others run all the same."""
    page = tmp_path / "speed.md"
    page.write_text("<!-- measured -->\nas it was\n", encoding="utf-8")
    monkeypatch.setattr(together, "run", lambda name, _: ("", int(name == "bench_axis")))
    monkeypatch.setattr(sys, "argv", ["all.py", "--page", str(page)])
    with pytest.raises(SystemExit, match=r"^bench_axis failed; see above$"):
        together.main()
    assert page.read_text(encoding="utf-8") == "<!-- measured -->\nas it was\n"


@pytest.mark.parametrize("where", [*STAGES.values(), *REPEATS.values()], ids=lambda where: where[1])
def test_a_stage_that_is_measured_is_there(where: tuple[str, str]) -> None:
    """A function that was renamed would count for nothing."""
    file, function = where
    if file.endswith(".py"):
        name = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert callable(getattr(import_module(name), function))


@pytest.mark.parametrize("name", together.BENCHMARKS)
def test_a_benchmark_that_is_run_is_there(name: str) -> None:
    """As a module with a `main`."""
    assert callable(import_module(f"tests.benchmarks.{name}").main)
