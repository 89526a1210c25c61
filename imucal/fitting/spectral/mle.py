"""Maximum likelihood on the spectrum of the samples: the default method.

The fit includes an output filter, and excludes lines and frequencies above its band; the Allan curve contains
them all. With the response H of the Allan variance, the share of noise in the curve is

    sum H S_model / (sum H S_seen + lines).

S_seen is the model behind its filter, and above the band the measured spectrum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Transform
from imucal.allan.intervals import power_response
from imucal.arrays import FloatArray, IntArray
from imucal.findings import Finding
from imucal.fitting.homogeneity import (
    nonstationary_finding,
    widened,
    widened_covariance,
)
from imucal.fitting.noise_fit import MISFIT, Estimate, Goodness, NoiseFit, Segments
from imucal.fitting.regressors import Bump, LevelChange, Ramp, Regressor
from imucal.fitting.robust import heavy_tails, resolution_effect, step_size
from imucal.fitting.settings import FitSettings
from imucal.fitting.spectral.blocks import SeriesBlocks, bins_of, make_blocks
from imucal.fitting.spectral.bounds import either, estimate_or_bound, hull_estimates, numbered, with_absent
from imucal.fitting.spectral.disturbances.band import Band, filter_finding, response_of
from imucal.fitting.spectral.disturbances.band_search import find_band
from imucal.fitting.spectral.disturbances.high_pass import above_high_pass, find_high_pass, high_pass_finding
from imucal.fitting.spectral.disturbances.levels import (
    AT_THE_TOP,
    Level,
    hidden_levels,
    level_at_the_top,
    levels_finding,
    outside,
    with_levels,
)
from imucal.fitting.spectral.disturbances.not_noise import (
    doubtful_findings,
    find_shapes,
    line_finding,
    tone_finding,
)
from imucal.fitting.spectral.disturbances.segments import fit_segments
from imucal.fitting.spectral.disturbances.shapes import Disturbance, regressors_of
from imucal.fitting.spectral.disturbances.sparse import sparse_factor, sparse_finding, wrong_share
from imucal.fitting.spectral.estimates import Problem, covariance_of, misfits_of, model_of
from imucal.fitting.spectral.likelihood import Fits, spectra
from imucal.fitting.spectral.maximum import UNLIKELY, misfit, octave_score
from imucal.fitting.spectral.models import SHORTEST_GIVEN, Structure, all_structures, richest
from imucal.fitting.spectral.ordinates import FLICKER, Ordinates, band_top
from imucal.fitting.spectral.selection import RankedModels, choice_findings, choose, near_candidates
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.recording import AxisSeries
from imucal.side_work import try_side_work

#: Share of the width of N's interval from which another form of flicker noise is tried.
_NOTICEABLE = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """The part of the spectrum to fit.

    `ordinates` are the bins of the `band`, and `whole` all bins. `doubtful` are shapes that may be needed
    in addition.
    """

    blocks: SeriesBlocks
    band: Band
    ordinates: Ordinates
    whole: Ordinates
    doubtful: tuple[Disturbance[Regressor], ...]
    findings: tuple[Finding, ...]


def fit_mle(
    series: AxisSeries | None,
    curve: AllanCurve,
    settings: FitSettings,
    temperature: FloatArray | None = None,
    transform: Transform | None = None,
) -> NoiseFit:
    """Fit a noise model to finite samples, gaps allowed, by maximum likelihood.

    A curve without samples is a ValueError. Samples that are too few or all equal are a DataError.
    `temperature`, shape (n,), is in degrees Celsius at the samples. `transform` is computed if None.
    """
    if series is None:
        msg = "maximum likelihood needs the samples, got an Allan curve; use method 'gmwm' or 'slope'"
        raise ValueError(msg)
    view = spectral_view(series, settings, temperature, transform)
    widening = {"N": heavy_tails(series.samples)}
    problem = Problem(ordinates=view.ordinates, level=settings.level, tau0=series.tau0, widening=widening)
    choice = _choice(problem, view.band, settings)
    fitted, own, plain = _estimates(problem, choice, settings)
    estimates = _with_other_readings(plain, problem, view, settings)
    found = misfit(view.ordinates, fitted)
    misfits = misfits_of(problem, fitted, found)
    response = response_of(view.band, series.rate_hz)
    names, covariance = covariance_of(problem, fitted, own)
    model = model_of(problem, fitted, own)
    wrong = wrong_share(view.ordinates, fitted, model, series) if view.blocks.sparse else 0.0
    sparse = sparse_factor(estimates, wrong)
    factors = {symbol: max(sparse, misfits.get(symbol, 1.0)) for symbol in TERMS}

    def over_time() -> Segments | None:
        if settings.segments < 2:
            return None
        return fit_segments(
            series,
            view.blocks,
            problem,
            fitted,
            model=model,
            curve=curve,
            wanted=settings.segments,
            band=view.band,
        )

    segments, not_compared = try_side_work(
        over_time,
        None,
        what="The parts of the record are not compared",
        code="nonstationary",
        axis=series.name,
    )
    covariance = widened_covariance(names, covariance, segments, factors)
    estimates, names = numbered(_or_filter(widened(estimates, segments, factors), view.band), names)
    levels = _other_levels(estimates, problem, view, fitted, series) if settings.structure is None else ()
    two_levels = levels_finding(estimates, levels, TERMS["N"].unit(series.sensor), series.name)
    estimates = with_levels(estimates, levels)
    findings = [*view.findings]
    if settings.structure is None:
        findings += _doubtful_findings(view, series, plain)
    findings += tone_finding(view.blocks, series, fitted=True)
    findings += line_finding(view.blocks.lines, series)
    findings += filter_finding(fitted, view.band, response, rate_hz=series.rate_hz, axis=series.name)
    findings += [*two_levels, *sparse_finding(sparse, series.name)]
    octaves = octave_score(view.ordinates, fitted)
    findings += _misfit_findings(found, octaves, misfits, str(model), series.name)
    findings += [*not_compared, *nonstationary_finding(segments, series.name)]
    if settings.structure is None:
        findings += choice_findings(choice, series.name)
    white = next(e for e in estimates if e.key == "N")
    findings += resolution_effect(series, white.value or 0.0)
    nyquist = series.rate_hz / 2
    band_hz = (float(view.ordinates.fraction.min()) * nyquist, view.band.fraction * nyquist)
    coefficients = (fitted.beta[0] * view.whole.scale).tolist()
    taken_out = dict(zip(view.whole.regressors[1:], coefficients[1:], strict=True))
    return NoiseFit(
        method="mle",
        sensor=series.sensor,
        rate_hz=series.rate_hz,
        level=settings.level,
        model=model,
        estimates=estimates,
        parameters=names,
        covariance=covariance,
        goodness=replace(found, band_hz=band_hz, lines=view.blocks.lines),
        curve=curve,
        used=_used(curve, view.band, response.cutoff_hz / nyquist if response else 1.0),
        response=response,
        candidates=near_candidates(choice),
        criterion=settings.chosen_by,
        findings=tuple(findings),
        settings={
            "band_fraction": view.band.fraction,
            "response_coefficients": view.band.poles,
            "regressors": [regressor.name for regressor in taken_out],
        },
        noise_share=_noise_share(view, fitted, curve, series.rate_hz),
        taken_out=taken_out,
        segments=segments,
        bins=bins_of(view.whole, view.blocks, tau0=series.tau0, widening=widening["N"]),
    )


def _estimates(
    problem: Problem, choice: RankedModels, settings: FitSettings
) -> tuple[Fits, tuple[Estimate, ...], tuple[Estimate, ...]]:
    if settings.structure is None:
        return hull_estimates(problem, choice)
    fitted, own = estimate_or_bound(problem, choice)
    return fitted, own, with_absent(problem, fitted, own)


def _with_other_readings(
    estimates: tuple[Estimate, ...], problem: Problem, view: View, settings: FitSettings
) -> tuple[Estimate, ...]:
    """Return estimates whose limits also cover a fit without doubtful shapes, and with averaged flicker."""
    if settings.structure is not None:
        return estimates
    if view.doubtful:
        # A second fit removes the doubtful warm-up or cycle too.
        regressors = (*view.whole.regressors, *regressors_of(view.doubtful))
        other = view.band.select(view.blocks.binned(regressors))
        alternative = replace(problem, ordinates=other)
        estimates = either(
            estimates, hull_estimates(alternative, _choice(alternative, view.band, settings))[2]
        )
    if _flicker_moves_n(problem, estimates):
        averaged = replace(problem, ordinates=problem.ordinates.with_averaged_flicker())
        estimates = either(estimates, hull_estimates(averaged, _choice(averaged, view.band, settings))[2])
    return estimates


def _doubtful_findings(view: View, series: AxisSeries, plain: Sequence[Estimate]) -> tuple[Finding, ...]:
    """Return the findings about doubtful shapes; a change of level matters only if K is shown without it."""
    walk = any(one.symbol == "K" and one.low > 0 for one in plain)
    doubtful = [one for one in view.doubtful if walk or not isinstance(one.shape, LevelChange | Bump)]
    return doubtful_findings(doubtful, series, view.blocks.scale)


def _flicker_moves_n(problem: Problem, estimates: Sequence[Estimate]) -> bool:
    """Whether the two forms of flicker noise differ at the top of the band by a part of N's interval."""
    white, flicker = (next(e for e in estimates if e.symbol == symbol) for symbol in ("N", "B"))
    data = problem.ordinates
    averaged = data.with_averaged_flicker()
    difference = float((data.basis[FLICKER] - averaged.basis[FLICKER])[-1])
    off = (flicker.high / problem.deviation("B")) ** 2 * difference
    width = (white.high**2 - white.low**2) / problem.deviation("N") ** 2
    return off > _NOTICEABLE * width


def _other_levels(
    estimates: tuple[Estimate, ...], problem: Problem, view: View, fitted: Fits, series: AxisSeries
) -> tuple[Level, ...]:
    """Return readings of N besides that of the fit: at the highest frequencies, and before a smoothing."""
    if view.band.flat:
        return hidden_levels(estimates, tau0=series.tau0)
    rounding = ((step_size(series.samples) or 0.0) / view.blocks.scale) ** 2 / 12
    found = level_at_the_top(view.whole, fitted.beta[0], rounding=rounding)
    if found is None:
        return ()
    variance, error = found
    value = problem.deviation("N") * variance**0.5
    top = Level(value=value, low=value * (1 - error), high=value * (1 + error), cause=AT_THE_TOP)
    return outside(estimates, [top])


def _or_filter(estimates: tuple[Estimate, ...], band: Band) -> tuple[Estimate, ...]:
    """Add Gauss-Markov noise to N's alternatives, if it may explain the spectrum instead of a filter."""
    if not band.masked:
        return estimates
    markov = GaussMarkov.symbol
    return tuple(replace(e, alternatives=(*e.alternatives, markov)) if e.key == "N" else e for e in estimates)


def _choice(problem: Problem, band: Band, settings: FitSettings) -> RankedModels:
    return choose(
        problem.ordinates,
        _structures(settings.structure, settings.max_gm, white=band.poles > 0 or band.hump is not None),
        criterion=settings.criterion,
        band=band,
        shortest=band.shortest if settings.structure is None else SHORTEST_GIVEN,
    )


def _noise_share(view: View, fitted: Fits, curve: AllanCurve, rate_hz: float) -> FloatArray | None:
    """Return the share of noise in each Allan variance, from the longest block; None if it is all noise.

    A line of amplitude A at f adds A² sin⁴(pi f m tau0) / (m sin(pi f tau0))² to the variance.
    """
    lines = view.blocks.lines
    if not lines and view.band.flat:
        return None
    groups = [group[0].bins for group in view.blocks.groups]
    sizes = [bins.size for bins in groups]
    longest = int(np.argmax([bins.n for bins in groups]))
    bins = groups[longest]
    whole = view.whole[np.repeat(np.arange(len(sizes)), sizes) == longest]
    model, seen = _spectra(whole, fitted, view.band)
    half = np.pi * np.array([line.frequency_hz for line in lines]) / rate_hz
    square = (np.array([line.amplitude for line in lines]) / whole.scale) ** 2
    share = np.empty(curve.m.size)
    for i, m in enumerate(curve.m.tolist()):
        response = bins.count * power_response(bins, m)[0]
        of_lines = float(np.sum(square * np.sin(half * m) ** 4 / (m * np.sin(half)) ** 2))
        total = float(response @ seen) + bins.n * of_lines
        share[i] = float(response @ model) / total if total > 0 else 1.0
    return share


def _spectra(whole: Ordinates, fitted: Fits, band: Band) -> tuple[FloatArray, FloatArray]:
    """Return the model's spectrum and the spectrum of the curve in every bin."""
    model = fitted.unfiltered(whole)
    inside = band.holds(whole)
    part = replace(whole[inside], top=band_top(band.fraction))
    measured = np.where(whole.size > 0, whole.power / np.maximum(whole.size, 1e-12), model)
    seen = np.where(inside, model, measured)
    seen[inside] = spectra(part, fitted.models, fitted.theta)[0][0]
    return model, seen


def spectral_view(
    series: AxisSeries,
    settings: FitSettings,
    temperature: FloatArray | None,
    transform: Transform | None = None,
) -> View:
    """Return the part of the spectrum that a rich model describes."""
    blocks = make_blocks(series, temperature, transform)
    found, doubtful, findings = find_shapes(series, blocks)
    whole = blocks.binned((Ramp(), *regressors_of(found)))
    corner = find_high_pass(whole)
    if corner is not None:
        whole = above_high_pass(whole, corner)
        findings += (high_pass_finding(corner, series),)
    band = find_band(
        whole,
        richest(settings.structure, settings.max_gm),
        given=settings.structure,
        rounding=lambda: ((step_size(series.samples) or 0.0) / blocks.scale) ** 2 / 12,
    )
    return View(
        blocks=blocks,
        band=band,
        ordinates=band.select(whole),
        whole=whole,
        doubtful=doubtful,
        findings=blocks.findings + findings,
    )


def _structures(structure: Structure | None, max_gm: int, *, white: bool) -> list[Structure]:
    """Return the candidates; behind a filter and around a hump (`white`) all have N and none has Q."""
    if structure is not None:
        return [structure]
    every = all_structures(max_gm, quantization=not white)
    return [s for s in every if "N" in s] if white else every


def _used(curve: AllanCurve, band: Band, corner: float) -> IntArray:
    """Return the points of the curve at times longer than the periods of the filter."""
    return np.flatnonzero(curve.m * min(band.fraction, corner) >= 1 - 1e-9)


def _misfit_findings(
    found: Goodness, octaves: float, misfits: dict[str, float], model: str, axis: str
) -> tuple[Finding, ...]:
    """Return the warning for large residuals, or for octaves that are too high or too low as a whole."""
    if found.statistic < MISFIT and octaves > UNLIKELY:
        return ()
    if found.statistic < MISFIT:
        why = f"some octaves of its spectrum are too high or too low (by chance with p = {octaves:.1g})."
    else:
        wider = ", ".join(f"{symbol} {factor:.3g}" for symbol, factor in misfits.items() if factor > 1)
        allow = f" The intervals are wider to allow for it: {wider} times." if wider else ""
        why = (
            f"the mean squared residual of its spectrum is {found.chi2_per_bin:.3g}, expected 1 "
            f"(score {found.statistic:.1f}).{allow}"
        )
    text = f"{model} does not describe this axis: {why}"
    advice = "Look for vibration, tones and other disturbances in the spectrum."
    return (Finding("warning", "model-misfit", text, advice, axis=axis),)
