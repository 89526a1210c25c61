"""The fitted model in each segment of a record: which of its terms are the same in all of them.

A term is tested with white noise free to vary beside it, so that a change of the white noise is not
blamed on the term; white noise itself with all slower terms free in one. Everything else, correlation
times and the output filter too, is as in the whole record.
"""

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray
from imucal.fitting.homogeneity import bartlett_correction, cochran_q, homogeneity
from imucal.fitting.segments import Segments, TermHomogeneity, Trace
from imucal.fitting.spectral.absent_terms import COLUMN
from imucal.fitting.spectral.blocks import SeriesBlocks
from imucal.fitting.spectral.estimates import Fitted, Problem
from imucal.fitting.spectral.intervals import quantile
from imucal.fitting.spectral.likelihood import contributions
from imucal.fitting.spectral.scoring import bounds
from imucal.fitting.spectral.segment_ordinates import SegmentOrdinates, segment_ordinates
from imucal.fitting.spectral.segment_scales import Parts, Scales, fit_scales, scales_at
from imucal.fitting.spectral.structures import candidates_of, parameter_columns
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, in_order
from imucal.recording import AxisSeries

#: A term that the fit lacks is looked for from this share of the spectrum on, where its share is largest.
_SHARE = 0.1
#: Standard error of a log below which a segment tells a term by itself.
_SURE = 0.1
#: Longest averaging time of the floor, as a part of a segment.
_PART = 0.25


def fit_segments(
    series: AxisSeries,
    blocks: SeriesBlocks,
    problem: Problem,
    fitted: Fitted,
    *,
    model: NoiseModel,
    curve: AllanCurve,
    wanted: int,
    fraction: float,
) -> Segments | None:
    """Return what the segments of a record say of its fit; None where it is too short for any.

    Parameters
    ----------
    series
        Finite samples.
    blocks
        Their blocks.
    problem, fitted
        What was fitted, and the model that is shown.
    model
        The same in SI.
    curve
        Of the series: its minimum is the averaging time of the floor.
    wanted
        Most segments.
    fraction
        Upper end of the band, as a fraction of Nyquist.
    """
    names, beta = problem.ordinates.names, fitted.maximum.beta[0].tolist()
    found = segment_ordinates(
        series,
        blocks.blocks,
        drift={name: value for name, value in zip(names, beta, strict=True) if value},
        scale=blocks.scale,
        wanted=wanted,
        fraction=fraction,
    )
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
        terms=tests.terms(),
    )


class _Tests:
    """The tests of one fit's terms; spectra have a row for each variance parameter."""

    def __init__(self, problem: Problem, fitted: Fitted, segments: SegmentOrdinates) -> None:
        self.problem, self.segments = problem, segments
        missing = [symbol for symbol in ALWAYS if symbol not in fitted.structure]
        self.structure = in_order((*fitted.structure, *missing))
        self.absent = [COLUMN[symbol] for symbol in missing]
        old = fitted.candidate
        candidate = candidates_of(
            [self.structure],
            (),
            poles=int(old.poles[0]),
            zeros=int(old.zeros[0]),
            room_markov=old.room_markov,
        )
        theta = fitted.maximum.theta.copy()
        theta[:, self.absent] = bounds(problem.ordinates, candidate, shortest=problem.shortest)[0][
            self.absent
        ]
        self.spectra = contributions(segments.ordinates, candidate, theta)
        self.whole = np.delete(self.spectra, self.absent, axis=0).sum(axis=0)
        for column in self.absent:
            self.spectra[column] *= _SHARE / np.max(self.spectra[column] / self.whole)
        self.columns = dict(parameter_columns(self.structure, old.room_markov))
        self.spans = np.stack([segments.start_s, segments.end_s], axis=1)

    def terms(self) -> tuple[TermHomogeneity, ...]:
        """Return the test of each term but the ramp, by rising slope."""
        names = [name for name in self.columns if not name.endswith(".T")]
        return tuple(self.test(name) for name in names)

    def test(self, name: str) -> TermHomogeneity:
        """Return the test of one term: Cochran's Q where each segment tells it, else the likelihood ratio."""
        parts, surplus = self.parts(self.columns[name]), self.surplus(name)
        free, common = (fit_scales(parts, common=held) for held in (False, True))
        # The variance of the log of a deviation is a quarter of that of its square's.
        logs, weight = free.tested / 2, 4 * free.information / surplus
        if weight.min() > _SURE**-2:
            statistic = cochran_q(logs, weight)
        else:
            weight = 4 * common.information / surplus
            statistic = 2 * (common.objective - free.objective) / surplus
            statistic /= bartlett_correction(common.information)
        return homogeneity(name.partition(".")[0], statistic, logs, weight, self.spans)

    def surplus(self, name: str) -> float:
        """Return by what factor the variance of a log is larger than the likelihood's: heavy tails."""
        return self.problem.widening.get(name, 1.0) ** 2

    def parts(self, column: int) -> Parts:
        """Return what is tested, and what is free beside it."""
        white = COLUMN["N"]
        rows = [c for c in range(white + 1, len(self.spectra)) if c not in self.absent]
        if column != white:
            rows = [white] if white not in self.absent else []
        tested, beside = self.spectra[column], self.spectra[rows].sum(axis=0)
        held = self.whole - beside - (0.0 if column in self.absent else tested)
        ordinates = self.segments.ordinates
        return Parts(
            held=np.maximum(held, 0.0),
            tested=tested,
            beside=beside,
            size=ordinates.size,
            power=ordinates.power,
            first=self.segments.first,
        )

    def traces(
        self, model: NoiseModel, curve: AllanCurve, series: AxisSeries
    ) -> tuple[Trace | None, Trace | None, float]:
        """Return N and the floor of each segment, and the floor's averaging time."""
        length = float(np.min(self.segments.end_s - self.segments.start_s))
        tau = min(curve.minimum[1], _PART * length)
        m = np.array([max(tau / series.tau0, 1.0)])
        shares = {
            symbol: float(
                NoiseModel(terms=tuple(t for t in model.terms if t.symbol == symbol)).avar(
                    m, rate_hz=series.rate_hz
                )[0]
            )
            for symbol in {term.symbol for term in model.terms} - {"R"}
        }
        white = next((term for term in model.terms if term.symbol == "N"), None)
        slow = sum(share for symbol, share in shares.items() if symbol not in {"Q", "N"})
        if white is None:
            return None, None, np.nan
        parts = self.parts(COLUMN["N"])
        free = fit_scales(parts, common=False)
        sure = scales_at(parts, np.zeros(self.spans.shape[0]), np.zeros(self.spans.shape[0]))
        z = quantile(self.problem.level)
        surplus = self.surplus("N")
        n = _trace(abs(white.values[0]), free.tested, z * np.sqrt(surplus / sure.information))
        if not slow:
            return n, None, np.nan
        fast, rest = shares["N"] * np.exp(free.tested), slow * np.exp(free.beside)
        total = fast + rest + shares.get("Q", 0.0)
        error = np.sqrt(_variance(sure, fast / total, rest / total, surplus))
        return n, _trace(1.0, np.log(total), z * error), tau


def _variance(sure: Scales, fast: FloatArray, slow: FloatArray, surplus: float) -> FloatArray:
    """Return the variance of the log of a sum of both parts that have these shares of it, shape (s,)."""
    tested, both, beside = sure.matrix
    determinant = tested * beside - both**2
    variance: FloatArray = (
        surplus * fast**2 * beside - 2 * fast * slow * both + slow**2 * tested
    ) / determinant
    return variance


def _trace(unit: float, logs: FloatArray, reach: FloatArray) -> Trace:
    """Return `unit` times the root of squares whose logs are known to within `reach`."""
    value, low, high = (unit * np.exp(x / 2) for x in (logs, logs - reach, logs + reach))
    return Trace(value=value, low=low, high=high)
