"""The fit of a given model from stored bins, of one record or of several as one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.fitting.bins import Bins
from imucal.fitting.homogeneity import widened
from imucal.fitting.noise_fit import Estimate, Goodness
from imucal.fitting.spectral.absent_terms import (
    add_term,
    estimate_or_bound,
    fitted_model,
    numbered,
    with_absent,
)
from imucal.fitting.spectral.band import find_band
from imucal.fitting.spectral.estimates import Fitted, Problem, misfits_of, model_of
from imucal.fitting.spectral.filter_response import Band
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.fitting.spectral.scoring import misfit
from imucal.fitting.spectral.selection import choose
from imucal.fitting.spectral.stored_ordinates import joined, ordinates_of
from imucal.fitting.spectral.structures import SHORTEST, SHORTEST_GIVEN, Structure, richest
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BinFit:
    """A model fitted to bins.

    Attributes
    ----------
    records
        The ordinates of each record, up to the end of the band, in the scale of the first.
    problem
        What is fitted, all records as one.
    band
        The part of the spectrum, and the response of the output filter in it.
    whole
        The fit of the given terms and of N, B and K, at zero where the data want them there.
    model, estimates
        What a fit reports: those whose interval holds 0 are bounded, and not in the model.
    goodness
        How well the model describes all records.
    misfits
        Symbol -> by what factor a misfit makes its limits wider; empty where the model fits.
    """

    records: tuple[Ordinates, ...]
    problem: Problem
    band: Band
    whole: Fitted
    model: NoiseModel
    estimates: tuple[Estimate, ...]
    goodness: Goodness
    misfits: dict[str, float]


def fit_bins(bins: Sequence[Bins], structure: Structure, *, level: float, max_gm: int = 2) -> BinFit:
    """Return the fit of a structure to one or several records: as `fit_mle` from there on."""
    parts = [ordinates_of(one) for one in bins]
    every = joined(parts) if len(parts) > 1 else parts[0]
    common = every.names[1:]
    band = _band(every, parts, structure, max_gm)
    seen = every.below(band.fraction)
    problem = Problem(
        ordinates=seen,
        level=level,
        shortest=SHORTEST_GIVEN,
        common=common,
        unit=every.scale,
        tau0=bins[0].tau0,
        widening={"N": _widening(bins)},
    )
    choice = choose(seen, [structure], criterion="bic", band=band, common=common, shortest=SHORTEST_GIVEN)
    fitted, own = estimate_or_bound(problem, choice)
    whole = fitted_model(choice, 0)
    for symbol in ALWAYS:
        if symbol not in whole.structure:
            whole = add_term(problem, whole, symbol)
    found = misfit(seen, fitted.candidate, fitted.maximum.theta)
    estimates, _ = numbered(with_absent(problem, fitted, own), ())
    owner = np.repeat(np.arange(len(parts)), [one.size.size for one in parts])
    edges = [every.take(owner == i).below(band.fraction) for i in range(len(parts))]
    misfits = misfits_of(problem, fitted, found)
    return BinFit(
        records=tuple(edges),
        problem=problem,
        band=band,
        whole=whole,
        model=model_of(problem, fitted, own),
        estimates=widened(estimates, None, misfits),
        goodness=found,
        misfits=misfits,
    )


def _band(every: Ordinates, parts: Sequence[Ordinates], structure: Structure, max_gm: int) -> Band:
    """Return the band and response of all records; flat where most records by themselves are.

    Records whose coefficients differ fit no one model; together they may look like a filter's doing.
    """

    def find(whole: Ordinates) -> Band:
        rich, common = richest(structure, max_gm), whole.names[1:]
        return find_band(whole, rich, shortest=SHORTEST, common=common, given=structure)

    band = find(every)
    if len(parts) > 1 and not _flat(band):
        own = [find(part) for part in parts]
        flat = [alone for alone in own if _flat(alone)]
        if 2 * len(flat) > len(own):
            return flat[0]
    return band


def _flat(band: Band) -> bool:
    return band.poles == 0 and band.fraction == 1.0


def _widening(bins: Sequence[Bins]) -> float:
    """Return the factor of all records: half the excess kurtosis plus one, weighted by their ordinates."""
    weight = np.array([one.size.sum() for one in bins])
    return float(np.sqrt(np.average([one.widening**2 for one in bins], weights=weight)))
