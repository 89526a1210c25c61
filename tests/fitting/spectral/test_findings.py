"""Tests of the findings of a spectral fit, and of the choice of its candidates."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Goodness, Line, Response
from imucal.fitting.spectral.disturbances.band import Band, Order, filter_finding, response_of
from imucal.fitting.spectral.disturbances.not_noise import line_finding
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.mle import (
    _misfit_findings,
    _structures,
    _used,
)
from imucal.fitting.spectral.models import models_of, richest
from imucal.recording import AxisSeries
from tests.fitting.fits import at_maximum

SERIES = AxisSeries.from_samples(np.arange(3.0), rate_hz=100.0)
RATE = 100.0


def _band(fraction: float, order: Order, response: FloatArray) -> Band:
    return Band(
        fraction=fraction,
        order=order,
        poles=response.size,
        zeros=order[1] if order[0] else 0,
        response=response,
    )


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, None),
        (1, "Line at 1 Hz (amplitude 0.5 rad/s); left out of the fit."),
        (
            4,
            (
                "Lines at 1 Hz (amplitude 0.5 rad/s), 2 Hz (amplitude 0.25 rad/s), "
                "3 Hz (amplitude 0.167 rad/s), 4 Hz (amplitude 0.125 rad/s); left out of the fit."
            ),
        ),
        (
            6,
            (
                "Lines at 1 Hz (amplitude 0.5 rad/s), 2 Hz (amplitude 0.25 rad/s), "
                "3 Hz (amplitude 0.167 rad/s), 4 Hz (amplitude 0.125 rad/s) and 2 weaker ones; "
                "left out of the fit."
            ),
        ),
    ],
)
def test_at_most_four_lines_are_listed(count: int, text: str | None) -> None:
    """Further lines are only counted; without lines there is no finding."""
    lines = tuple(Line(frequency_hz=float(k), amplitude=0.5 / k) for k in range(1, count + 1))
    assert [f.text for f in line_finding(lines, SERIES)] == ([] if text is None else [text])


@pytest.mark.parametrize(("statistic", "reported"), [(2.99, False), (3.0, True)])
def test_a_misfit_is_reported_from_a_score_of_three(statistic: float, *, reported: bool) -> None:
    """The finding contains the mean squared residual and the score."""
    found = _misfit_findings(
        Goodness(statistic=statistic, p_value=0.1, chi2_per_bin=1.234),
        0.5,
        {"N": 1.3, "B": 2.0, "K": 1.0},
        "N=1 + K=2",
        "gyro_x",
    )
    assert [f.text for f in found] == (
        [
            (
                "N=1 + K=2 does not describe this axis: the mean squared residual of its spectrum is "
                "1.23, expected 1 (score 3.0). The intervals are wider to allow for it: "
                "N 1.3, B 2 times."
            )
        ]
        if reported
        else []
    )


def test_only_averaging_times_inside_the_fitted_band_are_used() -> None:
    """An averaging time is used if it is at least one period of the highest fitted frequency."""
    m = np.array([1, 2, 4, 8])
    ones = np.ones(4)
    curve = AllanCurve(tau=m.astype(np.float64), m=m, avar=ones, edf=ones, n=100)
    flat = _band(1.0, (0, 0), np.zeros(0))
    npt.assert_array_equal(_used(curve, flat, 1.0), [0, 1, 2, 3])
    npt.assert_array_equal(_used(curve, flat, 0.25), [2, 3])
    npt.assert_array_equal(_used(curve, _band(0.5, (0, 0), np.zeros(0)), 1.0), [1, 2, 3])


def test_behind_a_filter_every_candidate_has_white_noise_and_none_quantization() -> None:
    """A given model remains the only candidate."""
    assert _structures(("B",), 1, white=True) == [("B",)]
    plain, filtered = (_structures(None, 1, white=f) for f in (False, True))
    assert any("Q" in s for s in plain)
    assert any("N" not in s for s in plain)
    assert {s for s in plain if "N" in s and "Q" not in s} == set(filtered)


def test_the_richest_model_contains_every_candidate() -> None:
    """It always contains a Gauss-Markov term, because the search for the band needs one."""
    assert richest(None, 0) == ("Q", "N", "B", "GM", "K", "R")
    assert richest(None, 2) == ("Q", "N", "B", "GM", "GM", "K", "R")
    assert richest(("N", "K"), 2) == ("N", "B", "GM", "K")
    assert set(richest(("Q", "GM", "GM"), 1)) == {"Q", "N", "B", "GM", "K"}


def _behind(poles: FloatArray, zeros: int) -> Fits:
    """Return a model of white noise behind the response of these coefficients."""
    models = models_of([("N",)], ("R",), poles=poles.size, zeros=zeros)
    return at_maximum(
        np.concatenate([np.zeros(4), poles])[None, :],
        models=models,
        objective=np.zeros(1),
        information=np.zeros((1, models.width, models.width)),
        beta=np.zeros((1, 1)),
        beta_covariance=np.zeros((1, 1, 1)),
    )


@pytest.mark.parametrize(
    ("poles", "order", "kind", "fraction"),
    [
        # 1 + a lam/4 = 2 at sin² = 1/a.
        ([4.0], (1, 0), "one-pole", 2 / np.pi * np.arcsin(0.5)),
        ([0.0, 16.0], (2, 0), "two-pole", 2 / np.pi * np.arcsin(0.5)),
        # tan² = 1 at half of Nyquist, and (1 - x) / (1 - x + x) is a Butterworth filter of order 1.
        ([0.0], (1, 1), "butterworth-1", 0.5),
        ([-2.0, 2.0], (2, 2), "butterworth-2", 0.5),
        ([3.0, 0.0], (2, 1), "two-pole one-zero", None),
    ],
)
def test_a_response_is_named_and_its_corner_found(
    poles: list[float], order: Order, kind: str, fraction: float | None
) -> None:
    """The corner is exact to the grid's step, 1/2000 of the band; the shape determines the filter family."""
    response = np.array(poles)
    fitted = _behind(response, order[1])
    found = response_of(fitted, _band(1.0, order, response), RATE)
    assert found is not None
    assert found.kind == kind
    if fraction is not None:
        assert found.cutoff_hz == pytest.approx(fraction * RATE / 2, abs=1.01 * RATE / 2 / 2000)


def test_a_response_without_a_corner_has_no_name() -> None:
    """Neither a response of order 0 nor one that never falls to half the power has a corner."""
    response = np.array([0.9])
    fitted = _behind(response, 0)
    assert response_of(fitted, _band(1.0, (1, 0), response), RATE) is None
    assert response_of(fitted, _band(1.0, (0, 0), response), RATE) is None


@pytest.mark.parametrize(
    ("pole", "fraction", "order", "named", "text"),
    [
        (None, 1.0, (0, 0), False, None),
        (
            None,
            0.5,
            (0, 0),
            False,
            "A filter or a vibration shapes the spectrum above 25 Hz; the fit uses the rest.",
        ),
        (
            3.0,
            1.0,
            (1, 0),
            True,
            (
                "An output filter (one-pole, -3 dB at 12.5 Hz) shapes the spectrum; its response is fitted "
                "with the noise up to 50 Hz."
            ),
        ),
        (
            -0.5,
            1.0,
            (1, 0),
            False,
            (
                "The white part of the spectrum is not flat (+3.0 dB at 50 Hz: a resonance or a "
                "vibration); a response is fitted with the noise up to 50 Hz."
            ),
        ),
        (
            0.5,
            1.0,
            (1, 0),
            False,
            (
                "The white part of the spectrum is not flat (-1.8 dB at 50 Hz: an output filter); "
                "a response is fitted with the noise up to 50 Hz."
            ),
        ),
        (
            0.5,
            1.0,
            (0, 0),
            False,
            "A filter or a vibration shapes the spectrum above 50 Hz; the fit uses the rest.",
        ),
    ],
)
def test_findings_about_a_filter(
    pole: float | None, fraction: float, order: Order, text: str | None, *, named: bool
) -> None:
    """A flat full band has no finding; other findings contain the filter, the shape or the band's end."""
    response = np.array([] if pole is None else [pole])
    fitted = _behind(response, 0)
    given = Response(kind="one-pole", cutoff_hz=12.5) if named else None
    found = filter_finding(fitted, _band(fraction, order, response), given, rate_hz=RATE, axis="gyro_x")
    assert [f.text for f in found] == ([] if text is None else [text])
    assert all((f.level, f.code, f.axis) == ("info", "output-filter", "gyro_x") for f in found)
