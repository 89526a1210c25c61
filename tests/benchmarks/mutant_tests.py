"""Tests that may detect a mutant: those that run its line or depend on its value, the nearest first.

A mutant in a function is tested by the tests that run its line. Code that only runs at import is tested by
the tests that run dependent lines: lines with the name of a constant or field, or the body of the function
of a default. The module's own test file comes first; then one test of each function before the second of
any, tests of the same folder before other folders, and fast tests before slow ones.
"""

import ast
import functools
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from tests.benchmarks.mutation_points import Mutation

_Function = ast.FunctionDef | ast.AsyncFunctionDef
#: Use of a name: file and line.
_Place = tuple[str, int]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Tests, lines and durations of the suite without mutants.

    Attributes
    ----------
    root
        Folder of the tree.
    lines
        File -> line -> tests that run it.
    seconds
        Test -> duration while it was recorded.
    slow
        Tests with the marker `slow`.
    """

    root: Path
    lines: dict[str, dict[str, list[str]]]
    seconds: dict[str, float]
    slow: frozenset[str]

    def tests_of(self, path: str, mutation: Mutation) -> tuple[list[str], bool]:
        """Return the tests that may detect a mutant, in order, and whether any runs the mutated code.

        If none does, they are all tests that use the module.
        """
        found = {
            test
            for file, line in _judged_at(self.root, path, mutation)
            for test in self.lines.get(file, {}).get(str(line), ())
        }
        every = {test for tests in self.lines.get(path, {}).values() for test in tests}
        return self._ordered(found or every, path), bool(found)

    def _ordered(self, tests: Iterable[str], path: str) -> list[str]:
        met: Counter[str] = Counter()
        places = []
        for test in sorted(tests, key=lambda test: (_distance(test, path), self.seconds[test], test)):
            function = test.partition("[")[0]
            own = _distance(test, path) < 0
            places.append((0 if own else met[function] + 1, test))
            met[function] += 1
        return [test for _, test in sorted(places, key=lambda place: place[0])]


def _distance(test: str, path: str) -> int:
    """Return the number of folders between a test and a module of the package; -1 for its own tests."""
    file = PurePosixPath(test.partition("::")[0])
    module = PurePosixPath(path)
    if f"{file.stem}_".startswith(f"test_{module.stem}_"):
        return -1
    here, there = file.parts[1:-1], module.parts[1:-1]
    common = sum(itertools.takewhile(bool, map(str.__eq__, here, there)))
    return len(here) + len(there) - 2 * common


def _judged_at(root: Path, path: str, mutation: Mutation) -> set[_Place]:
    """Return the lines whose tests may detect a mutant."""
    chain = list(_around(_tree(root / path), mutation))
    inner = next((node for node in reversed(chain) if isinstance(node, _Function)), None)
    if inner and any(statement in chain for statement in inner.body):
        return {(path, line) for line in range(mutation.first, mutation.line + 1)}
    if inner:
        return {(path, line) for line in range(inner.body[0].lineno, (inner.end_lineno or inner.lineno) + 1)}
    return _users(root, path, {name for node in chain for name in _named(node)})


def _around(tree: ast.Module, mutation: Mutation) -> Iterator[ast.stmt]:
    """Return the statements that contain a line, the outermost first."""
    held: Iterable[ast.stmt] = tree.body
    while found := next((s for s in held if s.lineno <= mutation.line <= (s.end_lineno or s.lineno)), None):
        yield found
        held = [child for child in ast.walk(found) if isinstance(child, ast.stmt) and child is not found]
        held = sorted(held, key=lambda s: (s.lineno, -(s.end_lineno or s.lineno)))


def _users(root: Path, path: str, names: set[str]) -> set[_Place]:
    """Return lines within functions that use one of some names, or values derived from them."""
    places: set[_Place] = set()
    known: set[str] = set()
    while names - known:
        name = (names - known).pop()
        known.add(name)
        for file in [path] if name.startswith("_") else _files(root):
            for statement, line in _uses(root / file).get(name, ()):
                if statement is None:
                    places.add((file, line))
                elif file == path:
                    names |= set(_named(statement))
    return places


@functools.cache
def _files(root: Path) -> list[str]:
    return [file.relative_to(root).as_posix() for file in sorted((root / "imucal").rglob("*.py"))]


@functools.cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_bytes())


@functools.cache
def _uses(file: Path) -> dict[str, list[tuple[ast.stmt | None, int]]]:
    """Return the uses of each name: the statement if it runs at import, and the line."""
    found: dict[str, list[tuple[ast.stmt | None, int]]] = {}

    def collect(node: ast.AST, statement: ast.stmt | None, *, once: bool) -> None:
        if isinstance(node, ast.stmt) and once:
            statement = node
        name = getattr(node, "id", None) or getattr(node, "attr", None)
        if name and isinstance(getattr(node, "ctx", None), ast.Load):
            line = node.lineno  # type: ignore[attr-defined]
            found.setdefault(name, []).append((statement if once else None, line))
        for child in ast.iter_child_nodes(node):
            inside = isinstance(node, ast.Lambda) or (isinstance(node, _Function) and child in node.body)
            collect(child, statement, once=once and not inside)

    collect(_tree(file), None, once=True)
    return found


def _named(statement: ast.stmt) -> Iterator[str]:
    """Return the names that a statement assigns."""
    match statement:
        case ast.Assign(targets=targets):
            yield from (p.id for target in targets for p in ast.walk(target) if isinstance(p, ast.Name))
        case ast.AnnAssign(target=ast.Name(id=name)) | ast.ClassDef(name=name):
            yield name
