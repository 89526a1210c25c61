"""Every command and every line of code in the README does what it says."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tests.cli.run import run
from tests.code_blocks import code_blocks, missing_lines, run_block

ROOT = Path(__file__).parents[1]


def test_the_readme_is_short() -> None:
    """A reader sees the whole of it in a few minutes."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.slow
def test_the_readme_runs_from_top_to_bottom(tmp_path: Path) -> None:
    """In order, in one folder that holds the sample logs and a short `log.mcap`."""
    shutil.copytree(ROOT / "sample_logs", tmp_path / "sample_logs")
    run("simulate", "N=1e-4", "--accel", "N=1e-3", "--duration", "20s", "-o", "log.mcap", cwd=tmp_path)
    blocks = code_blocks(ROOT / "README.md")
    assert {"python", "console", "toml", "json"} <= {language for language, _ in blocks}
    printed = ""
    for language, text in blocks:
        printed += run_block(language, text.replace("pip install . && ", ""), tmp_path)
    assert (tmp_path / "report" / "report.html").is_file()
    printed += (tmp_path / "imu.yaml").read_text(encoding="utf-8")
    for language, text in blocks:
        if language in {"text", "yaml"}:
            assert missing_lines(text.replace("…\n", ""), printed) == []
    _shows_the_picture(tmp_path / "report" / "gyro_x.png")
    _shows_what_the_json_holds(next(text for language, text in blocks if language == "json"), tmp_path)


def _shows_the_picture(drawn: Path) -> None:
    """Fewer than 1 % of the pixels differ clearly; another number or term changes more."""
    shown = imread(ROOT / "docs" / "images" / "gyro_x.png")[..., :3]
    own = imread(drawn)[..., :3]
    assert shown.shape == own.shape
    assert np.mean(np.abs(shown - own).max(axis=-1) > 0.25) < 0.01


def _shows_what_the_json_holds(shown: str, folder: Path) -> None:
    """Words to the letter, numbers to the three digits that are shown."""
    document = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    found = document["axes"][0]["fit"]["terms"]
    for symbol, term in json.loads(shown).items():
        for name, value in term.items():
            own = found[symbol][name]
            assert value == (float(f"{own:.3g}") if isinstance(own, float) else own), (symbol, name)
