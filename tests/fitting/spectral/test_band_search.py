"""Tests of the search for a band: which description is sufficient, and where a response starts."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from scipy import signal

from imucal.arrays import FloatArray
from imucal.fitting.spectral import maximum
from imucal.fitting.spectral.disturbances import band as filter_response
from imucal.fitting.spectral.disturbances import band_search
from imucal.fitting.spectral.disturbances.band import Band, Order, start_response
from imucal.fitting.spectral.disturbances.band_search import (
    _around_hump,
    _BandSearch,
    _coarse,
    _deviation_of_white,
    _enough,
    _simplest,
    _Trial,
    find_band,
)
from imucal.fitting.spectral.disturbances.hump import Hump
from imucal.fitting.spectral.likelihood import Fits, evaluate
from imucal.fitting.spectral.models import models_of
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates
from tests.fitting.fits import at_maximum, ordinates_of, simulated


def _maximum(objective: float, information: FloatArray) -> Fits:
    return at_maximum(
        np.zeros((1, SHAPED)),
        objective=np.array([objective]),
        information=information[None],
        beta=np.zeros((1, 0)),
        beta_covariance=np.zeros((1, 0, 0)),
    )


def _trial(order: Order, objective: float, statistic: float = 0.0) -> _Trial:
    maximum = _maximum(objective, np.zeros((SHAPED, SHAPED)))
    return _Trial(fraction=1.0, order=order, fit=maximum, statistic=statistic, octaves=0.5, deviation=0.1)


@pytest.mark.parametrize(
    ("statistic", "gains", "enough"),
    [
        (2.99, (8.9, 11.9), True),
        (3.0, (0.0, 0.0), False),
        (0.0, (9.0, 0.0), False),
        (0.0, (0.0, 12.0), False),
        (0.0, (8.9,), True),
        (-9.0, (), True),
    ],
)
def test_a_sound_description_gains_no_more_than_chance(
    statistic: float, gains: tuple[float, ...], *, enough: bool
) -> None:
    """The score is below 3, and twice the log-likelihood gains less than 9 by one order and 12 by two."""
    more = [_trial((k + 1, 0), 100 - gain / 2) for k, gain in enumerate(gains)]
    assert _enough([_trial((0, 0), 100.0, statistic), *more]) == enough


def test_the_flat_band_has_higher_thresholds() -> None:
    """The score is below 4, the gains below 12 and 15, or 30 and 33 if quantization may shape the band."""
    assert (band_search._SOUND_FLAT, band_search._GAIN_FLAT) == (4.0, (12.0, 15.0))
    assert (band_search._GAIN_QUANTIZED, band_search._QUANTIZED) == ((30.0, 33.0), 0.2)
    trials = [_trial((0, 0), 100.0, 3.9), _trial((1, 0), 100 - 5.9), _trial((2, 0), 100 - 7.4)]
    assert _enough(trials, band_search._GAIN_FLAT, band_search._SOUND_FLAT)
    assert not _enough(trials)


def test_the_simplest_sound_order_is_returned_with_the_next_one() -> None:
    """Orders are sorted by poles plus zeros; an order whose next one is missing is skipped."""
    trials = [
        _trial((0, 0), 100.0),
        _trial((1, 0), 50.0),
        _trial((1, 1), 40.0),
        _trial((2, 0), 49.0),
        _trial((2, 1), 39.0),
        _trial((3, 0), 48.0),
    ]
    found = _simplest(trials)
    assert found is not None
    assert [t.order for t in found] == [(1, 0), (2, 0)]
    assert _simplest(trials[:1]) is None
    without = _simplest([t for t in trials if t.order not in {(1, 0), (2, 0)}])
    assert without is not None
    assert [t.order for t in without] == [(1, 1), (2, 1)]


def test_the_tried_orders() -> None:
    """They have up to five poles, or with zeros, as many poles or one or two more."""
    assert band_search._ALL_POLES == [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (5, 0)]
    assert set(band_search._WITH_ZEROS) - set(band_search._ALL_POLES) == {
        *((1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (4, 2)),
        *((3, 3), (4, 3), (5, 3), (4, 4), (5, 4)),
    }


def test_the_standard_error_of_white_noise_is_half_that_of_its_log_variance() -> None:
    """It is infinite if the model has no white noise."""
    information = np.diag([1.0, 25.0, 1.0, 1.0])
    white = _maximum(0.0, information)
    assert _deviation_of_white(white) == pytest.approx(0.1)
    assert _deviation_of_white(replace(white, models=models_of([("B",)], ()))) == np.inf


def test_the_level_at_the_top_is_the_mean_of_the_last_eight_bins() -> None:
    """The mean is the power divided by the number of ordinates."""
    data = ordinates_of(simulated("N=1", 2000, 1))
    search = _BandSearch(data, ("N",), 10.0)
    assert search.level_at_the_top() == pytest.approx(data.power[-8:].sum() / data.size[-8:].sum())


def test_white_noise_dominates_the_top_of_its_band() -> None:
    """It does for white noise, but not for a random walk."""
    for text, white in (("N=1", True), ("K=1", False)):
        data = ordinates_of(simulated(text, 2000, 2))
        assert _BandSearch(data, ("N", "K"), 10.0).white_at_the_top() == white


def _shaped(data: Ordinates, order: Order, response: FloatArray, white: float) -> Ordinates:
    """Return ordinates with the exact power of white noise behind a response."""
    x = data.lam / data.top
    shape = (1 - data.lam / 4) ** order[1] / (1 + x[:, None] ** np.arange(1, order[0] + 1) @ response)
    return replace(data, power=data.size * white * shape)


@pytest.mark.parametrize(
    ("order", "response"),
    [((1, 0), [2.0]), ((2, 0), [-0.5, 6.0]), ((2, 2), [-1.5, 3.0]), ((3, 1), [0.5, 0.1, 9.0])],
)
def test_a_response_starts_at_the_true_coefficients(order: Order, response: list[float]) -> None:
    """For white noise without scatter, the regression returns variance and coefficients to rounding."""
    data = _shaped(ordinates_of(simulated("N=1", 2000, 1)).below(0.9), order, np.array(response), 7.0)
    low = np.array([[1.0, 2.0, 3.0, 4.0]])
    theta = start_response(data, low, order, width=4, room=5)
    npt.assert_allclose(theta[0, [0, 2, 3]], [1.0, 3.0, 4.0])
    assert np.exp(theta[0, 1]) == pytest.approx(7.0, rel=1e-6)
    npt.assert_allclose(theta[0, 4 : 4 + order[0]], response, rtol=1e-5)
    npt.assert_array_equal(theta[0, 4 + order[0] :], 0.0)
    assert theta.shape == (1, 9)


def test_a_very_sharp_resonance_starts_at_a_butterworth_response() -> None:
    """No regression is positive there; the start is the best of several Butterworth responses."""
    data = ordinates_of(simulated("N=1", 2000, 1)).below(1.0)
    wild = _shaped(data, (1, 0), np.array([-0.9999]), 1.0)
    theta = start_response(wild, np.zeros((1, 4)), (2, 0), width=4, room=2)
    model = models_of([("N",)], data.names, poles=2)
    assert np.isfinite(evaluate(wild, model, theta).objective[0])


def test_a_flat_start_is_the_butterworth_response_nearest_to_the_data() -> None:
    """For white noise behind a tried Butterworth response, it is that response with its level."""
    data = ordinates_of(simulated("N=1", 2000, 1)).below(1.0)
    low, high, steps = filter_response.CORNERS
    corner = np.geomspace(low, high, steps)[12]
    for order in ((2, 0), (3, 0), (2, 2)):
        poles, zeros = order
        at = np.sin(np.pi / 2 * corner) ** 2
        numerator = (1 - data.lam / 4) ** zeros
        slope = (data.lam / 4 / at) ** poles * (1 - at) ** zeros
        wave = replace(data, power=data.size * 7.0 * numerator / (numerator + slope))
        solution = filter_response._flattest(wave, np.ones(data.lam.size, dtype=bool), numerator, order, low)
        assert 1 / solution[0] == pytest.approx(7.0, rel=1e-9)
        powers = (data.lam / data.top)[:, None] ** np.arange(poles + 1)
        npt.assert_allclose(numerator / (powers @ solution), wave.power / wave.size, rtol=1e-9)


def test_the_blind_fit_is_the_best_of_its_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit with the lowest objective is returned."""
    data = ordinates_of(simulated("N=1", 500, 1))
    found = at_maximum(np.arange(12.0).reshape(3, SHAPED), objective=np.array([5.0, 3.0, 4.0]))
    monkeypatch.setattr(maximum, "maximize", lambda *_, **__: found)
    monkeypatch.setattr(maximum, "find_starts", lambda *_, **__: (np.zeros(3, dtype=int), found.theta))
    npt.assert_array_equal(_BandSearch(data, ("N",), 10.0).blind(data), [[4.0, 5.0, 6.0, 7.0]])


def test_slow_terms_are_fitted_below_a_32nd_of_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """If that part has fewer than 24 bins, the full band is used."""
    seen: list[Ordinates] = []

    def blind(_: _BandSearch, data: Ordinates) -> FloatArray:
        seen.append(data)
        return np.zeros((1, SHAPED))

    monkeypatch.setattr(_BandSearch, "blind", blind)
    monkeypatch.setattr(_BandSearch, "responses", lambda *_: [_trial((0, 0), 1.0)])
    for n, whole in ((2000, False), (500, True)):
        data = ordinates_of(simulated("N=1", n, 1))
        _BandSearch(data, ("N",), 10.0).sound(None)
        expected = data if whole else data.below(0.03125)
        npt.assert_array_equal(seen[-1].lam, expected.lam)


def _scripted(
    monkeypatch: pytest.MonkeyPatch, *answers: list[_Trial], theta: FloatArray | None = None
) -> list[tuple[list[Order], FloatArray]]:
    """Replace fits by scripted trials; return the requested orders and starts."""
    requested: list[tuple[list[Order], FloatArray]] = []

    def fit(
        _: _BandSearch,
        seen: Ordinates,
        fraction: float,
        orders: list[Order],
        starts: FloatArray,
        **_more: float,
    ) -> list[_Trial]:
        del seen, _more
        assert fraction == 1.0
        requested.append((orders, starts))
        return answers[len(requested) - 1]

    start = np.full((1, SHAPED + 5), 2.0) if theta is None else theta
    monkeypatch.setattr(_BandSearch, "fit", fit)
    monkeypatch.setattr(_BandSearch, "blind", lambda *_: start)
    return requested


def _flat_trials(
    gains: tuple[float, float], statistic: float, theta: FloatArray | None = None
) -> list[_Trial]:
    trials = [
        _trial((0, 0), 100.0, statistic),
        *(_trial((k + 1, 0), 100 - g / 2) for k, g in enumerate(gains)),
    ]
    row = np.full((1, SHAPED + 5), 3.0) if theta is None else theta
    return [replace(trial, fit=replace(trial.fit, theta=row)) for trial in trials]


def test_a_sound_flat_band_needs_one_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each order starts at the blind fit, and the returned band has no response."""
    requested = _scripted(monkeypatch, _flat_trials((11.9, 14.9), 3.9))
    found = _BandSearch(ordinates_of(simulated("N=1", 2000, 1)), ("N", "K"), 10.0).flat()
    assert found is not None
    assert (found.fraction, found.order, found.poles, found.response.size) == (1.0, (0, 0), 0, 0)
    ((orders, starts),) = requested
    assert orders == [(0, 0), (1, 0), (2, 0)]
    npt.assert_array_equal(starts, np.full((3, SHAPED + 5), 2.0))


@pytest.mark.parametrize(("better", "sound"), [(96.5, True), (99.0, False)])
def test_a_flat_band_is_fitted_again_from_the_other_orders(
    better: float, *, sound: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The starts omit the responses, and the best of the three fits counts."""
    again = [_trial((0, 0), objective, 0.0) for objective in (101.0, better, 100.0)]
    requested = _scripted(monkeypatch, _flat_trials((16.0, 16.0), 0.0), again)
    found = _BandSearch(ordinates_of(simulated("N=1", 2000, 1)), ("N", "K"), 10.0).flat()
    assert (found is not None) == sound
    orders, starts = requested[1]
    assert orders == [(0, 0)] * 3
    npt.assert_array_equal(starts[:, :SHAPED], 3.0)
    npt.assert_array_equal(starts[:, SHAPED:], 0.0)


@pytest.mark.parametrize(
    ("share", "structure", "sound"), [(0.21, "QN", True), (0.19, "QN", False), (0.21, "N", False)]
)
def test_quantization_at_the_top_raises_the_thresholds(
    share: float, structure: str, *, sound: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If it is a fifth of the power there, a filter must gain 30 and 33 instead of 12 and 15."""
    data = ordinates_of(simulated("N=1", 2000, 1))
    search = _BandSearch(data, tuple(structure), 10.0)
    theta = np.zeros((1, SHAPED + 5))
    theta[0, 0] = np.log(share * search.level_at_the_top() / data.basis[0, -1])
    trials = _flat_trials((29.0, 32.0), 0.0, theta)
    _scripted(monkeypatch, trials, trials[:1] * 3)
    assert (search.flat() is not None) == sound


def _band(name: str) -> Band:
    """Return a recognisable band: the letters of its name are its coefficients."""
    response = np.array([float(ord(letter)) for letter in name])
    return Band(fraction=1.0, order=(0, 0), poles=0, zeros=0, response=response)


@pytest.mark.parametrize(
    ("given", "own", "white", "rich", "used"),
    [
        (None, True, True, True, "rich"),
        (("N", "K"), True, True, True, "rich"),
        (("N", "GM"), True, True, True, "given"),
        (("N", "GM"), True, False, True, "rich"),
        (("GM",), True, False, True, "given"),
        (("N", "GM"), False, True, True, "rich"),
        (None, False, False, False, "filtered"),
    ],
)
def test_the_order_of_tried_descriptions(
    given: tuple[str, ...] | None,
    used: str,
    *,
    own: bool,
    white: bool,
    rich: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Given terms come first if white noise remains, then the rich model, then a response without Q."""
    bands = {name: _band(name) for name in ("given", "rich", "filtered")}

    def flat(search: _BandSearch) -> Band | None:
        assert search.shortest == (2.0 if search.structure == given else 10.0)
        if search.structure == given:
            return bands["given"] if own else None
        return bands["rich"] if rich else None

    def sound(search: _BandSearch, near: float | None) -> Band:
        assert near is None
        assert search.structure == ("N", "GM", "K")
        return bands["filtered"]

    monkeypatch.setattr(_BandSearch, "flat", flat)
    monkeypatch.setattr(_BandSearch, "white_at_the_top", lambda _: white)
    monkeypatch.setattr(_BandSearch, "sound", sound)
    data = ordinates_of(simulated("N=1", 2000, 1))
    assert find_band(data, ("Q", "N", "GM", "K"), given=given) is bands[used]


@pytest.mark.parametrize(
    ("given", "behind", "taken"),
    [
        (None, 0.0, True),
        (("N", "B"), 0.0, True),
        (("N", "GM"), 0.0, False),
        (None, 300.0, False),
        (None, None, False),
    ],
)
def test_a_filter_is_searched_if_a_term_hides_the_white_noise(
    given: tuple[str, ...] | None, behind: float | None, *, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is searched with times above ten times that term's; a given or equally hidden result is not used."""
    masked, requested = replace(_band("masked"), masked=12.0), []

    def sound(search: _BandSearch, near: float | None) -> Band | None:
        assert near is None
        requested.append(search.shortest)
        return None if behind is None else replace(_band("filtered"), masked=behind, shortest=120.0)

    monkeypatch.setattr(_BandSearch, "flat", lambda _: masked)
    monkeypatch.setattr(_BandSearch, "white_at_the_top", lambda _: True)
    monkeypatch.setattr(_BandSearch, "sound", sound)
    found = find_band(ordinates_of(simulated("N=1", 2000, 1)), ("Q", "N", "GM", "K"), given=given)
    assert requested == ([] if given == ("N", "GM") else [120.0])
    assert found.masked == 12.0
    assert found.shortest == (120.0 if taken else 10.0)


def test_a_search_near_the_right_band_finds_the_same_band() -> None:
    samples = np.convolve(simulated("N=1", 20_000, 41), np.full(9, 1 / 9), "valid")
    data = ordinates_of(samples)
    searched = find_band(data, ("Q", "N", "GM", "K"))
    assert searched.fraction < 1.0
    near = find_band(data, ("Q", "N", "GM", "K"), near=searched.fraction)
    assert (near.fraction, near.order, near.poles) == (searched.fraction, searched.order, searched.poles)
    npt.assert_array_equal(near.response, searched.response)


def test_a_band_selects_the_bins_outside_its_hump() -> None:
    """Bins beyond the end of the band are not selected either."""
    data = ordinates_of(simulated("N=1", 2000, 1))
    hump = Hump(low=0.1, high=0.2, times=3.0)
    found = replace(_band("x"), fraction=0.5, hump=hump).select(data)
    expected = (data.fraction <= 0.5) & ~((data.fraction >= 0.1) & (data.fraction <= 0.2))
    npt.assert_array_equal(found.lam, data.lam[expected])
    assert found.top == pytest.approx(4 * np.sin(np.pi / 4) ** 2)
    assert not replace(_band("x"), hump=hump).flat


def test_a_hump_must_describe_the_spectrum_better_than_a_flat_band() -> None:
    """By more than 1 in the statistic of the misfit."""
    samples = simulated("N=1e-4 + B=5e-5", 60_000, 3, rate_hz=100.0)
    passed = signal.butter(1, (0.02, 0.05), "band")
    white = np.random.default_rng(3).standard_normal(samples.size)
    coarse = _coarse(ordinates_of(samples + 4e-3 * signal.lfilter(*passed, white)))
    rich = ("N", "B", "K")
    alone = _around_hump(coarse, rich, None)
    assert alone is not None
    assert alone.hump is not None
    worse, better = (replace(alone, statistic=alone.statistic + more) for more in (2.0, 0.5))
    found = _around_hump(coarse, rich, worse)
    assert found is not None
    assert found.hump == alone.hump
    assert _around_hump(coarse, rich, better) is None
