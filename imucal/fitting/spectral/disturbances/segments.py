"""The fitted model in each segment of a record, to test which terms change.

Segments have equal duration and the whole record's scale, lines, drift, correlation times and output filter.
A term is tested with free white noise, and white noise with a free common factor of all slower terms, so that
a change of one is not attributed to the other.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import dct_bins, dct_ordinates, fast_length
from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.homogeneity import SURE, bartlett_correction, cochran_q, homogeneity
from imucal.fitting.noise_fit import Segments, TermHomogeneity, Trace
from imucal.fitting.regressors import Regressor
from imucal.fitting.spectral.blocks import Block, SeriesBlocks, bin_blocks
from imucal.fitting.spectral.common_terms import Parts, visible
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.lines import left_out, outside
from imucal.fitting.spectral.estimates import Problem, quantile, student_quantile
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.maximum import bounds
from imucal.fitting.spectral.models import COLUMN
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.noise.model import NoiseModel
from imucal.noise.terms import term_keys
from imucal.recording import AxisSeries

#: Fewest samples of a segment: its white noise then has an error of 1.6 %.
_MIN_SAMPLES = 2048
#: Fewest samples of a part of a segment between long gaps, as of a block.
_MIN_PART_SAMPLES = 64
#: Least number of segments for the tests.
_MIN_SEGMENTS = 3
#: Single bins of a segment: fewer than in a fit, because the model's mean over a bin is exact.
_SINGLES = 16
#: Bins per octave of a segment, few for the same reason.
_PER_OCTAVE = 12
#: Least number of ordinates to leave out on each side of a line.
_REACH = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentOrdinates:
    """The ordinates of all segments, one after the other, without regressors.

    `first` is the index of each segment's first bin; `start_s` and `end_s` are from the first sample.
    """

    ordinates: Ordinates
    first: IntArray
    start_s: FloatArray
    end_s: FloatArray


def number_of_segments(samples: int, wanted: int) -> int:
    """Return the number of segments of a record: fewer if it is short, 0 for none."""
    count = min(wanted, samples // _MIN_SAMPLES)
    return count if count >= min(_MIN_SEGMENTS, wanted) > 1 else 0


def segment_ordinates(
    series: AxisSeries, blocks: SeriesBlocks, *, drift: Mapping[Regressor, float], wanted: int, band: Band
) -> SegmentOrdinates | None:
    """Return the ordinates of each segment of finite samples, or None if there are too few samples.

    `drift` maps regressors to take out to their coefficients in scaled units.
    """
    count = number_of_segments(series.n, wanted)
    if not count:
        return None
    clock = series.clock
    edges = np.linspace(0, clock.grid_size, count + 1).round().astype(np.int64)
    parts: list[Ordinates] = []
    kept: list[int] = []
    for number, (start, stop) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        pieces = []
        for block in blocks.blocks:
            low, high = max(start, block.offset), min(stop, block.offset + block.bins.n)
            piece = _piece(series, block, drift=drift, scale=blocks.scale, place=low, size=high - low)
            pieces += [piece] if piece else []
        if sum(piece.bins.n for piece in pieces) >= _MIN_SAMPLES // 2:
            parts.append(band.select(bin_blocks(pieces, blocks.scale, ())))
            kept.append(number)
    if len(kept) < 2:
        return None
    sizes = [part.size.size for part in parts]
    return SegmentOrdinates(
        ordinates=Ordinates.joined(parts),
        first=np.cumsum([0, *sizes[:-1]]),
        start_s=np.asarray(edges[kept] * series.tau0, dtype=np.float64),
        end_s=np.asarray(edges[np.array(kept) + 1] * series.tau0, dtype=np.float64),
    )


def _piece(
    series: AxisSeries, block: Block, *, drift: Mapping[Regressor, float], scale: float, place: int, size: int
) -> Block | None:
    """Return the part of a block from a place of the grid on, or None if it has too few samples."""
    size = fast_length(max(size, 0))
    clock = series.clock
    first, stop = clock.index_from(place), clock.index_from(place + size)
    if stop - first < max(_MIN_PART_SAMPLES, size // 2):
        return None
    seen = slice(first, stop)
    samples = series.samples[seen] / scale
    missing = size - samples.size
    if missing and block.drawn is not None:
        before = place - block.offset - (first - clock.index_from(block.offset))
        at = clock.grid(first, stop) - place
        samples = _between(samples, at, block.drawn[before : before + missing])
    before = place - block.offset
    for regressor, coefficient in drift.items():
        start = 0 if regressor.has_memory else before
        places = block.offset + np.arange(start, before + size, dtype=np.float64)
        temperature = None if block.temperature is None else block.temperature[start : before + size]
        samples -= coefficient * regressor.samples(places, temperature)[before - start :]
    bins, loss = dct_bins(size, singles=_SINGLES, per_octave=_PER_OCTAVE), None
    if missing:
        # The block's lost information at the same frequency, scaled by the part's gaps.
        whole = np.zeros(block.bins.size) if block.loss is None else block.loss
        share = missing / size * block.bins.n / block.drawn.size if block.drawn is not None else 0.0
        loss = np.clip(share * np.interp(bins.omega, block.bins.omega, whole), 0.0, 0.99)
    return Block(
        offset=place, bins=bins, ordinates=dct_ordinates(samples), kept=_kept(block, size), loss=loss
    )


def _between(samples: FloatArray, at: IntArray, drawn: FloatArray) -> FloatArray:
    filled = np.empty(samples.size + drawn.size)
    gaps = np.ones(filled.size, dtype=bool)
    gaps[at] = False
    filled[at], filled[gaps] = samples, drawn
    return filled


def _kept(block: Block, size: int) -> BoolArray | None:
    """Return the mask of a part's ordinates without the block's lines; None for all.

    The reach of a line's tail in ordinates shrinks with the root of the length.
    """
    if block.kept is None:
        return None
    first, stop = left_out(block.kept)
    shrink = size / block.bins.n
    # Ordinates count from 1.
    middle = ((first + stop) / 2 + 0.5) * shrink
    reach = np.maximum((stop - first) / 2 * np.sqrt(shrink), _REACH)
    low, high = np.floor(middle - reach).astype(np.int64) - 1, np.ceil(middle + reach).astype(np.int64)
    return outside(low, high, size - 1)


#: Longest averaging time of the floor, as a share of a segment.
_PART = 0.25


def fit_segments(
    series: AxisSeries,
    blocks: SeriesBlocks,
    problem: Problem,
    fitted: Fits,
    *,
    model: NoiseModel,
    curve: AllanCurve,
    wanted: int,
    band: Band,
) -> Segments | None:
    """Return the segments of a fit of finite samples, or None if there are too few samples.

    `fitted` is the reported model, `model` the same in SI.
    """
    coefficients = zip(problem.ordinates.regressors, fitted.beta[0].tolist(), strict=True)
    drift = {regressor: value for regressor, value in coefficients if value}
    found = segment_ordinates(series, blocks, drift=drift, wanted=wanted, band=band)
    if found is None:
        return None
    tests = _Tests(problem, fitted, found)
    white, floor, tau = tests.traces(model, curve, series)
    return Segments(
        start_s=found.start_s,
        end_s=found.end_s,
        white=white,
        floor=floor,
        floor_tau_s=tau,
        terms=tests.homogeneity(),
    )


class _Tests:
    def __init__(self, problem: Problem, fitted: Fits, segments: SegmentOrdinates) -> None:
        self.problem, self.fitted, self.segments = problem, fitted, segments
        absent = [COLUMN[symbol] for symbol in fitted.missing]
        models = fitted.models.with_laws(fitted.missing)
        theta = fitted.theta.copy()
        low, _ = bounds(problem.ordinates, models)
        theta[:, absent] = low[absent]
        spectra = derivatives(segments.ordinates, models, theta)[: models.variances]
        spectra *= visible(spectra, absent)[:, np.newaxis]
        self.spectra = spectra
        whole = np.delete(spectra, absent, axis=0).sum(axis=0)
        columns = fitted.variances(fitted.missing)
        self.names = list(columns)
        # Free: white noise in a term's test, a factor of all slower terms in white noise's.
        n = COLUMN["N"]
        white, slower = (set(rows).difference(absent) for rows in ([n], range(n + 1, len(spectra))))
        others = [spectra[sorted(slower if at == n else white)].sum(axis=0) for at in columns.values()]
        varied = np.stack([spectra[list(columns.values())], others], axis=1)
        inside = [column not in absent for column in columns.values()]
        held = whole - varied[:, 1] - np.where(np.array(inside)[:, np.newaxis], varied[:, 0], 0.0)
        self.parts = Parts(
            ordinates=segments.ordinates,
            regressors=np.zeros(0, dtype=bool),
            first=segments.first,
            varied=varied,
            held=np.maximum(held, 0.0),
        )
        self.free = self.parts.fit(common=False)
        self.spans = np.stack([segments.start_s, segments.end_s], axis=1)

    def homogeneity(self) -> tuple[TermHomogeneity, ...]:
        """Return each term's test: Cochran's Q if every segment determines it, or the likelihood ratio."""
        common = self.parts.fit(common=True)
        tests = []
        for row, name in enumerate(self.names):
            surplus = self.surplus(name)
            # A log deviation has a quarter of the variance of a log variance.
            logs, weight = self.free.logs[row, :, 0] / 2, 4 * self.free.information[row] / surplus
            if weight.min() > SURE**-2:
                statistic = cochran_q(logs, weight)
            else:
                weight = 4 * common.information[row] / surplus
                statistic = 2 * float(np.sum(common.objective[row] - self.free.objective[row])) / surplus
                statistic /= bartlett_correction(common.information[row])
            tests.append(homogeneity(name, statistic, logs, weight, self.spans))
        return tuple(tests)

    def surplus(self, name: str) -> float:
        return self.problem.widening.get(name, 1.0) ** 2

    def traces(
        self, model: NoiseModel, curve: AllanCurve, series: AxisSeries
    ) -> tuple[Trace | None, Trace | None, float]:
        length = float(np.min(self.segments.end_s - self.segments.start_s))
        # The curve's minimum may be in its uncertain end.
        lowest = curve.tau[int(np.argmin(model.avar(curve.m.astype(np.float64), rate_hz=series.rate_hz)))]
        tau = min(float(lowest), _PART * length)
        m = np.array([max(tau / series.tau0, 1.0)])
        keys = term_keys(term.symbol for term in model.terms)
        shares = {
            key: float(term.avar(m, 1 / series.rate_hz)[0])
            for key, term in zip(keys, model.terms, strict=True)
        }
        white = next((term for term in model.terms if term.symbol == "N"), None)
        slow = sum(share for key, share in shares.items() if key not in {"Q", "N", "R"})
        if white is None:
            return None, None, np.nan
        row = self.names.index("N")
        sure = self.parts.at(np.zeros(self.free.logs.shape))
        z, surplus = quantile(self.problem.level), self.surplus("N")
        fast = self.free.logs[row, :, 0]
        wide = z * np.sqrt(surplus / sure.information[row])
        value, low, high = (abs(white.values[0]) * np.exp(x / 2) for x in (fast, fast - wide, fast + wide))
        n = Trace(value=value, low=low, high=high)
        if not slow:
            return n, None, np.nan
        # Few ordinates determine the slow part: use Student's quantile.
        (tested, both), (_, others) = np.moveaxis(sure.matrix[row], 0, -1)
        reach = student_quantile(self.problem.level, np.sqrt(tested / (tested * others - both**2)))
        sums = self.parts.of(row).sum_limits(self.free.logs[row], np.array([shares["N"], slow]), reach)
        value, low, high = np.log(np.array(sums) + shares.get("Q", 0.0)) / 2
        shape = z * self._shape_error(row, shares, slow) / 2
        low, high = value - np.hypot(value - low, shape), value + np.hypot(high - value, shape)
        return n, Trace(value=np.exp(value), low=np.exp(low), high=np.exp(high)), tau

    def _shape_error(self, row: int, shares: Mapping[str, float], slow: float) -> float:
        """Return the standard error of the log of the floor's square due to the ratios of the slow terms.

        If a ratio is wrong, the fitted scales are right at other frequencies than the floor's.
        """
        own = self.fitted.variances()
        keys = [key for key in shares if key in own]
        columns = [own[key] for key in keys]
        varied = self.parts.varied[row]
        weight = 0.5 * self.segments.ordinates.size / (self.parts.held[row] + varied.sum(axis=0)) ** 2
        scales = (weight * varied) @ varied.T
        response = np.linalg.solve(scales, (weight * varied) @ self.spectra[columns].T)
        slope = np.array([shares[key] for key in keys]) - np.array([shares["N"], slow]) @ response
        variance = float(slope @ self.fitted.covariance[np.ix_(columns, columns)] @ slope)
        return math.sqrt(max(variance, 0.0)) / (slow + shares["N"] + shares.get("Q", 0.0))
