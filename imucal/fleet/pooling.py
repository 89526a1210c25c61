"""pool: several records of one unit -> one fit, from the bins that their fits carry.

The records' likelihoods multiply, as those of the blocks of one record between long gaps do. Each term is
tested for being the same in all of them; where it is not, what one would expect of yet another record is
the mean of the records with their spread, and never the narrow interval of one coefficient.

Source: Bakalli et al. (2018), IEEE/ION PLANS, "A computational multivariate-based technique for inertial
sensor calibration" (several records of one sensor).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.findings import Finding
from imucal.fitting.bins import Bins
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit
from imucal.fitting.spectral.estimates import MISFIT
from imucal.fitting.spectral.given_model import fit_bins, record_tests
from imucal.fleet.differing_records import means_over_records
from imucal.fleet.poolable import bins_of, refuse_different, structure_of
from imucal.noise.model import NoiseModel, structure_text
from imucal.noise.terms import TERMS
from imucal.recording import Sensor

#: Chance, for each term, that records of one coefficient are found to differ.
CHANCE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Homogeneity:
    """Whether records have one coefficient of a term.

    Attributes
    ----------
    key, symbol
        Of the term, as in its estimate.
    statistic, dof
        Twice the log-likelihood ratio of one coefficient for each record against one for all;
        chi-squared with `dof` degrees of freedom where there is one. A weak term's is smaller, because no
        variance is negative: it is found to differ more rarely.
    p_value
        Probability of so large a statistic by chance.
    spread
        Relative standard deviation of the coefficient between records, beyond what chance gives.
    values
        The coefficient in each record, in SI; 0 where its data want none.
    differs
        Whether the records differ: then the estimate is widened.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    spread: float
    values: tuple[float, ...]
    differs: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledFit:
    """The noise model of one axis of one unit, from several records.

    Attributes
    ----------
    sensor, rate_hz, level
        As in each record's fit.
    records
        How many.
    model
        The terms found, with their values.
    estimates
        One for each term of the model that was asked for, and for N, B and K always. Where the records
        differ the limits are those of the mean over records, and `widening` says by what factor they
        lie farther apart than those of one common coefficient.
    homogeneity
        The test of each term but the ramp; empty for a single record.
    goodness
        How well the model describes all records together.
    findings
        What is to be said of them.
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
        for estimate in self.estimates:
            if estimate.key == key:
                return estimate
        found = ", ".join(estimate.key for estimate in self.estimates)
        msg = f"{key!r}; the fit has {found}"
        raise KeyError(msg)


def pool(fits: Sequence[NoiseFit], *, model: str = "N + B + K", level: float = 0.95) -> PooledFit:
    """Fit several records of one axis of one unit together, from the bins of their fits.

    Without the samples: the likelihood is evaluated from what each fit carries in `NoiseFit.bins`.

    Parameters
    ----------
    fits
        Of one axis of one unit, by `imucal.fit`, `imucal.characterize`, or read back from a report that
        was written with bins.
    model
        The terms, the same for every unit that is to be compared: ``auto`` would choose by the record.
    level
        Confidence level of the limits: profile limits of the joint likelihood, as those of `imucal.fit`.

    Raises
    ------
    DataError
        If a fit has no bins, or the records are not of one sensor, one sampling rate and one output
        filter.
    ValueError
        If there is no fit, `model` is no sum of terms, or `level` is not between 0 and 1.

    Notes
    -----
    Of stationary records without spikes, lines apart, it equals the fit with ``segments=1`` of the one
    record that has them one after the other with gaps of more than 64 samples between, to rounding: such
    gaps part the blocks of a record, whose likelihoods multiply. That holds for up to four blocks in all;
    a record of more has wider bins, and the pooled fit is the finer one. It does not hold for gaps of up to
    64 samples, which a fit completes by expectation instead. Steps, cycles and the effect of temperature are
    taken out of each record by itself, while the fit of one long record has one of each for all of it; heavy
    tails and spikes are judged by record, and an output filter that no record shows by itself is none. A
    ramp, where `model` has one, is common to all records.
    """
    structure = structure_of(model, level)
    every = bins_of(fits)
    refuse_different(fits)
    return pool_bins(every, structure, sensor=fits[0].sensor, rate_hz=fits[0].rate_hz, level=level)


def pool_bins(
    every: Sequence[Bins], structure: tuple[str, ...], *, sensor: Sensor | None, rate_hz: float, level: float
) -> PooledFit:
    """Return the fit of records of one unit, one rate and one output filter; as `pool` from there on."""
    found = fit_bins(every, structure, level=level)
    tests = record_tests(found)
    differs = {test.key for test in tests if test.p_value < CHANCE}

    joint = {e.key: e for e in found.estimates}
    asked = [(t, joint[t.key], t.key in differs) for t in tests if differs and t.key in joint]
    widened = means_over_records(every, structure, asked, level)
    estimates = tuple(widened.get(e.key, (e, 0.0))[0] for e in found.estimates)
    homogeneity = tuple(
        Homogeneity(
            key=test.key,
            symbol=test.symbol,
            statistic=test.statistic,
            dof=test.dof,
            p_value=test.p_value,
            spread=widened[test.key][1] if test.key in differs & widened.keys() else 0.0,
            values=tuple(test.values.tolist()),
            differs=test.key in differs,
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
        findings=_findings(homogeneity, found.goodness, structure_text(structure)),
    )


def _shown(model: NoiseModel, estimates: tuple[Estimate, ...]) -> NoiseModel:
    """Return the model with the values of the estimates, without the terms that became bounded."""
    kept = [term for term in model.terms if term.symbol in {"GM", "R"}]
    others = [
        TERMS[e.symbol].of(e.value) for e in estimates if e.value is not None and e.symbol not in {"GM", "R"}
    ]
    return NoiseModel(terms=tuple(sorted((*others, *kept), key=lambda term: list(TERMS).index(term.symbol))))


def _findings(homogeneity: tuple[Homogeneity, ...], goodness: Goodness, model: str) -> tuple[Finding, ...]:
    findings = []
    changing = [test for test in homogeneity if test.differs]
    if changing:
        said = "; ".join(f"{t.key} by {100 * t.spread:.2g} % (p = {t.p_value:.2g})" for t in changing)
        findings.append(
            Finding(
                level="warning",
                code="records-differ",
                axis=None,
                text=f"The records differ from one another by more than chance: {said}; "
                "intervals are those of the mean over records.",
                advice="Look for what changed between them (temperature, mounting, supply); another record "
                "may differ as much.",
            )
        )
    if goodness.statistic > MISFIT:
        findings.append(
            Finding(
                level="warning",
                code="model-misfit",
                axis=None,
                text=f"{model} does not describe these records: the squared residuals of their spectra are "
                f"{goodness.chi2_per_bin:.3g} on average where 1 is expected (score "
                f"{goodness.statistic:.1f}).",
                advice="Give a model with the terms that the single fits found.",
            )
        )
    return tuple(findings)
