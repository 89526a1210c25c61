"""Tests of the parts of an interval after selection: near models, their weights and alternative terms."""

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
    """Return models ranked by criterion; `fit` is twice the sum of objective and number of parameters."""
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
def test_the_weight_of_a_model_decreases_with_its_distance(
    monkeypatch: pytest.MonkeyPatch, distance: float, weight: float, level: float
) -> None:
    """Up to 6 from the best the limits have two standard errors; at 7.5 one, at 8 two thirds, at 9 none."""
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
    """Return the distance and the terms of each completion, in the order of addition."""

    def model(structure: Structure) -> SimpleNamespace:
        return SimpleNamespace(structure=structure, missing=[s for s in ALWAYS if s not in structure])

    monkeypatch.setattr(bounds, "add_term", lambda _, fitted, symbol: model((*fitted.structure, symbol)))
    found = bounds._completed(PROBLEM, choice)
    return [(distance, " ".join(model.structure)) for distance, model in found]


def test_models_nearer_than_9_are_completed_once_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """N, N + B and N + B + K share the completion of the nearest; a model at 9 is ignored."""
    structures: list[Structure] = [("N", "B"), ("N",), ("Q", "N"), ("N", "B", "K"), ("N", "GM"), ("N", "R")]
    choice = _ranked(structures, [10.0, 11.0, 12.5, 13.0, 18.9, 19.0], [0.0] * 6)
    assert _completions(monkeypatch, choice) == [
        (0.0, "N B K"),
        (2.5, "Q N B K"),
        (pytest.approx(8.9), "N GM B K"),
    ]


def test_at_most_sixteen_models_are_completed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The seventeenth is ignored although it is equally near."""
    structures: list[Structure] = [("N", *["GM"] * count) for count in range(18)]
    found = _completions(monkeypatch, _ranked(structures, [0.0] * 18, [0.0] * 18))
    assert [text.count("GM") for _, text in found] == list(range(16))


@pytest.mark.parametrize(
    ("structures", "fit", "named"),
    [
        # Each is in one model and missing in the other.
        ([("N", "B"), ("N", "K")], [0.0, 4.0], {"B": ("K",), "K": ("B",)}),
        # The second model is too far away.
        ([("N", "B"), ("N", "K")], [0.0, 4.1], {}),
        # The third model has neither.
        ([("N", "B"), ("N", "K"), ("N",)], [0.0, 1.0, 2.0], {}),
        # B is in both models, so K does not replace it.
        ([("N", "B"), ("N", "B", "K")], [0.0, 1.0], {}),
        ([("N", "GM"), ("N", "B", "K")], [3.0, 0.0], {"B": ("GM",), "K": ("GM",), "GM": ("B", "K")}),
        # The nearest by likelihood counts, whatever its rank by the criterion.
        ([("N",), ("N", "B"), ("N", "K")], [9.0, 2.0, 0.0], {"B": ("K",), "K": ("B",)}),
    ],
)
def test_replaceable_terms_are_listed_with_their_replacements(
    structures: list[Structure], fit: list[float], named: dict[str, tuple[str, ...]]
) -> None:
    """Every model within 4 of the best likelihood has one of the two terms; neither term is in all models."""
    found = bounds._alternatives(_ranked(structures, [0.0] * len(fit), fit))
    assert {symbol: others for symbol, others in found.items() if others} == named


def test_an_interval_spans_the_lowest_to_the_highest_limit() -> None:
    """It includes the chosen model's value; the same applies to correlation times."""
    own = _estimate("GM", 2.0, 3.0, 4.0, Interval(value=10.0, low=8.0, high=12.0))
    others = [
        _estimate("GM", 1.0, 1.5, 2.0, Interval(value=9.0, low=7.0, high=11.0)),
        _estimate("GM", 2.5, 2.6, 2.7, Interval(value=13.0, low=9.0, high=14.0)),
    ]
    found = bounds._hull(own, [(1.0, other) for other in others])
    assert (found.low, found.value, found.high) == (1.0, 3.0, 3.0)
    assert found.correlation_time == Interval(value=10.0, low=7.0, high=14.0)
    assert bounds._hull(own, []) is own


def test_a_term_that_one_model_excludes_is_bounded() -> None:
    """The bound is the highest limit of all models, although the chosen model estimates the term."""
    own = _estimate("B", 2.0, 3.0, 4.0)
    for weight in (1.0, 0.1):
        found = bounds._hull(own, [(1.0, own), (weight, Estimate.bounded("B", "B", 5.0))])
        assert found == Estimate.bounded("B", "B", 5.0)


@pytest.mark.parametrize(("weight", "low"), [(0.25, 1.5), (0.75, 0.5), (0.99, None), (1.0, None)])
def test_a_random_walk_is_bounded_only_by_a_model_of_full_weight(weight: float, low: float | None) -> None:
    """A model of smaller weight lowers the limit in proportion to its weight."""
    own, zero = _estimate("K", 2.0, 3.0, 4.0), Estimate.bounded("K", "K", 5.0)
    found = bounds._hull(own, [(1.0, own), (weight, zero)])
    assert found == (Estimate.bounded("K", "K", 5.0) if low is None else _estimate("K", low, 3.0, 5.0))
    assert _alternative(weight, zero).excludes("K") == (weight == 1.0)
    assert _alternative(weight, replace(zero, key="B")).excludes("B")


@pytest.mark.parametrize(("low", "reported"), [(0.079, False), (0.081, True)])
def test_a_limit_that_is_printed_as_zero_is_zero(low: float, *, reported: bool) -> None:
    """The threshold is 1/50 of the upper limit: a printed ``34 [0, 77]`` would contradict an estimated K."""
    own = _estimate("K", low, 2.0, 4.0)
    assert (bounds._hull(own, [(1.0, own)]).value is not None) == reported


def test_gauss_markov_terms_are_only_compared_with_the_same_number_of_them() -> None:
    """GM1 of two terms is not comparable with a single GM; N is comparable in all models."""
    n, one, first, second = (_estimate(key, 1.0, 2.0, 3.0) for key in ("N", "GM", "GM1", "GM2"))
    models = [_alternative(1.0, n, one), _alternative(0.5, n, first, second), _alternative(0.2, n)]
    assert bounds._span("N", {"N": n, "GM": one}, models) == [(1.0, n), (0.5, n), (0.2, n)]
    assert bounds._span("GM", {"N": n, "GM": one}, models) == [(1.0, one)]


@pytest.mark.parametrize(("shown", "added"), [({"N", "B"}, "B"), ({"B", "K"}, "BK")])
def test_the_drawn_model_contains_the_reported_terms(
    monkeypatch: pytest.MonkeyPatch, shown: set[str], added: str
) -> None:
    """The reported terms add up to the drawn curve; a dropped Gauss-Markov term is not added again."""

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
