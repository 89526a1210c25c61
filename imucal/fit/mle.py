"""Maximum likelihood on the spectrum of the samples: the default method."""

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fit.band import find_band
from imucal.fit.estimates import (
    Fitted,
    Scales,
    add_term,
    covariance_of,
    drop_terms,
    estimate,
    model_of,
    upper_bound,
)
from imucal.fit.goodness import misfit
from imucal.fit.ordinates import Ordinates
from imucal.fit.result import Candidate, Estimate, Goodness, NoiseFit
from imucal.fit.selection import Choice, choose
from imucal.fit.structures import Structure, all_structures
from imucal.fit.transform import bin_blocks, scale_of, transform
from imucal.noise.model import structure_text
from imucal.noise.terms import TERMS
from imucal.recording import AxisSeries

__all__ = ["fit_mle"]

#: Fewest samples that a model can be fitted to.
_FEWEST = 64
#: Shortest correlation time that `auto` takes for a Gauss-Markov term, in samples; what is
#: shorter is the sensor's output filter.
_SHORTEST = 10.0
#: Models whose criterion is within this of the best are listed.
_NEAR = 6.0
#: Terms that every fit reports.
_ALWAYS = ("N", "B", "K")


def fit_mle(
    series: AxisSeries,
    curve: AllanCurve,
    structure: Structure | None,
    *,
    level: float,
    criterion: str,
    max_gm: int,
    temperature: FloatArray | None = None,
    verify: bool = False,
) -> NoiseFit:
    """Fit a noise model to an axis by maximum likelihood.

    Parameters
    ----------
    series
        Finite samples.
    curve
        Their Allan curve, for the picture; the fit does not use it.
    structure
        Terms of the model; None to choose them by `criterion`.
    level
        Confidence level of the intervals.
    max_gm
        Most Gauss-Markov terms to choose from.
    temperature
        In degrees Celsius at the samples, shape (n,), or None.
    verify
        Compare with the exact state-space likelihood.

    Raises
    ------
    DataError
        If there are too few samples, or they are all equal.
    """
    if series.n < _FEWEST:
        msg = f"{series.name}: {series.n} samples, expected at least {_FEWEST}; record for longer"
        raise DataError(msg)
    scale = scale_of(series.samples, series.name)
    whole = bin_blocks([transform(series.samples / scale)], scale)
    shortest = _SHORTEST if structure is None else 2.0
    band = find_band(whole, _richest(structure, max_gm), shortest=_SHORTEST)
    ordinates = whole.below(band.fraction)
    structures = _structures(structure, max_gm, filtered=band.poles > 0)
    choice = choose(
        ordinates,
        structures,
        criterion=criterion,
        poles=band.poles,
        zeros=band.zeros,
        response=band.response,
        shortest=shortest,
    )
    scales = Scales(unit=scale, tau0=series.tau0, widening={})
    fitted = Fitted(
        structure=choice.structures[0],
        candidate=choice.candidates.take(np.array([0])),
        maximum=choice.maximum.take(np.array([0])),
    ).by_time()
    fitted, estimates = _settle(ordinates, fitted, scales, level=level, shortest=shortest)
    found = misfit(ordinates, fitted.candidate, fitted.maximum.theta)
    names, covariance = covariance_of(fitted, estimates, scales)
    nyquist = series.rate_hz / 2
    return NoiseFit(
        method="mle",
        sensor=series.sensor,
        rate_hz=series.rate_hz,
        level=level,
        model=model_of(estimates, fitted, scales),
        estimates=estimates,
        parameters=names,
        covariance=covariance,
        goodness=Goodness(
            statistic=found.statistic,
            p_value=found.p_value,
            chi2_per_bin=found.chi2_per_bin,
            band_hz=(float(ordinates.fraction.min()) * nyquist, float(ordinates.fraction.max()) * nyquist),
        ),
        curve=curve,
        used=_used(curve, band.fraction),
        candidates=_candidates(choice),
        criterion="given" if structure is not None else criterion,
        findings=_choice_findings(choice, series.name) if structure is None else (),
    )


def _richest(structure: Structure | None, max_gm: int) -> Structure:
    """Return a structure that holds every candidate."""
    if structure is None:
        return ("Q", "N", "B", *["GM"] * max_gm, "K", "R")
    order = list(TERMS)
    missing = [s for s in ("N", "B", "GM", "K") if s not in structure]
    return tuple(sorted((*structure, *missing), key=order.index))


def _structures(structure: Structure | None, max_gm: int, *, filtered: bool) -> list[Structure]:
    """Return the candidates; behind a filter they have N, which the response refers to, and no Q."""
    if structure is not None:
        return [structure]
    every = all_structures(max_gm, quantization=not filtered)
    return [s for s in every if "N" in s] if filtered else every


def _settle(
    ordinates: Ordinates, fitted: Fitted, scales: Scales, *, level: float, shortest: float
) -> tuple[Fitted, tuple[Estimate, ...]]:
    """Return the fit without the terms that may be zero, and estimates or bounds of all terms."""
    bounded: dict[str, Estimate] = {}
    estimates = estimate(ordinates, fitted, scales, level=level, shortest=shortest)
    while any(e.status == "bounded" for e in estimates):
        keys = [e.key for e in estimates if e.status == "bounded"]
        if len(keys) == len(estimates):
            break
        bounded |= {e.key: e for e in estimates if e.status == "bounded"}
        fitted = drop_terms(ordinates, fitted, keys, shortest=shortest, common=())
        estimates = estimate(ordinates, fitted, scales, level=level, shortest=shortest)
    known = {e.symbol for e in estimates} | set(bounded)
    for symbol in _ALWAYS:
        if symbol not in known:
            added = add_term(ordinates, fitted, symbol, shortest=shortest, common=())
            bounded[symbol], _ = upper_bound(ordinates, added, symbol, scales, level=level, shortest=shortest)
    order = list(TERMS)
    everything = sorted((*estimates, *bounded.values()), key=lambda e: (order.index(e.symbol), e.key))
    return fitted, tuple(everything)


def _used(curve: AllanCurve, fraction: float) -> IntArray:
    """Return the points of the curve that average over less than the band that was used."""
    return np.flatnonzero(curve.m * fraction >= 1 - 1e-9)


def _candidates(choice: Choice) -> tuple[Candidate, ...]:
    delta = choice.criterion - choice.criterion[0]
    return tuple(
        Candidate(structure=structure_text(structure), delta=float(d))
        for structure, d in zip(choice.structures, delta, strict=True)
        if d <= _NEAR
    )


def _choice_findings(choice: Choice, axis: str) -> tuple[Finding, ...]:
    near = _candidates(choice)[1:]
    if not near:
        return ()
    best = structure_text(choice.structures[0])
    others = ", ".join(f"{c.structure} (+{c.delta:.1f})" for c in near)
    return (
        Finding(
            level="info",
            code="model-choice",
            axis=axis,
            text=f"The record does not tell {best} from {others} for sure.",
            advice="Record for longer, or fix the model if the sensor's noise is known.",
        ),
    )
