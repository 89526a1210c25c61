"""The structure of the package: no import cycles, few modules per folder, functions with few paths."""

import ast
from pathlib import Path

from tests.house import complexity, cycles, files_in_folders, modules, modules_of_a_fit

SAMPLE = Path(__file__).parents[1] / "sample_logs" / "consumer_mems.mcap"

#: Modules of the package that one fit with its report may load: those of tables choose columns of messages.
LOADED = 175


def test_a_fit_loads_few_modules(tmp_path: Path) -> None:
    """Each module is a hop for whoever follows the data through the house; HTTP is for logs behind a URL."""
    loaded = modules_of_a_fit(SAMPLE, tmp_path / "report")
    assert len(loaded) <= LOADED
    assert {name.partition(".")[0] for name in loaded} == {"imucal"}


def test_no_folder_is_crowded() -> None:
    """Thirty-five files are what a listing shows at a glance."""
    crowded = {folder: count for folder, count in files_in_folders().items() if count > 35}
    assert not crowded, f"group these folders' files into rooms: {crowded}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports inside functions count too."""
    assert cycles() == []


def test_folders_offer_a_handful_of_names() -> None:
    """What other rooms use, in `__all__`; its other modules are its own business."""
    for folder in modules():
        if not folder.is_folder or folder.name == "imucal":
            continue
        offered = [
            ast.literal_eval(node.value)
            for node in folder.tree.body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        ]
        assert offered, f"{folder.name} has no __all__; name what other folders use of it"
        assert 1 <= len(offered[0]) <= 8, f"{folder.name} offers {len(offered[0])} names, not 3 to 8"


def test_no_function_has_too_many_paths() -> None:
    """Fifteen; a chain of cases that is longer wants a table or a name for its steps."""
    tangled = {
        name: paths for module in modules() for name, paths in module.functions().items() if paths > 15
    }
    assert not tangled


def test_paths_are_counted_as_mccabe_does() -> None:
    """Each branch, condition and filter is one more."""
    text = "def f(x):\n if x and x > 1:\n  return [y for y in x if y]\n return 1 if x else 2\n"
    assert complexity(ast.parse(text).body[0]) == 6
