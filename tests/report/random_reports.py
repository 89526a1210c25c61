"""Random reports: terms are estimated, bounded or absent, on one to six axes.

Run as a script, it draws pages with all pictures for a number of random reports and prints the failures:
``python -m tests.report.random_reports 200``.
"""

import sys
from dataclasses import replace
from itertools import product

import numpy as np

from imucal.fitting.noise_fit import Estimate, Interval
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, term_keys
from imucal.recording import Axis, Sensor
from imucal.report.figure import draw, picture_names
from imucal.report.page import render_page
from imucal.report.result import AxisReport, Report
from tests.report.synthetic import axis_report, consumer_report

__all__ = ["STATES", "axis_of", "random_report", "report_of"]

STATES = ("estimated", "bounded", "absent")
#: Symbol -> a typical size in SI; a model can have two Gauss-Markov terms.
_SIZES = {"Q": 2e-6, "N": 1e-4, "B": 2e-5, "GM": 5e-5, "K": 1e-6, "R": 1e-8}
_AXES: tuple[Axis, ...] = ("x", "y", "z")


def axis_of(sensor: Sensor, axis: Axis, states: dict[str, str], rng: np.random.Generator) -> AxisReport:
    """Return the result of an axis; `states` has the state of each term; N, B and K are never absent."""
    symbols = [symbol for symbol in TERMS for _ in range(int(states.get(f"{symbol}*", "1")))]
    keys, estimates, terms = term_keys(symbols), [], []
    for key, symbol in zip(keys, symbols, strict=True):
        state = states.get(symbol, "absent")
        if state == "absent" and symbol in ALWAYS:
            state = "bounded"
        if state == "absent":
            continue
        size = _SIZES[symbol] * 10 ** rng.uniform(-1, 1)
        length = 10 ** rng.uniform(0, 3)
        timed = symbol == "GM"
        longest = length * rng.choice([3.0, np.inf])
        time = Interval(value=length, low=length / 2, high=longest) if timed else None
        if state == "bounded":
            known = time if rng.random() < 0.5 else None
            bound = replace(Estimate.bounded(key, symbol, size), correlation_time=known)
            estimates.append(replace(bound, high=np.inf) if rng.random() < 0.1 else bound)
            continue
        other = ("GM",) if symbol in {"B", "K"} and rng.random() < 0.3 else ()
        limits = {
            "low": size * rng.uniform(0.2, 1),
            "high": size * rng.choice([1.1, 3.0, np.inf], p=[0.6, 0.3, 0.1]),
        }
        estimates.append(
            Estimate(
                key=key, symbol=symbol, status="estimated", value=size, correlation_time=time,
                alternatives=other, **limits,
            )
        )  # fmt: skip
        terms.append(TERMS[symbol].of(size, *([length] if timed else [])))
    n = int(rng.choice([4, 40, 3000, 720_000]))
    made = axis_report(sensor, axis, "N=1e-4", n=n, overview_size=min(n, 50))
    fit = replace(made.fit, model=NoiseModel(terms=tuple(terms)), estimates=tuple(estimates))
    return replace(made, fit=replace(fit, parameters=(), covariance=np.zeros((0, 0))))


def report_of(axes: list[AxisReport]) -> Report:
    """Return the report of some axes without findings."""
    return replace(consumer_report(), axes=tuple(axes), findings=())


def random_report(rng: np.random.Generator) -> Report:
    """Return one to six axes, each with its own terms."""
    every = list(product(Sensor, _AXES))
    chosen = sorted(rng.choice(6, size=rng.integers(1, 7), replace=False))
    axes = []
    for sensor, axis in (every[i] for i in chosen):
        states = {symbol: str(rng.choice(STATES)) for symbol in TERMS}
        states["GM*"] = str(rng.integers(1, 3))
        axes.append(axis_of(sensor, axis, states, rng))
    return report_of(axes)


def main() -> None:
    """Draw random reports, and print the number of failed pages and pictures."""
    count, seed = int(sys.argv[1]), np.random.SeedSequence().entropy
    rng = np.random.default_rng(seed)
    lost = []
    for i in range(count):
        report = random_report(rng)
        drawings = draw(report, ("png",), workers=1)
        missing = len(picture_names(report, ("png",))) - len(drawings.files)
        try:
            complete = "</html>" in render_page(report, drawings=drawings)
        except Exception as error:  # noqa: BLE001 - what is counted here
            sys.stdout.write(f"report {i}: {error!r}\n")
            complete = False
        if missing or not complete:
            lost.append(i)
    sys.stdout.write(f"seed {seed}: {len(lost)} of {count} reports lost a page or a picture: {lost}\n")


if __name__ == "__main__":
    main()
