"""Pictures and page of a calibration: what is drawn and written, in one file."""

import io
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from imucal import calibrate
from imucal.calibration import Calibration
from imucal.calibration.figures import FIGURES, picture
from imucal.calibration.page import render_page
from imucal.calibration.table import rows
from imucal.calibration.writer import write_calibration
from imucal.errors import WriteError
from tests.calibration.simulated import FACES, GRAVITY
from tests.calibration.test_calibrate import MODELS, drawn


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibrate(drawn(8400, 14)[1].recording(), noise=MODELS, gravity=GRAVITY)


def test_pictures_are_whole(found: Calibration) -> None:
    """Three PNG files of one size."""
    for name in FIGURES:
        with Image.open(io.BytesIO(picture(found, name))) as image:
            assert image.format == "PNG"
            assert image.size == (1600, 688)


def test_the_rests_picture_shows_residuals_with_their_intervals(found: Calibration) -> None:
    """Heights in mm/s² before and after; half-widths are 1.96 deviations."""
    before, after = FIGURES["rests"](found).axes
    for axes, name in ((before, "before"), (after, "residual")):
        container: Any = axes.containers[0]
        heights = container.lines[0].get_ydata()
        np.testing.assert_allclose(heights, [1e3 * getattr(rest, name) for rest in found.rests])
    bars: Any = after.containers[0]
    segments = bars.lines[2][0].get_segments()
    half = [(segment[1][1] - segment[0][1]) / 2 for segment in segments]
    np.testing.assert_allclose(half, [1959.964 * (rest.sigma or 0) for rest in found.rests], rtol=1e-6)


def test_the_discs_have_equal_areas(found: Calibration) -> None:
    """Directions that cover the sphere evenly cover the discs evenly; the suggestion is on one of them."""
    figure = FIGURES["attitudes"](found)
    dots = [line for axes in figure.axes for line in axes.lines if line.get_label() == "rest"]
    assert sum(np.size(line.get_xdata()) for line in dots) == len(found.rests)
    stars = [line for axes in figure.axes for line in axes.lines if line.get_label() == "add this one"]
    assert len(stars) == 1
    for line in dots:
        radius = np.hypot(line.get_xdata(), line.get_ydata())
        # The height of a direction over the equator is 1 - r²/2.
        z = np.sort(1 - radius**2 / 2)
        known = np.sort(
            [abs(rest.up[2]) for rest in found.rests if math.copysign(1, -rest.up[2]) == side(line)]
        )
        np.testing.assert_allclose(z, known, atol=1e-12)


def side(line: object) -> float:
    """Return 1 for the disc of directions with +z down."""
    names = {text.get_text() for text in line.axes.texts}  # type: ignore[attr-defined]
    return 1.0 if "+z" in names else -1.0


def test_the_turns_picture_shows_every_judged_turn(found: Calibration) -> None:
    """Before and after; without a turn a sentence."""
    (axes,) = FIGURES["turns"](found).axes
    after = next(line for line in axes.lines if line.get_label() == "after")
    sizes = [math.hypot(*turn.residual_deg) for turn in found.turns if turn.used and turn.residual_deg]
    np.testing.assert_allclose(np.array(after.get_ydata(), float), sizes)
    (empty,) = FIGURES["turns"](replace(found, turns=())).axes
    assert [text.get_text() for text in empty.texts] == ["no turn could be used"]


def test_the_page_has_every_number_and_loads_nothing(found: Calibration) -> None:
    """Table, three pictures, findings, two lines of code; text of the log is escaped."""
    pictures = {name: picture(found, name) for name in FIGURES}
    evil = replace(found, source=replace(found.source, path="<script>x.csv"))
    text = render_page(evil, pictures)
    for _, own in rows(found):
        for row in own:
            assert f">{row.value.replace('<', '&lt;')}</td>" in text
    assert text.count("data:image/png;base64,") == 3
    assert "f = C_a @ (raw_a - b_a)" in text
    assert "w = C_g @ (raw_g - b_g - G @ f)" in text
    assert "<script>x" not in text
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', text) == []
    assert 'name="units"' not in text
    for finding in found.findings:
        assert f"<code>{finding.code}</code>" in text


def test_raw_counts_and_moved_rests_are_drawn() -> None:
    """Counts have one panel; a rest that moved has a mark of its own."""
    _, one = drawn(8401, 14)
    moved = one.accelerometer.copy()
    first, end = one.spans[4]
    moved[first:end, int(np.argmin(np.abs(one.f[first])))] += np.linspace(0, 0.08, end - first)
    counts = replace(one, accelerometer=400 * moved + 32768)
    found = calibrate(counts.recording(), gravity=GRAVITY)
    figure = FIGURES["rests"](found)
    assert len(figure.axes) == 1
    (mark,) = (line for line in figure.axes[0].lines if line.get_label() == "moved, not used")
    assert np.size(mark.get_xdata()) == 1
    assert "rms from gravity after" in render_page(found, {})


def test_the_folder_is_replaced_and_foreign_files_stay(tmp_path: Path, found: Calibration) -> None:
    """A page of an older run does not survive a run without one."""
    files = write_calibration(found, tmp_path / "out")
    assert [path.name for path in files] == [
        "calibration.json", "rests.png", "attitudes.png", "turns.png", "calibration.html",
    ]  # fmt: skip
    assert all(path.stat().st_size > 1000 for path in files)
    (tmp_path / "out" / "notes.txt").write_text("mine", encoding="utf-8")
    write_calibration(found, tmp_path / "out", html=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["calibration.json", "notes.txt"]
    (tmp_path / "out" / "calibration.json").write_text("{}", encoding="utf-8")
    with pytest.raises(WriteError, match=r"contains calibration\.json"):
        write_calibration(found, tmp_path / "out")


def test_six_faces_have_a_page() -> None:
    """Unknown parameters are named, not drawn."""
    found = calibrate(drawn(8402, up=FACES)[1].recording(), gravity=GRAVITY)
    assert ">not observable</td>" in render_page(found, {name: picture(found, name) for name in FIGURES})
