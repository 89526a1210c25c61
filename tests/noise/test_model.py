"""Tests of NoiseModel: sums, text, units and errors."""

import re

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucal.noise import GaussMarkov, NoiseModel, parse_structure, structure_text
from imucal.noise.terms import TERMS, RateRamp
from imucal.recording import Sensor
from imucal.units import G0

REPEATABLE = " and ".join(symbol for symbol, term in TERMS.items() if term.repeatable)
TEXT = "N=1e-3 + B=2e-5 + K=3e-6 + GM(sigma=1e-4, T=50)"


def test_the_example_is_parsed() -> None:
    """Terms keep their order, and values are exact."""
    model = NoiseModel.parse(TEXT)
    assert str(model) == "N + B + K + GM"
    assert [term.coefficient for term in model.terms] == [1e-3, 2e-5, 3e-6, 1e-4]
    assert NoiseModel.parse(model.text()) == model


def test_signs_and_exponents_are_not_plus_signs() -> None:
    """``1e+3`` is one number, a drift may be negative, and blanks do not matter."""
    model = NoiseModel.parse("N=1E+3+R=-2.5e-06 +GM( sigma = 1e+1 ,T=5e+2 )+GM(sigma=1,T=2)")
    assert str(model) == "N + R + 2*GM"
    assert model.terms[1] == RateRamp(value=-2.5e-6)
    assert model.terms[2] == GaussMarkov(sigma=10.0, T=500.0)


positive = st.floats(1e-300, 1e300)


@settings(deadline=None)
@given(n=positive, k=positive, r=st.floats(-1e300, 1e300), sigma=positive, t=positive)
def test_every_value_is_read_back_exactly(n: float, k: float, r: float, sigma: float, t: float) -> None:
    """The text contains all digits."""
    model = NoiseModel.parse(f"N={n!r} + K={k!r} + R={r!r} + GM(sigma={sigma!r}, T={t!r})")
    assert NoiseModel.parse(model.text()) == model


def test_terms_add_up() -> None:
    """Terms are independent, so avar, psd, D and V are sums over the terms."""
    model = NoiseModel.parse(TEXT + " + R=1e-6 + Q=1e-7")
    m = np.array([1.0, 8.0, 300.0])
    for name in ("avar", "structure", "sum_variance", "psd"):
        total = sum(getattr(term, name)(m, 1 / 200.0) for term in model.terms)
        npt.assert_allclose(getattr(model, name)(m, rate_hz=200.0), total, rtol=1e-13)


def test_a_model_without_terms_is_zero() -> None:
    model = NoiseModel(terms=())
    assert str(model) == ""
    npt.assert_array_equal(model.avar(np.array([1.0]), rate_hz=1.0), 0.0)
    npt.assert_array_equal(model.simulate(3, rate_hz=1.0, rng=np.random.default_rng(0)), np.zeros(3))


def test_a_seed_determines_the_samples() -> None:
    model = NoiseModel.parse(TEXT)
    first = model.simulate(50, rate_hz=10.0, rng=np.random.default_rng(9))
    npt.assert_array_equal(first, model.simulate(50, rate_hz=10.0, rng=np.random.default_rng(9)))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "model term '' is not understood"),
        ("N", "model term 'N' is not understood"),
        ("X=1", "model term 'X=1' is not understood"),
        ("N=1 +", "model term '' is not understood"),
        ("GM=1", "model term 'GM=1' is not understood"),
        ("GM(sigma=1)", r"model term 'GM\(sigma=1\)' is not understood"),
        ("N=one", "'one' is not a number"),
        ("GM(sigma=a, T=2)", "'a' is not a number"),
    ],
)
def test_invalid_models_are_rejected(text: str, found: str) -> None:
    """The error contains the invalid part and an example."""
    with pytest.raises(ValueError, match=found + "; write a sum such as 'N=1e-3"):
        NoiseModel.parse(text)


@pytest.mark.parametrize("text", ["N=1 + N=2", "K=1 + N=1 + K=1"])
def test_a_repeated_term_is_rejected(text: str) -> None:
    """Only Gauss-Markov terms differ by more than a coefficient, so only they may be repeated."""
    with pytest.raises(ValueError, match="appears more than once"):
        NoiseModel.parse(text)


def test_structures_are_sorted_and_counted() -> None:
    """Terms are in the order of increasing slope, and several GM are a count."""
    assert parse_structure("K + N + B") == ("N", "B", "K")
    assert parse_structure("GM+2*GM + N") == ("N", "GM", "GM", "GM")
    assert structure_text(parse_structure(" N+GM +GM")) == "N + 2*GM"


@pytest.mark.parametrize("text", ["", "N + ", "N + Z", "auto", "N=1", "0*GM", "-1*GM", "GM*2"])
def test_an_unknown_structure_is_rejected(text: str) -> None:
    """The error lists the terms and an example."""
    known = ", ".join(TERMS)
    with pytest.raises(ValueError, match=rf"is not one of {known}; write 'N \+ B \+ K'"):
        parse_structure(text)


def test_a_repeated_structure_is_rejected() -> None:
    with pytest.raises(ValueError, match="N appears more than once"):
        parse_structure("2*N")


@pytest.mark.parametrize(
    ("text", "symbols"),
    [
        ("ARW + BI + RRW", "N + B + K"),
        ("VRW + QN", "Q + N"),
        ("WN+AR1+RW+DR", "N + GM + K + R"),
        ("n + 2*ar1", "N + 2*GM"),
    ],
)
def test_common_abbreviations_of_terms_are_parsed(text: str, symbols: str) -> None:
    """IEEE's and GMWM's abbreviations are accepted in any case; the output has the symbols."""
    assert structure_text(parse_structure(text)) == symbols


def test_values_may_use_common_abbreviations() -> None:
    """A term may not be repeated under its second name."""
    model = NoiseModel.parse("ARW=1e-3 + bi=2e-5 + AR1(sigma=1e-4, T=50)")
    assert model.text() == NoiseModel.parse("N=1e-3 + B=2e-5 + GM(sigma=1e-4, T=50)").text()
    with pytest.raises(ValueError, match="N appears more than once"):
        parse_structure("N + ARW")


def test_no_abbreviation_has_two_meanings() -> None:
    names = [name for term in TERMS.values() for name in (term.symbol, *term.abbreviations)]
    assert len(names) == len(set(names))
    assert all(name == name.upper() for name in names)


DEGREE = np.pi / 180


@pytest.mark.parametrize(
    ("sensor", "text", "si"),
    [
        ("gyroscope", "N=0.3deg/sqrt(h)", 0.3 * DEGREE / 60),
        ("gyroscope", "N = 0.3 °/√h", 0.3 * DEGREE / 60),
        ("gyroscope", "N=0.3 deg per root hour", 0.3 * DEGREE / 60),
        ("gyroscope", "N=5e-3deg/s/sqrt(Hz)", 5e-3 * DEGREE),
        ("gyroscope", "N=.005 (°/s)/√Hz", 5e-3 * DEGREE),
        ("gyroscope", "N=0.005dps/rtHz", 5e-3 * DEGREE),
        ("gyroscope", "N=5mdps/√Hz", 5e-3 * DEGREE),
        ("gyroscope", "N=5mdps/rt(Hz)", 5e-3 * DEGREE),
        ("gyroscope", "N=5 mdeg/sec/Hz^0.5", 5e-3 * DEGREE),
        ("gyroscope", "N=5 mdeg/s/Hz^(1/2)", 5e-3 * DEGREE),
        ("gyroscope", "N=18 deg/h/sqrt(Hz)", 18 * DEGREE / 3600),
        ("gyroscope", "ARW=1e-4 rad/s/√Hz", 1e-4),
        ("gyroscope", "N=1e-4 rad/(s·√Hz)", 1e-4),
        ("gyroscope", "N=1e-4 rad s^-1 Hz^-1/2", 1e-4),
        ("gyroscope", "B=5deg/h", 5 * DEGREE / 3600),
        ("gyroscope", "BI=5 degrees/hour", 5 * DEGREE / 3600),
        ("gyroscope", "K=2deg/h/sqrt(h)", 2 * DEGREE / 3600 / 60),
        ("gyroscope", "K=2°/h^1.5", 2 * DEGREE / 3600 / 60),
        ("gyroscope", "K=1e-6rad/s^2/√Hz", 1e-6),
        ("gyroscope", "R=3deg/h/h", 3 * DEGREE / 3600**2),
        ("gyroscope", "R=-3deg/h²", -3 * DEGREE / 3600**2),
        ("gyroscope", "Q=0.5arcsec", 0.5 * DEGREE / 3600),
        ("accelerometer", "N=60ug/sqrt(Hz)", 60e-6 * G0),
        ("accelerometer", "N=60 µg/√Hz", 60e-6 * G0),
        ("accelerometer", "VRW=60 \u03bcg/rtHz", 60e-6 * G0),
        ("accelerometer", "N=0.06mg/√Hz", 60e-6 * G0),
        ("accelerometer", "N=0.02m/s/sqrt(h)", 0.02 / 60),
        ("accelerometer", "N=0.02 m/s/√hr", 0.02 / 60),
        ("accelerometer", "N=1e-3m/s^2/sqrt(Hz)", 1e-3),
        ("accelerometer", "N=1e-3 m/s²/√Hz", 1e-3),
        ("accelerometer", "N=100 mGal/√Hz", 1e-3),
        ("accelerometer", "B=0.04mg", 4e-5 * G0),
        ("accelerometer", "B=40µg", 4e-5 * G0),
        ("accelerometer", "K=1e-5m/s^3/√Hz", 1e-5),
    ],
)
def test_numbers_may_have_the_units_of_data_sheets(sensor: str, text: str, si: float) -> None:
    """Spellings of data sheets and users are accepted, with the factor by definition."""
    (term,) = NoiseModel.parse(text, Sensor(sensor)).terms
    assert term.coefficient == pytest.approx(si, rel=1e-14)


def test_units_are_parsed_in_sums_and_times() -> None:
    """Signs in exponents and a final e are not operators, and T has a unit too."""
    model = NoiseModel.parse("N=3e+0deg/sqrt(h)+B=5deg/h + GM(sigma=2deg/h, T=5 min)+K=1e-6")
    assert str(model) == "N + B + GM + K"
    assert model.terms[2].values == pytest.approx((2 * DEGREE / 3600, 300.0))


@pytest.mark.parametrize(
    ("sensor", "text", "message"),
    [
        ("gyroscope", "N=5deg/h", "'deg/h' is no unit of N, the angle random walk of the gyroscope; "),
        ("gyroscope", "N=60ug/sqrt(Hz)", "'ug/sqrt(Hz)' is no unit of N"),
        ("gyroscope", "B=5deg/sqrt(h)", "of B, the bias instability of the gyroscope; expected one of rad/s"),
        ("accelerometer", "N=0.3deg/sqrt(h)", "expected one of m/s^2/sqrt(Hz), g/sqrt(Hz), mg"),
        ("gyroscope", "N=3 furlongs", "'furlongs' is no unit of N"),
        ("gyroscope", "N=3 __import__('os')", "is no unit of N"),
        ("gyroscope", "N=3 deg/", "'deg/' is no unit of N"),
        ("gyroscope", "GM(sigma=1deg/h, T=5deg)", "'deg' is no unit of a time of GM"),
    ],
)  # fmt: skip
def test_a_unit_of_another_quantity_is_rejected(sensor: str, text: str, message: str) -> None:
    """The error lists the valid units."""
    with pytest.raises(ValueError, match=re.escape(message)):
        NoiseModel.parse(text, Sensor(sensor))
