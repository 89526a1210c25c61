"""Tests of the coverage of profile-likelihood intervals, also at the boundary."""

import numpy as np
import pytest

from imucal.fitting.spectral.models import all_structures
from imucal.fitting.spectral.selection import choose
from tests.fitting.fits import estimated, fitted, ordinates_of, simulated

REPEATS = 150
#: Three standard errors of a proportion of 0.95.
SLACK = 3 * np.sqrt(0.95 * 0.05 / REPEATS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "model"),
    [
        ("N=1 + B=0.3", "N + B"),
        pytest.param("N=1 + K=0.03", "N + K", marks=pytest.mark.slow),
        pytest.param("N=1 + GM(sigma=1, T=20)", "N + GM", marks=pytest.mark.slow),
        pytest.param("N=1 + R=1e-3", "N + R", marks=pytest.mark.slow),
        pytest.param("Q=2 + N=1", "Q + N", marks=pytest.mark.slow),
    ],
)
def test_intervals_have_the_nominal_coverage(text: str, model: str) -> None:
    """95 % intervals of each parameter cover the truth in 95 % of the records, within chance."""
    hits: dict[str, int] = {}
    for seed in range(REPEATS):
        result = estimated(simulated(text, 2000, seed), model)
        for part in text.split(" + "):
            key, _, value = part.partition("=")
            if key.startswith("GM"):
                found = result["GM"]
                time = found.correlation_time
                hits["GM"] = hits.get("GM", 0) + (found.low <= 1 <= found.high)
                hits["T"] = hits.get("T", 0) + (time is not None and time.low <= 20 <= time.high)
            else:
                hits[key] = hits.get(key, 0) + (result[key].low <= float(value) <= result[key].high)
    for key, count in hits.items():
        assert count / REPEATS == pytest.approx(0.95, abs=SLACK), key


@pytest.mark.slow
def test_a_bound_covers_an_undetectable_term() -> None:
    """K is below the detection limit: its interval from 0 covers it in at least 95 % of the records."""
    truth, covered, bounded = 2e-3, 0, 0
    for seed in range(REPEATS):
        result = estimated(simulated(f"N=1 + K={truth}", 2000, seed), "N + K")
        covered += result["K"].low <= truth <= result["K"].high
        bounded += result["K"].status == "bounded"
    # The likelihood ratio at a boundary is at most chi-squared, so the bound is conservative.
    assert covered / REPEATS >= 0.95 - SLACK
    assert bounded > REPEATS / 2


@pytest.mark.slow
def test_white_noise_has_no_false_b_or_k() -> None:
    """At most 5 % of the records select B or K."""
    wrong = 0
    for seed in range(100):
        data = ordinates_of(simulated("N=1", 3000, seed))
        choice = choose(data, all_structures(1), criterion="bic", shortest=2.0)
        wrong += bool({"B", "K"} & set(choice.structures[0]))
    assert wrong <= 5


def test_a_higher_level_widens_every_interval() -> None:
    """The 68 % interval is inside the 99 % interval."""
    samples = simulated("N=1 + B=0.2 + K=0.01", 20_000, 1)
    narrow, wide = (fitted(samples, "N + B + K", level=level) for level in (0.68, 0.99))
    for inner, outer in zip(narrow.estimates, wide.estimates, strict=True):
        assert outer.low <= inner.low
        assert inner.high < outer.high
