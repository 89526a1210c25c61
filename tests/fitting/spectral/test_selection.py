"""Choice of the model."""

import numpy as np
import pytest

from imucal.fitting import CRITERIA, fit
from imucal.fitting.spectral.selection import choose
from imucal.fitting.spectral.structures import all_structures, candidates_of, parameter_columns
from imucal.recording import AxisSeries
from tests.fitting.fits import fitted, ordinates_of, simulated


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
def test_finds_the_true_structure(text: str, structure: str) -> None:
    """Where all terms are detectable the true sum is chosen in at least nine of ten records."""
    hits = 0
    for seed in range(10):
        data = ordinates_of(simulated(text, 60_000, seed))
        choice = choose(data, all_structures(1), criterion="bic", shortest=10.0)
        hits += " + ".join(choice.structures[0]) == structure
    assert hits >= 9


def test_tries_every_sum() -> None:
    """Ninety-four structures of at most two Gauss-Markov terms, none twice, none without noise."""
    structures = all_structures(2)
    assert len(structures) == len(set(structures)) == 94
    assert () not in structures
    assert ("R",) not in structures


def test_prices_of_a_parameter() -> None:
    """BIC log n, Hannan-Quinn 2 log log n, AIC 2."""
    assert CRITERIA["bic"](1e6) == pytest.approx(np.log(1e6))
    assert CRITERIA["hq"](1e6) == pytest.approx(2 * np.log(np.log(1e6)))
    assert CRITERIA["aic"](1e6) == 2


def test_a_lower_price_never_chooses_fewer_parameters() -> None:
    """AIC's model has at least as many parameters as BIC's."""
    samples = simulated("N=1 + B=0.05 + K=1e-3", 60_000, 1)
    rich, plain = (len(fitted(samples, criterion=c).parameters) for c in ("aic", "bic"))
    assert rich >= plain


def test_parameter_names() -> None:
    """One Gauss-Markov term is GM, several are numbered; the columns are those of the candidates."""
    assert parameter_columns(("N", "GM", "K"), 2) == [("N", 1), ("K", 3), ("GM.sigma", 4), ("GM.T", 6)]
    names = [name for name, _ in parameter_columns(("N", "GM", "GM"), 2)]
    assert names == ["N", "GM1.sigma", "GM1.T", "GM2.sigma", "GM2.T"]


def test_candidates_count_their_parameters() -> None:
    """A variance is one, a Gauss-Markov term two, a ramp one, a response its poles."""
    candidates = candidates_of([("N",), ("N", "GM", "GM", "R")], ("R",), poles=[0, 2])
    assert candidates.parameters.tolist() == [1, 8]


def test_says_which_terms_stand_for_one_another() -> None:
    """A record too short to tell flicker from walk says so in words."""
    result = fitted(simulated("N=1 + B=0.15", 6000, 3))
    if len(result.candidates) > 1:
        finding = next(f for f in result.findings if f.code == "model-choice")
        assert finding.text.startswith(f"The record does not tell {result.candidates[0].structure} from ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "magic"}, "method 'magic' is not one of mle, gmwm, slope"),
        ({"criterion": "cv"}, "criterion 'cv' is not one of bic, hq, aic"),
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
def test_refuses_what_it_does_not_know(arguments: dict[str, object], message: str) -> None:
    """A wrong argument is a ValueError that lists what is known."""
    series = AxisSeries.from_samples(simulated("N=1", 200, 1), rate_hz=1.0)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole text is compared
        fit(series, **arguments)  # type: ignore[arg-type]
    assert str(caught.value) == message


def test_a_curve_alone_is_not_enough_for_maximum_likelihood() -> None:
    """The message names the methods that can do with a curve."""
    series = AxisSeries.from_samples(simulated("N=1", 200, 1), rate_hz=1.0)
    curve = fit(series).curve
    with pytest.raises(ValueError, match="maximum likelihood needs the samples, got an Allan curve"):
        fit(curve)
