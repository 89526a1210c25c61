"""The house stays one that others can live in: small rooms, one name each, no circles, short paths."""

import ast

import pytest

from tests.house import Module, complexity, cycles, files_in_folders, modules

FOLDERS = [module for module in modules() if module.is_folder and module.name != "imucal"]


def test_no_folder_is_crowded() -> None:
    """Thirty-five files are what a listing shows at a glance."""
    crowded = {folder: count for folder, count in files_in_folders().items() if count > 35}
    assert not crowded, f"group these folders' files into rooms: {crowded}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports inside functions count too."""
    assert cycles() == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_folder_offers_a_handful_of_names(folder: Module) -> None:
    """What other rooms use, in `__all__`; its other modules are its own business."""
    offered = [
        ast.literal_eval(node.value)
        for node in folder.tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    ]
    assert offered, f"{folder.name} has no __all__; name what other folders use of it"
    assert 1 <= len(offered[0]) <= 8, f"{folder.name} offers {len(offered[0])} names; 3 to 8 are a handful"


@pytest.mark.parametrize("module", modules(), ids=lambda module: module.name)
def test_no_function_has_too_many_paths(module: Module) -> None:
    """Fifteen; a chain of cases that is longer wants a table or a name for its steps."""
    tangled = {name: paths for name, paths in module.functions().items() if paths > 15}
    assert not tangled


def test_paths_are_counted_as_mccabe_does() -> None:
    """Each branch, condition and filter is one more."""
    text = "def f(x):\n if x and x > 1:\n  return [y for y in x if y]\n return 1 if x else 2\n"
    assert complexity(ast.parse(text).body[0]) == 6
