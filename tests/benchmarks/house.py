"""The figures of the house: modules, lines, largest folder, circles, branches, and what one fit loads.

    python tests/benchmarks/house.py

`tests/test_house.py` holds the limits.
"""

import subprocess
import sys
from pathlib import Path

from tests.house import cycles, files_in_folders, modules

LOG = Path(__file__).parents[2] / "sample_logs" / "consumer_mems.mcap"
FIT = f"""
import sys
from imucal.cli import main
sys.argv = ["imucal", "fit", {str(LOG)!r}, "--no-report", "-q", "--json"]
try:
    main()
except SystemExit:
    pass
print(sum(name.split(".")[0] == "imucal" for name in sys.modules), file=sys.stderr)
"""


def main() -> None:
    """Print one figure a line."""
    every = modules()
    folder, files = max(files_in_folders().items(), key=lambda item: item[1])
    paths = {name: count for module in every for name, count in module.functions().items()}
    run = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", FIT], capture_output=True, text=True, check=True
    )
    print(f"modules                      {len(every)}")
    print(f"lines                        {sum(module.lines for module in every)}")
    print(f"largest folder               {folder}, {files} files")
    print(f"longest module               {max((m.lines, m.name) for m in every)}")
    print(f"circles of imports           {cycles() or 'none'}")
    print(f"functions of over 15 paths   {sum(count > 15 for count in paths.values())}")
    print(f"most paths                   {max(paths.items(), key=lambda item: item[1])}")
    print(f"modules that one fit loads   {run.stderr.split()[-1]}")


if __name__ == "__main__":
    main()
