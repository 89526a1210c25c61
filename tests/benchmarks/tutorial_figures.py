"""The plots of docs/tutorial.md and the README, created by running their commands.

    python -m tests.benchmarks.tutorial_figures [folder]

It writes to docs/images (or the folder) in about ten seconds.
"""

import shutil
import sys
import tempfile
from pathlib import Path

from tests.code_blocks import code_blocks, run_block

__all__ = ["FIGURES", "draw"]

_DOCS = Path(__file__).parents[2] / "docs"
#: Picture of the page -> file that the commands write.
FIGURES = {
    "tutorial-gyro_x.png": "tutorial/gyro_x.png",
    "tutorial-accel.png": "tutorial/accel.png",
}


def draw(folder: Path) -> None:
    """Run the page's commands in a temporary folder, and copy the pictures."""
    with tempfile.TemporaryDirectory() as scratch:
        for language, text in code_blocks(_DOCS / "tutorial.md"):
            if language == "console":
                run_block(language, text, Path(scratch))
            if (Path(scratch) / "tutorial").is_dir():
                break
        log = str(_DOCS.parent / "sample_logs" / "consumer_mems.mcap")
        run_block("console", f"imucal fit {log} -o report", Path(scratch))
        for name, made in (*FIGURES.items(), ("gyro_x.png", "report/gyro_x.png")):
            shutil.copy(Path(scratch) / made, folder / name)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else _DOCS / "images")
