"""Tests of model selection."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import signal

from imucal.fitting import CRITERIA, FitSettings, fit
from imucal.fitting.spectral import selection
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.maximum import maximize
from imucal.fitting.spectral.mle import spectral_view
from imucal.fitting.spectral.models import Structure, all_structures, models_of
from imucal.fitting.spectral.selection import (
    RankedModels,
    _distinct,
    _ranked,
    choice_findings,
    choose,
    near_candidates,
)
from imucal.recording import AxisSeries
from tests.fitting.fits import at_maximum, fitted, ordinates_of, simulated


@pytest.mark.parametrize(
    ("text", "structure"),
    [
        ("N=1", "N"),
        ("N=1 + K=5e-3", "N + K"),
        ("Q=2 + N=1 + K=5e-3", "Q + N + K"),
        ("N=1 + B=0.3", "N + B"),
        ("N=1 + GM(sigma=0.5, T=100)", "N + GM"),
        ("N=1 + R=1e-4", "N + R"),
    ],
)
def test_the_true_structure_is_selected(text: str, structure: str) -> None:
    """If all terms are detectable, selection finds them in at least nine of ten records."""
    hits = 0
    for seed in range(10):
        data = ordinates_of(simulated(text, 60_000, seed))
        choice = choose(data, all_structures(1), criterion="bic", shortest=10.0)
        hits += " + ".join(choice.structures[0]) == structure
    assert hits >= 9


@pytest.mark.slow
@pytest.mark.parametrize(("poles", "corner"), [(1, 0.3), (2, 0.17), (3, 0.05)])
def test_the_best_structure_behind_a_filter_is_selected(poles: int, corner: float) -> None:
    """No selected model is worse than the true structure with a search from the truth."""
    text, truth = "N=1 + B=0.25", {"N": 1.0, "B": 0.25}
    for seed in range(40, 44):
        raw = simulated(text, 102_000, seed)
        seen = signal.sosfilt(signal.butter(poles, corner, output="sos"), raw)[2000:]
        view = spectral_view(AxisSeries.from_samples(seen, rate_hz=1.0).finite(), FitSettings(), None)
        data, band = view.ordinates, view.band
        structures = [s for s in all_structures(1, quantization=False) if "N" in s]
        choice = choose(data, structures, criterion="bic", band=band, shortest=10.0)
        own = models_of([tuple(truth)], data.names, poles=band.poles, shortest=10.0)
        start = np.zeros((1, own.width))
        for symbol, column in own.columns(start[0]):
            start[0, column] = 2 * np.log(truth[symbol] / data.scale)
        start[0, own.response :] = band.response
        best = maximize(data, own, start).objective[0]
        cost = CRITERIA["bic"](data.count) * own.parameters[0]
        assert choice.criterion[0] <= 2 * best + cost + 0.01


def test_every_sum_is_tried() -> None:
    """There are 94 different structures with at most two Gauss-Markov terms, none without noise."""
    structures = all_structures(2)
    assert len(structures) == len(set(structures)) == 94
    assert () not in structures
    assert ("R",) not in structures


def test_the_price_of_a_parameter() -> None:
    """BIC log n, Hannan-Quinn 2 log log n, AIC 2."""
    assert CRITERIA["bic"](1e6) == pytest.approx(np.log(1e6))
    assert CRITERIA["hq"](1e6) == pytest.approx(2 * np.log(np.log(1e6)))
    assert CRITERIA["aic"](1e6) == 2
    assert CRITERIA["chance"](1e4) == CRITERIA["chance"](1e7) == 12


def test_a_lower_price_never_selects_fewer_parameters() -> None:
    """AIC's model has at least as many parameters as BIC's."""
    samples = simulated("N=1 + B=0.05 + K=1e-3", 60_000, 1)
    rich, plain = (len(fitted(samples, criterion=c).parameters) for c in ("aic", "bic"))
    assert rich >= plain


def test_parameter_names() -> None:
    """A single Gauss-Markov term is GM, several are numbered."""
    models = models_of([("N", "GM", "K"), ("N", "GM", "GM")], ())
    assert models.columns(np.zeros(8)) == [("N", 1), ("K", 3), ("GM.sigma", 4), ("GM.T", 6)]
    names = [name for name, _ in models[[1]].columns(np.zeros(8))]
    assert names == ["N", "GM1.sigma", "GM1.T", "GM2.sigma", "GM2.T"]


def test_candidates_count_their_parameters() -> None:
    """A variance has one, a Gauss-Markov term two, a ramp one, and a response one per pole."""
    candidates = models_of([("N",), ("N", "GM", "GM", "R")], ("R",), poles=[0, 2])
    assert candidates.parameters.tolist() == [1, 8]


def test_exchangeable_terms_are_reported() -> None:
    """A short record cannot separate flicker noise from a random walk."""
    result = fitted(simulated("N=1 + B=0.15", 6000, 3))
    if len(result.candidates) > 1:
        finding = next(f for f in result.findings if f.code == "model-choice")
        first = result.candidates[0].structure
        assert finding.text.startswith(f"The record can't separate {first} from ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "magic"}, "method 'magic' is not one of mle, gmwm, slope"),
        ({"criterion": "cv"}, "criterion 'cv' is not one of chance, bic, hq, aic"),
        ({"weights": "none"}, "weights 'none' is not one of full, eta3"),
        ({"level": 1.0}, "level must be between 0 and 1, got 1.0"),
        ({"max_gm": 5}, "max_gm must be 0, 1 or 2, got 5"),
        (
            {"model": "N + X"},
            "model 'N + X': 'X' is not one of Q, N, B, GM, K, R; write 'N + B + K' or 'N + 2*GM'",
        ),
        (
            {"temperature": np.zeros(3)},
            "temperature must have shape (200,) like the samples, got (3,)",
        ),
    ],
)
def test_unknown_arguments_are_rejected(arguments: dict[str, object], message: str) -> None:
    """The ValueError lists the valid values."""
    series = AxisSeries.from_samples(simulated("N=1", 200, 1), rate_hz=1.0)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole text is compared
        fit(series, **arguments)  # type: ignore[arg-type]
    assert str(caught.value) == message


def test_maximum_likelihood_rejects_a_curve() -> None:
    series = AxisSeries.from_samples(simulated("N=1", 200, 1), rate_hz=1.0)
    curve = fit(series).curve
    with pytest.raises(ValueError, match="got an Allan curve"):
        fit(curve)


def _maximum(objective: Sequence[float], structures: list[Structure]) -> Fits:
    """Return fits of some structures with given objectives; theta is the row number."""
    rows = len(objective)
    return at_maximum(
        np.arange(rows, dtype=np.float64)[:, None],
        models=models_of(structures, ()),
        objective=np.array(objective, dtype=np.float64),
        information=np.zeros((rows, 1, 1)),
        beta=np.zeros((rows, 0)),
        beta_covariance=np.zeros((rows, 0, 0)),
    )


def _models(structures: list[Structure], criterion: list[float], second: float = np.inf) -> RankedModels:
    """Return ranked models; the best has a second maximum `second` below the first."""
    return RankedModels(
        fits=_maximum([0.0] * len(structures), structures),
        criterion=np.array(criterion),
        modes=np.array([second, *[np.inf] * (len(structures) - 1)]),
    )


@pytest.mark.parametrize(
    ("structures", "criterion", "text"),
    [
        ([("N",)], [3.0], None),
        ([("N",), ("N", "K")], [3.0, 9.5], None),
        ([("N",), ("N", "K")], [3.0, 9.0], "N from N + K (+6.0): K may or may not be present."),
        (
            [("N", "B"), ("N", "K"), ("N", "GM"), ("Q", "N")],
            [3.0, 4.0, 8.5, 20.0],
            "N + B from N + K (+1.0), N + GM (+5.5): it can't distinguish B, GM and K.",
        ),
        (
            [("N", "GM"), ("N", "GM", "GM")],
            [0.0, 2.5],
            "N + GM from N + 2*GM (+2.5): it may have 1 to 2 GM terms.",
        ),
    ],
)
def test_near_models_are_reported_with_their_different_terms(
    structures: list[Structure], criterion: list[float], text: str | None
) -> None:
    """Near models are within 6 of the best; without any there is no finding."""
    findings = choice_findings(_models(structures, criterion), "gyro_x")
    if text is None:
        assert findings == ()
        return
    (finding,) = findings
    assert (finding.level, finding.code, finding.axis) == ("info", "model-choice", "gyro_x")
    assert finding.text == f"The record can't separate {text}"


@pytest.mark.parametrize(("second", "reported"), [(1.9, True), (2.0, False), (np.inf, False)])
def test_a_second_maximum_is_reported_if_it_is_about_as_good(second: float, *, reported: bool) -> None:
    """Twice its log-likelihood is within 4 of the maximum."""
    findings = choice_findings(_models([("N", "GM")], [1.0], second), "gyro_x")
    assert [(f.level, f.code) for f in findings] == ([("warning", "two-maxima")] if reported else [])


def test_near_models_are_listed_with_their_distance() -> None:
    """The best has distance 0; models beyond 6 are omitted."""
    near = near_candidates(_models([("N",), ("N", "K"), ("B",)], [10.0, 16.0, 16.1]))
    assert [(c.structure, c.delta) for c in near] == [("N", 0.0), ("N + K", 6.0)]


@pytest.mark.parametrize(
    ("objective", "kept"),
    [
        ([5.0, 3.0], [1, 0]),
        ([3.0, 3.015, 3.1, 3.2], [0, 2]),
        ([3.0, 13.0], [0]),
        ([3.0, 12.9], [0, 1]),
        ([4.0], [0]),
    ],
)
def test_a_distinct_second_maximum_is_kept(objective: list[float], kept: list[int]) -> None:
    """The best maximum is kept, and the next one if it is worse by more than 0.02 and less than 10."""
    assert _distinct(np.arange(len(objective)), np.array(objective)) == kept


def test_candidates_are_ranked_by_their_best_maximum_and_its_price() -> None:
    """Two candidates with two or three maxima have a price and a distance to the second maximum."""
    structures: list[Structure] = [("N",), ("B",), ("N", "K")]
    ranked = _ranked(
        _maximum([7.0, 6.0, 5.0, 5.5, 5.01], [structures[i] for i in (0, 0, 2, 2, 2)]),
        owner=np.array([0, 0, 2, 2, 2]),
        near=np.array([0, 2]),
        cost=np.array([1.0, 0.0, 5.0]),
    )
    assert ranked.structures == [("N",), ("N", "K")]
    assert ranked.criterion.tolist() == [13.0, 15.0]
    assert ranked.fits.theta[:, 0].tolist() == [1.0, 2.0]
    assert ranked.modes.tolist() == [1.0, 0.5]


@pytest.mark.parametrize("poles", [0, 2])
def test_the_response_is_fixed_in_the_first_round(monkeypatch: pytest.MonkeyPatch, poles: int) -> None:
    """Every start has the coefficients of the found response; they are free in later rounds."""
    calls: list[dict[str, Any]] = []

    def recorded(*args: Any, **named: Any) -> Fits:  # noqa: ANN401 - passed on as they are
        calls.append({"candidates": args[1], "theta": args[2].copy(), "free": named.get("free")})
        return maximize(*args, **named)

    monkeypatch.setattr(selection, "maximize", recorded)
    response = np.array([0.5, 2.0])[:poles]
    band = Band(response=response)
    data = ordinates_of(simulated("N=1", 2000, 1))
    choose(data, [("N",), ("N", "K")], criterion="bic", shortest=10.0, band=band if poles else None)
    first, last = calls[0], calls[-1]
    width = first["candidates"].width
    assert (first["theta"][:, width - poles :] == response).all()
    expected = first["candidates"].free.copy()
    expected[:, width - poles :] = False
    assert (first["free"] == expected).all()
    assert last["candidates"].free[:, width - poles :].all()
