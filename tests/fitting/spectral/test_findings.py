"""Tests of the findings of a spectral fit, and of the choice of its candidates."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.curve import AllanCurve
from imucal.fitting.noise_fit import Goodness, Line
from imucal.fitting.spectral.disturbances.band import Band, filter_finding, response_of
from imucal.fitting.spectral.disturbances.hump import Hump
from imucal.fitting.spectral.disturbances.not_noise import line_finding
from imucal.fitting.spectral.mle import (
    _misfit_findings,
    _structures,
    _used,
)
from imucal.fitting.spectral.models import richest
from imucal.recording import AxisSeries
from tests.fitting.fits import at_maximum

SERIES = AxisSeries.from_samples(np.arange(3.0), rate_hz=100.0)
RATE = 100.0


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
    flat = Band()
    npt.assert_array_equal(_used(curve, flat, 1.0), [0, 1, 2, 3])
    npt.assert_array_equal(_used(curve, flat, 0.25), [2, 3])
    npt.assert_array_equal(_used(curve, Band(fraction=0.5), 1.0), [1, 2, 3])


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


@pytest.mark.parametrize(
    ("band", "found"),
    [
        (Band(), None),
        (
            Band(fraction=0.5),
            ("info", "A filter or a vibration shapes the spectrum above 25 Hz; the fit uses"),
        ),
        (Band(response=np.array([3.0]), corner=0.25), ("info", "An output filter (-3 dB at 12.5 Hz) shapes")),
        (
            Band(response=np.array([0.2])),
            ("info", "The spectrum falls at its top: an output filter bends it."),
        ),
        (
            Band(fraction=0.5, rise=1.4),
            ("warning", "The density above 25 Hz rises to 1.4 times the noise below"),
        ),
        (
            Band(hump=Hump(low=0.1, high=0.2, times=3.0)),
            ("warning", "The density between 5 and 10 Hz is up to"),
        ),
        (
            Band(masked=20.0, corner=0.25),
            ("warning", "The spectrum has two explanations: white noise behind"),
        ),
    ],
)
def test_findings_about_a_band(band: Band, found: tuple[str, str] | None) -> None:
    """The whole spectrum without a bend has no finding; what may be no filter is a warning."""
    fitted = at_maximum(np.zeros((1, 4)), objective=np.zeros(1))
    fitted = replace(fitted, spectrum=np.ones((1, 8)))
    findings = filter_finding(fitted, band, response_of(band, RATE), rate_hz=RATE, axis="gyro_x")
    assert [f.level for f in findings] == ([] if found is None else [found[0]])
    assert all(found and f.text.startswith(found[1]) and f.axis == "gyro_x" for f in findings)
