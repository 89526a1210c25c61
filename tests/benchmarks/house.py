"""Print the size of each package folder, import cycles, complexity, and the modules of one fit.

    python -m tests.benchmarks.house

`tests/test_house.py` contains the limits of cycles, complexity and modules.
"""

import tempfile
from pathlib import Path

from tests.house import Size, cycles, files_in_folders, modules, modules_of_a_fit, sizes

LOG = Path(__file__).parents[2] / "sample_logs" / "consumer_mems.mcap"


def main() -> None:
    """Print the folders, largest first, then one figure per line."""
    every = modules()
    rooms = sizes()
    total = Size(*map(sum, zip(*rooms.values(), strict=True)))
    print(f"{'room':14}{'lines':>8}{'tokens':>9}{'modules':>9}")
    for room, size in [*sorted(rooms.items(), key=lambda item: -item[1].tokens), ("all", total)]:
        print(f"{room:14}{size.lines:8}{size.tokens:9}{size.modules:9}")
    folder, files = max(files_in_folders().items(), key=lambda item: item[1])
    paths = {name: count for module in every for name, count in module.functions().items()}
    with tempfile.TemporaryDirectory() as scratch:
        loaded = modules_of_a_fit(LOG, Path(scratch) / "report")
    print(f"largest folder               {folder}, {files} files")
    print(f"longest module               {max((m.lines, m.name) for m in every)}")
    print(f"circles of imports           {cycles() or 'none'}")
    print(f"functions of over 15 paths   {sum(count > 15 for count in paths.values())}")
    print(f"most paths                   {max(paths.items(), key=lambda item: item[1])}")
    print(f"modules that one fit loads   {len(loaded)}")


if __name__ == "__main__":
    main()
