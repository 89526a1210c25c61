"""What the package looks like from outside: its modules, who imports whom, how long and how branched."""

import ast
import io
import subprocess
import sys
import tokenize
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import imucal

ROOT = Path(imucal.__file__).parent

#: What one fit of a small log loads of the package, counted in a process of its own.
_FIT = """
import sys
from imucal.cli import main
sys.argv = ["imucal", "fit", sys.argv[1], "-o", sys.argv[2], "-q"]
try:
    main()
except SystemExit:
    pass
print(*(name for name in sys.modules if name.partition(".")[0] in {"imucal", "http", "fsspec"}))
"""

#: Tokens that layout and comments make: nobody writes less by leaving them out.
_LAYOUT = frozenset(
    {
        *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
        *(tokenize.ENCODING, tokenize.ENDMARKER),
    }
)

#: What makes another path through a function, each counted once.
_BRANCHES = (
    *(ast.If, ast.IfExp, ast.For, ast.AsyncFor, ast.While, ast.ExceptHandler, ast.Assert),
    *(ast.comprehension, ast.match_case, ast.Lambda),
)


@dataclass(frozen=True, eq=False)
class Module:
    """One file of the package: its dotted name, its text and its syntax tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.text.count("\n")

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder's `__init__`."""
        return self.path.stem == "__init__"

    @property
    def room(self) -> str:
        """The folder of the package that it lies in, at any depth; ``top`` for none."""
        first, *rest = self.path.relative_to(ROOT).parts
        return first if rest else "top"

    @property
    def tokens(self) -> int:
        """Number of names, numbers, operators and strings; comments and docstrings are free."""
        free = {
            line
            for node in ast.walk(self.tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            if isinstance(node.value.value, str)
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
        }
        found = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return sum(token.type not in _LAYOUT and token.start[0] not in free for token in found)

    def functions(self) -> dict[str, int]:
        """Return the cyclomatic complexity of each function, those inside others left to these."""
        found: dict[str, int] = {}
        for node in ast.walk(self.tree):
            for child in ast.iter_child_nodes(node) if not isinstance(node, ast.FunctionDef) else ():
                if isinstance(child, ast.FunctionDef):
                    found[f"{self.name}.{child.name}:{child.lineno}"] = complexity(child)
        return found


class Size(NamedTuple):
    """How much there is to read of a room."""

    lines: int
    tokens: int
    modules: int


@cache
def sizes() -> dict[str, Size]:
    """Return the size of every room, by its name; ``top`` is the package's own folder."""
    rooms: dict[str, list[Module]] = defaultdict(list)
    for module in modules():
        rooms[module.room].append(module)
    return {
        room: Size(sum(m.lines for m in own), sum(m.tokens for m in own), len(own))
        for room, own in rooms.items()
    }


def modules_of_a_fit(log: Path, out: Path) -> list[str]:
    """Return which modules of the package and of what fetches logs one fit loads, its report included."""
    run = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", _FIT, str(log), str(out)], capture_output=True, text=True, check=True
    )
    return run.stdout.splitlines()[-1].split()


def complexity(function: ast.AST) -> int:
    """Return the number of paths: 1 and one more for each branch, condition and filter.

    Source: McCabe (1976), IEEE Trans. Softw. Eng. SE-2, 308; each `and` and `or` is a condition.
    """
    total = 1
    for node in ast.walk(function):
        total += isinstance(node, _BRANCHES)
        total += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
        total += len(node.ifs) if isinstance(node, ast.comprehension) else 0
    return total


@cache
def modules() -> tuple[Module, ...]:
    """Return every module of the package, by name."""
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text(encoding="utf-8")
        found.append(Module(name, path, text, ast.parse(text)))
    return tuple(found)


@cache
def imports() -> dict[str, set[str]]:
    """Return the modules that each module imports, anywhere in its text; folders as their `__init__`."""
    names = {module.name for module in modules()}
    found: dict[str, set[str]] = {}
    for module in modules():
        own = found.setdefault(module.name, set())
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                dotted = {f"{node.module}.{alias.name}" for alias in node.names}
                own |= {name for name in dotted if name in names} or ({node.module} & names)
            elif isinstance(node, ast.Import):
                own |= {alias.name for alias in node.names} & names
        own.discard(module.name)
    return found


def cycles() -> list[list[str]]:
    """Return the sets of modules that import each other in a circle (Tarjan's components)."""
    graph = imports()
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            circle = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(circle) > 1:
                found.append(sorted(circle))

    for name in sorted(graph):
        if name not in index:
            visit(name)
    return found


def files_in_folders() -> dict[str, int]:
    """Return the number of modules that lie directly in each folder, `__init__` aside."""
    counts: dict[str, int] = defaultdict(int)
    for module in modules():
        counts[str(module.path.parent.relative_to(ROOT.parent))] += not module.is_folder
    return dict(counts)
