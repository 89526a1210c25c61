"""Tests of the layers: a folder only imports folders above it in the pipeline."""

import ast
from pathlib import Path

import imucal

ROOT = Path(imucal.__file__).parent

#: Part of the package -> other parts that it may import.
BELOW: dict[str, set[str]] = {
    "arrays": set(),
    "errors": set(),
    "findings": {"errors"},
    "grading": {"errors", "findings"},
    "_version": set(),
    "atomic": {"errors"},
    "clock": {"errors"},
    "display": set(),
    "evidence": {"arrays", "units"},
    "locks": set(),
    "multiple_tests": set(),
    "printable": set(),
    "resources": {"errors", "user_input"},
    "recording": {"arrays", "clock", "display", "errors", "findings", "user_input"},
    "child_process": set(),
    "parallel": {"child_process"},
    "side_work": {"errors", "findings"},
    "powerlaw": {"arrays"},
    "units": {"recording"},
    "user_input": {"errors"},
}
BASE = set(BELOW)
BELOW["remote"] = {"_version", "child_process", "errors", "parallel", "resources", "user_input"}
BELOW |= {
    "readers": BASE | {"remote"},
    "screening": BASE,
    "allan": BASE,
    "noise": BASE,
    "sensors": BASE | {"noise"},
    "fitting": BASE | {"allan", "noise", "screening"},
    "simulation": BASE | {"noise", "readers"},
    "prediction": BASE | {"allan", "noise", "fitting"},
    "report": BASE | {"allan", "noise", "sensors", "fitting", "prediction"},
}
BELOW["rests"] = BASE | {"screening"}
BELOW["planning"] = BELOW["report"] | {"report"}
BELOW["comparison"] = BELOW["planning"]
BELOW["sheet_comparison"] = BELOW["planning"] | {"screening"}
BELOW["calibration"] = BELOW["planning"] | {"screening"}
BELOW["checking"] = BELOW["planning"] | {"comparison", "calibration"}
BELOW["advice"] = BASE | {"screening", "rests", "report"}
BELOW["pipeline"] = BELOW["planning"] | {"screening", "planning", "advice"}
BELOW["fleet"] = BELOW["pipeline"] | {"pipeline", "checking", "readers", "remote"}
BELOW["health"] = BASE | {
    "readers",
    "screening",
    "calibration",
    "noise",
    "allan",
    "fitting",
    "checking",
    "report",
}
BELOW["temperature"] = BASE | {"fitting", "noise", "report", "simulation"}
BELOW["correction"] = BASE | {"calibration", "readers", "temperature"}
BELOW["facade"] = BELOW["fleet"] | {
    "calibration",
    "checking",
    "correction",
    "fleet",
    "health",
    "simulation",
    "temperature",
}
BELOW["cli"] = set(BELOW) | {"cli"}
BELOW["__main__"] = {"cli"}


def part_of(path: Path) -> str:
    """Return the first folder or the module's name."""
    first = path.relative_to(ROOT).parts[0]
    return first.removesuffix(".py")


def imported_parts(path: Path) -> set[str]:
    """Return the parts of imucal that a module imports anywhere."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "imucal":
            names = [node.module] if node.module != "imucal" else [f"imucal.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.split(".")[0] == "imucal"]
        else:
            continue
        found |= {name.split(".")[1] for name in names if "." in name}
    return found


MODULES = sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def test_imports_point_down() -> None:
    """A module imports its own part and those below it."""
    for path in MODULES:
        part = part_of(path)
        above = imported_parts(path) - BELOW[part] - {part}
        assert not above, f"{path.relative_to(ROOT)} imports {above}, which stands above or beside it"


def test_only_the_command_line_prints() -> None:
    """Other parts neither print nor import click."""
    for path in MODULES:
        if part_of(path) in {"cli", "__main__"}:
            continue
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        calls = {n.func.id for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        imports = {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
        assert "print" not in calls, f"{path.relative_to(ROOT)} prints"
        assert "click" not in imports, f"{path.relative_to(ROOT)} imports click"
