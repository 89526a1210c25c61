"""Tests of the README: its commands and code run, and its output is current."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tests.code_blocks import code_blocks, fill_folder, missing_lines, run_page

ROOT = Path(__file__).parents[1]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.slow
def test_the_readme_runs_from_top_to_bottom(tmp_path: Path) -> None:
    """Blocks run in order in one folder; text and YAML blocks equal the output."""
    page = ROOT / "README.md"
    fill_folder(tmp_path, page)
    blocks = code_blocks(page)
    assert {"python", "console", "toml", "json"} <= {language for language, _ in blocks}
    for printed, output in run_page(page, tmp_path):
        assert missing_lines(printed, output) == [], output
    assert (tmp_path / "report" / "report.html").is_file()
    _shows_the_picture(tmp_path / "report" / "gyro_x.png")
    _shows_the_json(next(text for language, text in blocks if language == "json"), tmp_path)


def _shows_the_picture(drawn: Path) -> None:
    """Check that fewer than 1 % of the pixels differ clearly; other numbers or terms would change more."""
    printed = imread(ROOT / "docs" / "images" / "gyro_x.png")[..., :3]
    own = imread(drawn)[..., :3]
    assert printed.shape == own.shape
    assert np.mean(np.abs(printed - own).max(axis=-1) > 0.25) < 0.01


def _shows_the_json(printed: str, folder: Path) -> None:
    """Compare words exactly and numbers to the three printed digits."""
    document = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    found = document["axes"][0]["fit"]["terms"]
    for symbol, term in json.loads(printed).items():
        for name, value in term.items():
            own = found[symbol][name]
            assert value == (float(f"{own:.3g}") if isinstance(own, float) else own), (symbol, name)
