"""Tests of the pictures of the page on theory, and of its claims."""

import re
from pathlib import Path

import numpy as np
import numpy.testing as npt

from imucal.noise.integrals import avar_from_acvf, avar_from_psd
from tests.benchmarks import theory_figures as script

DOCS = Path(__file__).parents[1] / "docs"


def test_the_page_contains_the_pictures_of_the_script() -> None:
    """There are no other pictures, and files are small."""
    names = re.findall(
        r"\(images/(theory-[a-z0-9-]+)\.png\)", (DOCS / "theory.md").read_text(encoding="utf-8")
    )
    assert sorted(names) == sorted(script.FIGURES)
    for name in names:
        picture = (DOCS / "images" / f"{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) < 300_000


def test_the_pictures_contain_what_their_captions_claim() -> None:
    """The records are shorter than those of the page."""
    ma, additivity = script.moving_average_figure(20), script.additivity_figure(20_000)
    assert {line.get_label() for line in ma.axes[0].lines} >= {"avar_from_psd", "avar_from_acvf"}
    total, *terms = (np.asarray(line.get_ydata()) for line in additivity.axes[0].lines[1:])
    npt.assert_allclose(np.sqrt(np.sum(np.square(terms), axis=0)), total, rtol=1e-12)
    one, other = (np.asarray(line.get_ydata()) for line in script.ambiguity_figure().axes[1].lines)
    npt.assert_allclose(one, other, rtol=1e-9)
    first, second = (np.asarray(line.get_ydata()) for line in script.ambiguity_figure().axes[0].lines)
    assert np.max(first / second) > 1.7
    assert len(script.coverage_figure(20, 512).axes) == 3
    assert [axes.get_title(loc="left") for axes in script.slopes_figure(4096).axes] == [
        "white noise, σ² = 1", "white noise, σ² = 100, walk, γ² = 9·10⁻⁴",
    ]  # fmt: skip
    assert len(script.latent_figure(20_000).axes) == 3


def test_the_moving_average_of_the_page_has_its_closed_form() -> None:
    """(1 + theta²) s²/m² (m + (2m - 3) theta/(1 + theta²)), by psd and by autocovariance."""
    m = np.array([1.0, 2.0, 30.0])
    for theta in (-0.9, 0.4):
        expected = script.moving_average(theta, m)
        npt.assert_allclose(avar_from_acvf([1 + theta**2, theta], m), expected, rtol=1e-9)
        by_psd = avar_from_psd(lambda f, t=theta: 1 + t**2 + 2 * t * np.cos(2 * np.pi * f), m, 1.0)  # type: ignore[misc]
        npt.assert_allclose(by_psd, expected, rtol=1e-9)
