"""The house stays one that others can live in: rooms within a budget, no circles, short paths."""

import ast
from pathlib import Path

from tests.house import Size, complexity, cycles, files_in_folders, modules, modules_of_a_fit, sizes
from tests.plain_english import awkward, counts

SAMPLE = Path(__file__).parents[1] / "sample_logs" / "consumer_mems.mcap"

#: Lines, tokens and modules that each room may have. Numbers go down with the room; one goes up only
#: with a comment behind it that says what the room has got for it.
BUDGET = {
    "readers": Size(10924, 85359, 55),  # one chooser for topics, tables and flight logs; changes of the rate
    "fitting": Size(8137, 66045, 37),  # smoothing, humps, warm-ups, slow cycles and many lost samples
    "report": Size(5077, 39275, 23),  # one writer for all result folders; pictures in three modules
    "top": Size(4537, 26958, 26),  # checked advice for a disturbed log; checked arguments, simulate()
    "cli": Size(3821, 24751, 20),  # calibrate, exports of its result, options in groups
    "fleet": Size(1424, 11927, 6),  # its logs in one form for the population
    "allan": Size(1653, 12474, 6),  # graded lags and runs that the fits use too
    "fleet_report": Size(1628, 12658, 7),  # values of a log made where they are looked at
    "fleet_run": Size(1265, 8939, 6),  # call and command are one flow with one set of settings
    "checking": Size(1143, 9111, 5),  # configs of filters read back; limits for calibrations
    "calibration": Size(4015, 30637, 23),  # bias, scale and misalignment; JSON, table, exports, page
    "noise": Size(1143, 7688, 5),  # models with units
    "screening": Size(1150, 8822, 4),  # interpolated samples, moving accelerometers without gravity
    "remote": Size(1009, 6358, 4),  # progress by the furthest byte, redirects said in words
    "prediction": Size(920, 6707, 5),  # terms without an upper limit
}
#: The whole package. It is on its way down: what is wanted is 44 000 lines and 300 000 tokens.
# What real sensors and loggers do has taken 840 lines: clocks, smoothing, humps, warm-ups, lost samples;
# advice that is checked before it is printed another 150; advice for wrong arguments in Python 250.
# Calibration from rests is a new feature: estimate, command, 13 exports, three pictures and a page.
# Texts of the tables of formats and exit codes moved from the docs into the code: 50 lines.
IN_ALL = Size(47_846, 357_709, 232)
#: Modules of the package that one fit with its report may load: those of tables choose columns of messages.
LOADED = 145


def beyond(size: Size, budget: Size) -> dict[str, str]:
    """Return what of a size is more than a budget has."""
    return {
        name: f"{have}, not {may}"
        for name, have, may in zip(Size._fields, size, budget, strict=True)
        if have > may
    }


def test_every_room_keeps_its_budget() -> None:
    """More is paid for in the same room, or in a line above that says why."""
    over = {room: beyond(size, BUDGET[room]) for room, size in sizes().items()}
    over = {room: each for room, each in over.items() if each}
    assert not over, f"over budget: {over}; take away as much as you add"


def test_budgets_follow_their_rooms_down() -> None:
    """What was saved stays saved: a limit stands a hundredth above its room, or as much as a small edit."""
    loose = {}
    for room, size in sizes().items():
        slack = Size(max(size.lines // 100, 20), max(size.tokens // 100, 150), 0)
        if beyond(BUDGET[room], Size(*map(sum, zip(size, slack, strict=True)))):
            loose[room] = size
    assert not loose, f"rooms have become smaller; write these into BUDGET: {loose}"


def test_the_house_keeps_its_budget() -> None:
    """All rooms together."""
    assert not beyond(Size(*map(sum, zip(*sizes().values(), strict=True))), IN_ALL)


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


#: Awkward constructions, as `tests.plain_english` counts them. A number may fall and not rise.
AWKWARD = {"code": 48, "messages": 3, "docs": 23}


def test_awkward_constructions_are_counted() -> None:
    """Clauses in place of nouns, things that speak, and rare words; plain sentences have none."""
    assert awkward("It writes what the model has. A message says so; else it stands beside those of x.") >= 5
    assert awkward("A message explains the problem. Return the number of samples, or None.") == 0


def test_the_language_stays_as_plain_as_it_is() -> None:
    """Rewrite the sentence if this fails; lower the number if it has become smaller."""
    found = counts()
    assert {kind: number for kind, number in found.items() if number > AWKWARD[kind]} == {}
    assert {kind: number for kind, number in found.items() if number < 0.9 * AWKWARD[kind]} == {}
