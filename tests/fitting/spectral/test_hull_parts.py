"""The parts of an interval after the choice: the near models, their weights, and the terms named."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.spectral import bounds
from imucal.fitting.spectral.estimates import Problem
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import Structure, models_of
from imucal.fitting.spectral.selection import RankedModels
from imucal.noise.terms import ALWAYS
from tests.fitting.fits import at_maximum, ordinates_of

PROBLEM = Problem(
    ordinates=ordinates_of(np.random.default_rng(0).standard_normal(100)),
    level=0.9545,
    tau0=1.0,
    widening={},
)


def _ranked(structures: list[Structure], criterion: list[float], fit: list[float]) -> RankedModels:
    """Return models by criterion; `fit` is twice the sum of objective and number of parameters."""
    models = models_of(structures, ("R",))
    objective = np.array(fit) / 2 - models.parameters
    fits = at_maximum(np.zeros((models.count, models.width)), models=models, objective=objective)
    return RankedModels(fits=fits, criterion=np.array(criterion), modes=np.full(models.count, np.inf))


def _estimate(key: str, low: float, value: float, high: float, time: Interval | None = None) -> Estimate:
    return Estimate(
        key=key,
        symbol=key.rstrip("12"),
        status="estimated",
        value=value,
        low=low,
        high=high,
        correlation_time=time,
    )


def _alternative(weight: float, *terms: Estimate) -> bounds.Alternative:
    return bounds.Alternative(weight=weight, terms={e.key: e for e in terms}, fitted=cast("Fits", None))


@pytest.mark.parametrize(
    ("distance", "weight", "level"),
    [(0.0, 1.0, 0.9545), (6.0, 1.0, 0.9545), (7.5, 0.5, 0.6827), (8.0, 1 / 3, 0.4950), (8.999, 0.0, 0.0)],
)
def test_a_model_has_less_weight_the_farther_it_is(
    monkeypatch: pytest.MonkeyPatch, distance: float, weight: float, level: float
) -> None:
    """Two standard errors up to 6 from the best; one halfway to 9, two thirds of one at 8, none at 9."""
    levels = []

    def estimates_of(problem: Problem, _: Fits) -> tuple[Estimate, ...]:
        levels.append(problem.level)
        return (_estimate("K", 1.0, 2.0, 3.0),)

    monkeypatch.setattr(bounds, "estimate", estimates_of)
    found = bounds._alternative(PROBLEM, distance, cast("Fits", None))
    assert found.weight == pytest.approx(weight, abs=1e-3)
    assert levels == pytest.approx([level], abs=1e-3)
    assert not found.slow


def _completions(monkeypatch: pytest.MonkeyPatch, choice: RankedModels) -> list[tuple[float, str]]:
    """Return the distance of each completion, and its terms in the order in which they came."""

    def model(structure: Structure) -> SimpleNamespace:
        return SimpleNamespace(structure=structure, missing=[s for s in ALWAYS if s not in structure])

    monkeypatch.setattr(bounds, "add_term", lambda _, fitted, symbol: model((*fitted.structure, symbol)))
    found = bounds._completed(PROBLEM, choice)
    return [(distance, " ".join(model.structure)) for distance, model in found]


def test_models_nearer_than_9_are_completed_once_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """N, N + B and N + B + K have one completion, that of the nearest; at 9 a model is not looked at."""
    structures: list[Structure] = [("N", "B"), ("N",), ("Q", "N"), ("N", "B", "K"), ("N", "GM"), ("N", "R")]
    choice = _ranked(structures, [10.0, 11.0, 12.5, 13.0, 18.9, 19.0], [0.0] * 6)
    assert _completions(monkeypatch, choice) == [
        (0.0, "N B K"),
        (2.5, "Q N B K"),
        (pytest.approx(8.9), "N GM B K"),
    ]


def test_sixteen_models_at_most_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The seventeenth is as near, and is not."""
    structures: list[Structure] = [("N", *["GM"] * count) for count in range(18)]
    found = _completions(monkeypatch, _ranked(structures, [0.0] * 18, [0.0] * 18))
    assert [text.count("GM") for _, text in found] == list(range(16))


@pytest.mark.parametrize(
    ("structures", "fit", "named"),
    [
        # Either is there, and each is missing somewhere.
        ([("N", "B"), ("N", "K")], [0.0, 4.0], {"B": ("K",), "K": ("B",)}),
        # The second is too far to count.
        ([("N", "B"), ("N", "K")], [0.0, 4.1], {}),
        # The third has neither.
        ([("N", "B"), ("N", "K"), ("N",)], [0.0, 1.0, 2.0], {}),
        # B is in all of them: it stands for itself.
        ([("N", "B"), ("N", "B", "K")], [0.0, 1.0], {}),
        ([("N", "GM"), ("N", "B", "K")], [3.0, 0.0], {"B": ("GM",), "K": ("GM",), "GM": ("B", "K")}),
        # The nearest by likelihood counts, wherever the criterion has it.
        ([("N",), ("N", "B"), ("N", "K")], [9.0, 2.0, 0.0], {"B": ("K",), "K": ("B",)}),
    ],
)
def test_a_term_that_another_may_replace_is_named(
    structures: list[Structure], fit: list[float], named: dict[str, tuple[str, ...]]
) -> None:
    """Every model within 4 of the best likelihood has one of the two, and neither is in all of them."""
    found = bounds._alternatives(_ranked(structures, [0.0] * len(fit), fit))
    assert {symbol: others for symbol, others in found.items() if others} == named


def test_an_interval_reaches_from_the_lowest_limit_to_the_highest() -> None:
    """And holds the value of the chosen model; correlation times likewise."""
    own = _estimate("GM", 2.0, 3.0, 4.0, Interval(value=10.0, low=8.0, high=12.0))
    others = [
        _estimate("GM", 1.0, 1.5, 2.0, Interval(value=9.0, low=7.0, high=11.0)),
        _estimate("GM", 2.5, 2.6, 2.7, Interval(value=13.0, low=9.0, high=14.0)),
    ]
    found = bounds._hull(own, [(1.0, other) for other in others])
    assert (found.low, found.value, found.high) == (1.0, 3.0, 3.0)
    assert found.correlation_time == Interval(value=10.0, low=7.0, high=14.0)
    assert bounds._hull(own, []) is own


def test_a_term_that_one_model_does_not_show_is_bounded() -> None:
    """By the highest limit of all, though the chosen model shows it."""
    own = _estimate("B", 2.0, 3.0, 4.0)
    for weight in (1.0, 0.1):
        found = bounds._hull(own, [(1.0, own), (weight, Estimate.bounded("B", "B", 5.0))])
        assert found == Estimate.bounded("B", "B", 5.0)


@pytest.mark.parametrize(("weight", "low"), [(0.25, 1.5), (0.75, 0.5), (0.99, None), (1.0, None)])
def test_a_walk_is_bounded_by_a_model_of_full_weight_only(weight: float, low: float | None) -> None:
    """One that is farther draws its lower limit towards zero, as much as its weight."""
    own, zero = _estimate("K", 2.0, 3.0, 4.0), Estimate.bounded("K", "K", 5.0)
    found = bounds._hull(own, [(1.0, own), (weight, zero)])
    assert found == (Estimate.bounded("K", "K", 5.0) if low is None else _estimate("K", low, 3.0, 5.0))
    assert _alternative(weight, zero).excludes("K") == (weight == 1.0)
    assert _alternative(weight, replace(zero, key="B")).excludes("B")


@pytest.mark.parametrize(("low", "shown"), [(0.079, False), (0.081, True)])
def test_a_limit_that_is_printed_as_zero_is_zero(low: float, *, shown: bool) -> None:
    """Less than a fiftieth of the upper one: ``34 [0, 77]`` would mean that K is there and that it is not."""
    own = _estimate("K", low, 2.0, 4.0)
    assert (bounds._hull(own, [(1.0, own)]).value is not None) == shown


def test_terms_other_than_n_b_and_k_are_compared_among_equals() -> None:
    """GM1 of two is another thing than GM of one; N is N in every model."""
    n, one, first, second = (_estimate(key, 1.0, 2.0, 3.0) for key in ("N", "GM", "GM1", "GM2"))
    models = [_alternative(1.0, n, one), _alternative(0.5, n, first, second), _alternative(0.2, n)]
    assert bounds._span("N", {"N": n, "GM": one}, models) == [(1.0, n), (0.5, n), (0.2, n)]
    assert bounds._span("GM", {"N": n, "GM": one}, models) == [(1.0, one)]


@pytest.mark.parametrize(("shown", "added"), [({"N", "B"}, "B"), ({"B", "K"}, "BK")])
def test_the_drawn_model_gains_what_is_shown_and_keeps_what_it_lost(
    monkeypatch: pytest.MonkeyPatch, shown: set[str], added: str
) -> None:
    """What is printed adds up to the line; a Gauss-Markov term that was dropped does not come back."""

    def add(_: Problem, model: Fits, symbol: str) -> Fits:
        return cast("Fits", SimpleNamespace(structure=(*model.structure, symbol)))

    def estimates_of(_: Problem, model: Fits) -> tuple[Estimate, ...]:
        return tuple(_estimate(symbol, 1.0, 2.0, 3.0) for symbol in model.structure)

    monkeypatch.setattr(bounds, "add_term", add)
    monkeypatch.setattr(bounds, "estimate", estimates_of)
    fitted = cast("Fits", SimpleNamespace(structure=("N", "GM")))
    own = (_estimate("N", 4.0, 5.0, 6.0), _estimate("GM", 1.0, 2.0, 3.0), Estimate.bounded("GM2", "GM", 5.0))
    richer, estimates = bounds._richer(PROBLEM, fitted, shown, own)
    assert richer.structure == ("N", "GM", *added)
    found = {estimate.key: estimate.value for estimate in estimates}
    assert found == {"N": 2.0, "GM": 2.0, "GM2": None, **dict.fromkeys(added, 2.0)}
