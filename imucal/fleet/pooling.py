"""pool: several records of one unit -> one fit, from the bins of their fits.

The likelihood is the product of the records' likelihoods. Each term is tested for equality in all records. If
a term differs, its estimate is the mean of the records, with an interval that includes their spread.

Sources: Bakalli et al. (2018), IEEE/ION PLANS, "A computational multivariate-based technique for inertial
sensor calibration"; Hartung & Knapp (2001), Statistics in Medicine 20, 1771 (interval of the mean).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError, Fix
from imucal.findings import Finding
from imucal.fitting.bins import Bins
from imucal.fitting.noise_fit import MISFIT, Estimate, Goodness, NoiseFit, keyed
from imucal.fitting.settings import FitSettings
from imucal.fitting.spectral.given_model import (
    RecordTest,
    SquaredCoefficient,
    fit_bins,
    record_tests,
    squared_coefficients,
)
from imucal.fleet.population import random_mean
from imucal.fleet.values import LogValue
from imucal.frozen import frozen
from imucal.noise.model import NoiseModel, structure_text
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Sensor

#: False alarm rate of the test of equality, per term.
CHANCE = 0.05
#: Largest relative difference of equal sampling rates, and of equal corners of a filter.
_SAME_RATE, _SAME_CORNER = 1e-3, 0.15
#: Largest standard error of the logarithm of a precise coefficient.
_PRECISE = 0.3


@frozen
class Homogeneity:
    """Test of whether records have the same coefficient of the term `key`, with the `symbol` of its kind.

    `statistic` is twice the log-likelihood ratio: chi-squared with `dof` degrees of freedom if all are equal.
    `values` are the coefficients of the records in SI. `spread` is the relative standard deviation between
    records beyond chance. If a term `differs`, its estimate is widened.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    spread: float
    values: tuple[float, ...]
    differs: bool


@frozen
class PooledFit:
    """The noise model of one axis of one unit, from a number of `records`.

    `model` contains the detected terms; `estimates` also has N, B and K. If the records differ, the limits
    are for the mean over records, and `widening` is the ratio of their distance to the one of a common
    coefficient. `homogeneity` is empty for one record.
    """

    sensor: Sensor | None
    rate_hz: float
    level: float
    records: int
    model: NoiseModel
    estimates: tuple[Estimate, ...]
    homogeneity: tuple[Homogeneity, ...]
    goodness: Goodness
    findings: tuple[Finding, ...]

    def __getitem__(self, key: str) -> Estimate:
        return keyed(self.estimates, key, "the fit has")


@takes('imucal.pool([report["gyro_x"].fit, other["gyro_x"].fit])', fits=[NoiseFit])
def pool(fits: Sequence[NoiseFit], *, model: str = "N + B + K", level: float = 0.95) -> PooledFit:
    """Fit several records of one axis of one unit together, from the bins of their fits.

    Each of the `fits` needs bins (`NoiseFit.bins`): from `imucal.fit` or `imucal.characterize`; a
    report.json does not contain them. `model` must not be ``auto``, so that all units have the same terms.
    The limits are profile limits. For up to four stationary records the result equals the fit
    (``segments=1``) of one record that contains them with long gaps in between, except that steps, cycles,
    effects of temperature, spikes and heavy tails are treated in each record separately.

    Raises a DataError if a fit has no bins, or if the records differ in sensor, sampling rate or output
    filter. Raises a ValueError if there is no fit, if `model` is not a sum of terms, or if `level` is not
    between 0 and 1.
    """
    structure, every = _structure_of(model, level), _bins_of(fits)
    _refuse_different(fits)
    return pool_bins(every, structure, sensor=fits[0].sensor, rate_hz=fits[0].rate_hz, level=level)


def pool_bins(
    every: Sequence[Bins], structure: tuple[str, ...], *, sensor: Sensor | None, rate_hz: float, level: float
) -> PooledFit:
    """Return the joint fit of records with the same unit, rate and output filter; see `pool`."""
    found = fit_bins(every, structure, level=level)
    tests = record_tests(found)
    # If the records differ in one term, all terms are means over the records.
    differ = any(test.p_value < CHANCE for test in tests)
    widened = _means(every, structure, tests, found.estimates, level) if differ else {}
    estimates = tuple(widened.get(e.key, (e, 0.0))[0] for e in found.estimates)
    homogeneity = tuple(
        Homogeneity(
            **{name: getattr(test, name) for name in ("key", "symbol", "statistic", "dof", "p_value")},
            spread=widened.get(test.key, (None, 0.0))[1] if test.p_value < CHANCE else 0.0,
            values=tuple(test.values.tolist()),
            differs=test.p_value < CHANCE,
        )
        for test in tests
    )
    return PooledFit(
        sensor=sensor,
        rate_hz=rate_hz,
        level=level,
        records=len(every),
        model=_shown(found.model, estimates),
        estimates=estimates,
        homogeneity=homogeneity,
        goodness=found.goodness,
        findings=tuple(_findings(homogeneity, found.goodness, structure_text(structure))),
    )


def _means(
    every: Sequence[Bins],
    structure: tuple[str, ...],
    tests: Sequence[RecordTest],
    estimates: Sequence[Estimate],
    level: float,
) -> dict[str, tuple[Estimate, float]]:
    """Return for each term the mean over records and its relative spread."""
    joint = {e.key: e for e in estimates}
    alone: list[dict[str, SquaredCoefficient]] = []
    means = {}
    for test in (test for test in tests if test.key in joint):
        differs, shared = test.p_value < CHANCE, joint[test.key]
        if np.all((test.log_deviations < _PRECISE) & (test.values > 0)):
            *limits, spread = _mean(np.log(test.values), test.log_deviations, level, random=differs)
            value, low, high = map(math.exp, limits)
        else:
            alone = alone or [squared_coefficients(fit_bins([one], structure, level=level)) for one in every]
            squares = [record[test.key] for record in alone]
            values = np.array([square.value for square in squares])
            # Compute all deviations at the same square: at its own, a large estimate would get less weight.
            common = max(float(values.mean()), 0.0)
            deviations = np.array([square.deviation + square.growth * common for square in squares])
            if differs:
                deviations = np.full(len(squares), np.sqrt(np.mean(deviations**2)))
            *limits, spread = _mean(values, deviations, level, random=differs)
            value, low, high = (math.sqrt(max(limit, 0.0)) for limit in limits)
            # Relative to half the upper limit if the mean is not distinguishable from zero.
            spread = 0.5 * spread / max(value, 0.5 * max(high, shared.high)) ** 2
        low, high = min(low, shared.low), max(high, shared.high)
        mean = replace(shared, status="estimated", value=value, low=low, high=high)
        if low <= 0 or value <= 0:
            mean = Estimate.bounded(test.key, shared.symbol, high)
        wider = max((high - low) / (shared.high - shared.low), 1.0)
        means[test.key] = replace(mean, widening=shared.widening * wider), spread
    return means


def _mean(
    values: FloatArray, deviations: FloatArray, level: float, *, random: bool
) -> tuple[float, float, float, float]:
    """Return the mean of values, shape (r,), its limits, and their spread beyond their deviations."""
    if not random:
        weight = deviations**-2.0
        mean, spread = float(np.average(values, weights=weight)), 0.0
        reach = float(scipy.special.ndtri((1 + level) / 2)) / math.sqrt(float(weight.sum()))
    else:
        dof = values.size - 1
        mean, error, spread = random_mean(values, deviations)
        scatter = float(np.sum((values - mean) ** 2 / (deviations**2 + spread**2))) / dof
        reach = float(scipy.special.stdtrit(dof, (1 + level) / 2)) * error * math.sqrt(max(scatter, 1.0))
    return mean, mean - reach, mean + reach, spread


def _shown(model: NoiseModel, estimates: tuple[Estimate, ...]) -> NoiseModel:
    """Return the model with the values of the estimates, without the terms that became bounded."""
    terms = [term for term in model.terms if len(term.values) > 1 or term.symbol == "R"]
    single = (e for e in estimates if len(TERMS[e.symbol].parameters()) == 1 and e.symbol != "R")
    terms += [e.term(e.value) for e in single if e.value is not None]
    return NoiseModel(terms=tuple(sorted(terms, key=lambda term: list(TERMS).index(term.symbol))))


def _findings(homogeneity: tuple[Homogeneity, ...], goodness: Goodness, model: str) -> Iterator[Finding]:
    differing = (t for t in homogeneity if t.differs)
    if text := "; ".join(f"{t.key} by {100 * t.spread:.2g} % (p = {t.p_value:.2g})" for t in differing):
        yield Finding(
            "warning",
            "records-differ",
            f"The records differ by more than chance: {text}. The intervals are for the mean of the records.",
            "Find the cause (temperature, mounting, supply). Another record may differ as much.",
        )
    if goodness.statistic > MISFIT:
        yield Finding(
            "warning",
            "model-misfit",
            f"{model} does not describe these records: the mean squared residual of their spectra is "
            f"{goodness.chi2_per_bin:.3g}, expected 1 (score {goodness.statistic:.1f}).",
            "Give a model with the terms of the single fits.",
        )


@takes('imucal.log_values("unit-1", report["gyro_x"].fit)', unit=str, fit=NoiseFit)
def log_values(
    unit: str,
    fit: NoiseFit,
    *,
    model: str = "N + B + K",
    level: float = 0.95,
) -> dict[str, LogValue]:
    """Return the value of each term in one log, for `imucal.population`, from the bins of its fit.

    `model` must be the same for all logs. Each term except the ramp also has an unbiased estimate of its
    squared coefficient, which may be negative. Raises the errors of `pool`.
    """
    bins, structure = _bins_of([fit]), _structure_of(model, level)
    # A fit of the same given terms has already found the band, unless it is flat.
    fraction, poles = (fit.settings.get(name) for name in ("band_fraction", "response_coefficients"))
    same = fit.criterion == "given" and {e.symbol for e in fit.estimates} == {*structure, *ALWAYS}
    near = fraction if isinstance(fraction, float) and same and (poles or fraction < 1) else None
    found = fit_bins(bins, structure, level=level, near=near)
    laws: dict[str, dict[str, Any]] = {
        key: {"variance": law.value, "variance_sd": law.deviation, "variance_growth": law.growth}
        for key, law in squared_coefficients(found).items()
    }
    return {
        e.key: LogValue(
            unit=unit,
            value=e.value,
            low=e.low,
            high=e.high,
            level=level,
            correlation_time=e.correlation_time.value if e.correlation_time else None,
            **laws.get(e.key, {}),
        )
        for e in found.estimates
    }


def _structure_of(model: str, level: float) -> tuple[str, ...]:
    structure = FitSettings(model=model, level=level).structure
    if structure is None:
        raise ArgumentError("pool: model 'auto' depends on the record; give the terms, such as 'N + B + K'")
    return structure


def _bins_of(fits: Sequence[NoiseFit]) -> list[Bins]:
    if not fits:
        raise ArgumentError("pool: found no fits, expected at least one")
    for number, fit in enumerate(fits, 1):
        if fit.bins is None:
            which = f"fit {number} of {len(fits)} ({fit.method})"
            advice = "fit the samples of each record with imucal.fit; a report.json contains no bins"
            problem = "found no bins, expected the bins of method 'mle'"
            raise DataError(problem, place=which, fix=Fix(advice))
    return [fit.bins for fit in fits if fit.bins is not None]


def _refuse_different(fits: Sequence[NoiseFit]) -> None:
    first = fits[0]
    for number, fit in enumerate(fits[1:], 2):
        corners = [one.response.cutoff_hz if one.response else 0.0 for one in (fit, first)]
        if fit.sensor != first.sensor:
            text = [f"the {one.sensor}" if one.sensor else "no sensor's name" for one in (fit, first)]
            advice = "pool one axis at a time"
        elif abs(fit.rate_hz / first.rate_hz - 1) > _SAME_RATE:
            text = [f"{one.rate_hz:.6g} Hz" for one in (fit, first)]
            advice = "pool records of one sampling rate"
        elif any(corners) and (not all(corners) or abs(math.log(corners[0] / corners[1])) > _SAME_CORNER):
            text = [f"an output filter at {hz:.4g} Hz" if hz else "no output filter" for hz in corners]
            advice = "pool records of one setting of the sensor"
        else:
            continue
        where = f"fit {number} of {len(fits)}"
        raise DataError(f"found {text[0]}, expected {text[1]} as in fit 1", place=where, fix=Fix(advice))
