"""The page's answer to the question asked most: which number goes into my configuration."""

from collections.abc import Callable
from dataclasses import dataclass

from imucal.errors import DataError
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import Choices, Number, Numbers
from imucal.report.markup import Markup, both_units, element, join, labelled, row, table
from imucal.report.result import Report
from imucal.report.sheet_units import sheet_units
from imucal.units import pretty

#: PX4's EKF2 runs at this period, in s, whatever the rate of the IMU.
_PX4_PERIOD = 0.01


@dataclass(frozen=True, slots=True)
class _Use:
    """A number that filters ask for: its formula and kind, and how it follows from a term."""

    formula: str
    kind: str
    symbol: str
    value: Callable[[float, float], float]
    unit: str


_USES = (
    _Use(
        "N",
        "continuous: a density, the same at every rate",
        "N",
        lambda n, f: n,  # noqa: ARG005 - one signature for all
        "{u}/sqrt(Hz)",
    ),
    _Use(
        "K",
        "continuous: a density of the bias's steps, the same at every rate",
        "K",
        lambda k, f: k,  # noqa: ARG005
        "{u}/sqrt(s)",
    ),
    _Use(
        "N²",
        "continuous: a covariance density",
        "N",
        lambda n, f: n * n,  # noqa: ARG005
        "({u})^2/Hz",
    ),
    _Use(
        "K²",
        "continuous: a covariance density",
        "K",
        lambda k, f: k * k,  # noqa: ARG005
        "({u})^2/s",
    ),
    _Use(
        "N √f",
        "discrete: the standard deviation of one sample at the rate f",
        "N",
        lambda n, f: n * f**0.5,
        "{u}",
    ),
    _Use(
        "N √(2f)",
        "discrete, for VINS, which halves the white variance, so that √f alone would be √2 too low",
        "N",
        lambda n, f: n * (2 * f) ** 0.5,
        "{u}",
    ),
    _Use(
        "K √f",
        "discrete, as VINS integrates it",
        "K",
        lambda k, f: k * f**0.5,
        "{u}",
    ),
    _Use(
        "N² f",
        "discrete: the variance of one sample",
        "N",
        lambda n, f: n * n * f,
        "({u})^2",
    ),
    _Use(
        "K² f",
        "discrete, as FAST-LIO integrates it",
        "K",
        lambda k, f: k * k * f,
        "({u})^2",
    ),
    _Use(
        "N / √0.01 s",
        "discrete at the period of PX4's filter, 0.01 s, not at the IMU's rate",
        "N",
        lambda n, f: n / _PX4_PERIOD**0.5,  # noqa: ARG005
        "{u}",
    ),
    _Use(
        "K / √0.01 s",
        "discrete at the period of PX4's filter, 0.01 s",
        "K",
        lambda k, f: k / _PX4_PERIOD**0.5,  # noqa: ARG005
        "{u}/s",
    ),
    _Use(
        "B",
        "the flicker coefficient; neither a density nor the curve's minimum",
        "B",
        lambda b, f: b,  # noqa: ARG005
        "{u}",
    ),
)

#: Kind of a Gauss-Markov term.
_MARKOV = "continuous: a bias that forgets, the slowest Gauss-Markov term; the summary has phi and q at f"


def downstream_section(report: Report) -> Markup:
    """Return which number goes into which configuration, with its formula; none where it is not noise."""
    if not report.verdict.usable:
        return element("p", f"{report.verdict.sentence}. No filter should be given its numbers.")
    chosen = Numbers(report=report, choices=Choices(), target="the page")
    sensors = [sensor for sensor in Sensor if any(axis.sensor is sensor for axis in report.axes)]
    titles = ("Kind", *(str(s).capitalize() for s in sensors))
    head = [element("th", title, scope="col") for title in ("Formula", *titles)]
    body = []
    for use in _USES:
        values = [_use_value(chosen, sensor, use) for sensor in sensors]
        cells = labelled(titles, (use.kind, *values))
        body.append(row(element("th", use.formula, scope="row"), *cells))
    values = [_markov_value(chosen, sensor) for sensor in sensors]
    cells = labelled(titles, (_MARKOV, *values))
    body.append(row(element("th", "σ, T", scope="row"), *cells))
    rates = ", ".join(f"f = {chosen.rate_hz(s):.6g} Hz ({s})" for s in sensors)
    return join(
        [
            element(
                "p",
                "Values in SI, each from the worst of the sensor's axes; ≤ marks an upper bound where "
                f"the data do not show the term. {rates}. The export command writes these files, with "
                "the formulas in comments.",
            ),
            table("Values for filters and simulators", [row(*head)], body, class_="wide cards"),
            _programs(),
            _two_floors(report),
        ]
    )


def _markov_value(chosen: Numbers, sensor: Sensor) -> Markup:
    """Return sigma and T of the axis whose slowest Gauss-Markov term is the largest."""
    found = [(chosen.gauss_markov(axis), axis.axis) for axis in chosen.axes(sensor)]
    known = [(term, axis) for term, axis in found if term]
    if not known:
        return Markup("–")
    (sigma, time), axis = max(known)
    unit = element("small", f"{pretty(sensor.unit)}, ")
    return join([f"{sigma:.4g} ", unit, f"{time:.4g} ", element("small", f"s, {axis}")])


def _use_value(chosen: Numbers, sensor: Sensor, use: _Use) -> Markup:
    try:
        number: Number = chosen.one(sensor, use.symbol)
    except DataError:
        return Markup("–")
    value = use.value(number.value, chosen.rate_hz(sensor))
    bound = "≤ " if number.bounded else ""
    where = ", ".join(name.split("_")[1] for name in number.axes)
    unit = pretty(use.unit.format(u=sensor.unit)).replace("(rad/s)²", "rad²/s²").replace("(m/s²)²", "m²/s⁴")
    return join([f"{bound}{value:.4g} ", element("small", f"{unit}, {where}")])


def _programs() -> Markup:
    """Return each program that there is an export for, with the formulas of its own keys."""
    titles = ("Program, and its name for --to", "Its keys", "Kind")
    body = [
        row(
            element("th", join([f"{target.title}: ", element("code", target.name)]), scope="row"),
            *labelled(titles[1:], ("; ".join(target.formulas), target.kind)),
        )
        for target in TARGETS.values()
    ]
    heads = [element("th", title, scope="col") for title in titles]
    told = table("What each program's file takes", [row(*heads)], body, class_="wide cards")
    return element(
        "details", element("summary", f"By program: {len(TARGETS)} files that export writes"), told
    )


def _two_floors(report: Report) -> Markup:
    """Return B and the curve's minimum of each axis, side by side and named."""
    titles = ("Axis", "B (flicker)", "0.664 B (its floor)", "Minimum of the curve", "Minimum / 0.664")
    body = []
    for axis in report.axes:
        estimate = axis.fit["B"]
        units = sheet_units(report, axis.sensor)
        sheet, plain = units.estimate(estimate, axis.sensor), numbers.si(estimate, axis.sensor)
        low = (numbers.minimum(axis)[0], units.minimum(axis))
        pairs = (
            (sheet, plain),
            (sheet.scaled(0.664, sheet.unit), plain.scaled(0.664, plain.unit)),
            (low[1], low[0]),
            (low[1].scaled(1 / 0.664, low[1].unit), low[0].scaled(1 / 0.664, low[0].unit)),
        )
        powers = [numbers.engineering_exponent(side) for side in zip(*pairs, strict=True)]
        cells = [
            both_units(*(numbers.with_interval(q, exponent=e) for q, e in zip(pair, powers, strict=True)))
            for pair in pairs
        ]
        body.append(row(element("th", axis.name, scope="row"), *labelled(titles[1:], cells)))
    note = (
        "“Bias instability” has two meanings. B is the coefficient of flicker noise, whose floor lies at "
        "0.664 B. The minimum of the curve holds every term at once; divided by 0.664 it gives an upper "
        "estimate of B, right only where flicker alone makes the floor."
    )
    heads = [element("th", title, scope="col") for title in titles]
    return join(
        [
            element("h3", "Bias instability, both ways"),
            element("p", note),
            table("B and the minimum", [row(*heads)], body, class_="tight cards"),
        ]
    )
