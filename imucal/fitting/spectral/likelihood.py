"""Structures, such as ("N", "B", "K"), and the likelihood of many of them at once, on binned DCT ordinates.

A debiased Whittle likelihood: the ordinates X_k of the DCT-II are taken as independent normal
with variance S_k, the exact expectation of X_k² for the sampled, finite series:

    -log L = 1/2 sum_k [log S_k + (X_k - c_k beta)² / S_k]

exact for white noise plus random walk plus ramp. beta (ramp, temperature …) is the generalised
least-squares solution. Source: Sykulski et al. (2019), Biometrika 106, "The debiased Whittle
likelihood", on the DCT instead of the Fourier transform, which removes its leakage.

Parameters of a candidate stand in one row, the same place for every candidate:

    log variances of Q, N, B, K | log variances of g other terms | logs of their times | response a_1 … a_j

with the response of the output filter |H|² = (1 - lam/4)^zeros / (1 + sum a_i (lam/top)^i).
"""

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from itertools import product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.ordinates import LAWS, SHAPED, Ordinates
from imucal.frozen import frozen_alone
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys

#: Symbols of a model's terms in the order of `imucal.noise.TERMS`, one that is there twice twice.
Structure = tuple[str, ...]

#: Shortest correlation time that `auto` takes for a term, in samples; what is
#: shorter is the sensor's output filter.
SHORTEST = 10.0
#: Shortest of a given model.
SHORTEST_GIVEN = 2.0

#: Symbol of a power-law term -> its column in a row of parameters.
COLUMN = {law.value: index for index, law in enumerate(LAWS)}
#: Added to the diagonal of the regressors' correlation.
_RIDGE = 1e-10

#: Elements of an array of which a dozen stay in the cache.
_CACHED = 16384
#: Places in a band, lam / top, where a response must be positive whatever the bins are.
_BETWEEN = np.linspace(0.4, 1.0, 25)


@frozen_alone
class Candidates:
    """Which terms each of c candidates has.

    `laws`, shape (c, 4), says whether Q, N, B, K are in it; `shaped`, shape (c, g), which of `kinds` each of
    its other terms is, -1 for none: those whose shape is no power law, a spectrum with a time in it. `poles`
    and `zeros`, shape (c,), are the order of the response's denominator and numerator, and `room_poles` the
    columns kept for it: the greatest of `poles`, or more. `regressors`, shape (c, r), says which of the
    ordinates' own are in it. Correlation times are `shortest` samples at least.
    """

    laws: BoolArray
    shaped: IntArray
    kinds: tuple[type[NoiseTerm], ...]
    poles: IntArray
    zeros: IntArray
    regressors: BoolArray
    room_poles: int
    shortest: float

    @property
    def count(self) -> int:
        """Number of candidates, c."""
        return len(self.laws)

    @property
    def room(self) -> int:
        """Most terms of other shapes, g."""
        size: int = self.shaped.shape[1]
        return size

    @property
    def variances(self) -> int:
        """Number of variances, with which a row begins; the times follow."""
        return SHAPED + self.room

    @property
    def response(self) -> int:
        """Where in a row the response begins."""
        return SHAPED + 2 * self.room

    @property
    def width(self) -> int:
        """Number of parameters in a row, p."""
        return self.response + self.room_poles

    @property
    def free(self) -> BoolArray:
        """Which parameters each candidate has, shape (c, p)."""
        # The last one is that of no term, which stands as -1.
        timed = np.array([*(len(kind.parameters()) > 1 for kind in self.kinds), False])
        has_pole = np.arange(self.room_poles) < self.poles[:, None]
        return np.concatenate([self.laws, self.shaped >= 0, timed[self.shaped], has_pole], axis=1)

    @property
    def parameters(self) -> IntArray:
        """Number of parameters of each candidate, regressors included, shape (c,)."""
        return np.asarray(self.free.sum(axis=1) + self.regressors.sum(axis=1))

    def __getitem__(self, index: IntArray | BoolArray | list[int]) -> "Candidates":
        """Return some of the candidates; an index may stand more than once."""
        rows = ("laws", "shaped", "poles", "zeros", "regressors")
        return replace(self, **{name: getattr(self, name)[index] for name in rows})


def shaped_symbols(structure: Iterable[str]) -> list[str]:
    """Return the symbols of the terms with a spectrum that is no power law."""
    return [symbol for symbol in structure if symbol not in {*COLUMN, "R"}]


def all_structures(max_gm: int, *, method: str = "mle", quantization: bool = True) -> list[Structure]:
    """Return every sum of the terms that a method fits which has noise in it, each term once or not at all.

    Up to `max_gm` times those that may stand more than once.
    """
    choices = [
        [(symbol,) * count for count in (range(max_gm + 1) if TERMS[symbol].repeatable else (1, 0))]
        for symbol in _fitted(method)
        if quantization or symbol != "Q"
    ]
    every = (tuple(symbol for part in parts for symbol in part) for parts in product(*choices))
    return [structure for structure in every if structure not in {(), ("R",)}]


def richest(structure: Structure | None, max_gm: int = 1) -> Structure:
    """Return a structure that holds every candidate; beside a given one, a term of any slow shape."""
    if structure is None:
        counts = {symbol: max(max_gm, 1) if TERMS[symbol].repeatable else 1 for symbol in _fitted("mle")}
        return tuple(symbol for symbol, count in counts.items() for _ in range(count))
    return in_order((*structure, *{*ALWAYS, GaussMarkov.symbol}.difference(structure)))


def _fitted(method: str) -> list[str]:
    return [symbol for symbol, term in TERMS.items() if method in term.fitted_by]


def candidates_of(
    structures: Sequence[Structure],
    names: Sequence[str],
    *,
    poles: int | Sequence[int] = 0,
    zeros: int | Sequence[int] = 0,
    room_shaped: int | None = None,
    room_poles: int | None = None,
    shortest: float = SHORTEST_GIVEN,
) -> Candidates:
    """Return one candidate for each structure, with all of the ordinates' regressors `names`.

    The ramp ``R`` is in those that have it as a term only. The order of the output filter's response, `poles`
    and `zeros`, is one for all or one for each. No more columns than needed are kept, or `room_shaped` for
    terms of other shapes and `room_poles` for the response.
    """
    count = len(structures)
    shaped = [shaped_symbols(structure) for structure in structures]
    kinds = in_order({symbol for own in shaped for symbol in own})
    room = max(map(len, shaped), default=0) if room_shaped is None else room_shaped
    return Candidates(
        laws=np.array([[s in own for s in COLUMN] for own in structures]).reshape(count, SHAPED),
        shaped=np.array(
            [[*map(kinds.index, own), *[-1] * (room - len(own))] for own in shaped], dtype=np.int64
        ).reshape(count, room),
        kinds=tuple(TERMS[symbol] for symbol in kinds),
        poles=np.broadcast_to(np.asarray(poles, dtype=np.int64), count),
        zeros=np.broadcast_to(np.asarray(zeros, dtype=np.int64), count),
        regressors=np.array(
            [[name != "R" or name in structure for name in names] for structure in structures]
        ).reshape(count, len(names)),
        room_poles=int(np.max(poles)) if room_poles is None else room_poles,
        shortest=shortest,
    )


def parameter_columns(structure: Structure, room_shaped: int) -> list[tuple[str, int]]:
    """Return name and column of each of a structure's parameters but R, such as ("GM1.T", 5).

    One Gauss-Markov term is called ``GM``, several ``GM1``, ``GM2`` …
    """
    columns = [(s, COLUMN[s]) for s in structure if s in COLUMN]
    keys = [key for key, s in zip(term_keys(structure), structure, strict=True) if s not in {*COLUMN, "R"}]
    for index, (key, symbol) in enumerate(zip(keys, shaped_symbols(structure), strict=True)):
        places = (SHAPED + index, SHAPED + room_shaped + index)
        columns += zip(TERMS[symbol].parameter_names(key), places, strict=False)
    return columns


@frozen_alone
class Evaluation:
    """The likelihood at one row of parameters for each of the candidates, such as where it is greatest.

    At `theta`, shape (c, p), `objective` is -log L less a constant, shape (c,), infinite where the response
    is not positive; `score` its gradient, shape (c, p); `information` Fisher's, expected, shape (c, p, p).
    `beta` are the regressors' coefficients, shape (c, r), 0 for those a candidate does not have,
    `beta_covariance` their covariance given the `spectrum` S: shapes (c, r, r) and (c, b).
    """

    candidates: Candidates
    theta: FloatArray
    objective: FloatArray
    score: FloatArray
    information: FloatArray
    beta: FloatArray
    beta_covariance: FloatArray
    spectrum: FloatArray

    def __getitem__(self, index: IntArray | list[int]) -> "Evaluation":
        """Return some rows; an index may stand more than once."""
        return Evaluation(**{field.name: getattr(self, field.name)[index] for field in fields(self)})


def evaluate(
    ordinates: Ordinates, candidates: Candidates, theta: FloatArray, *, ramp: FloatArray | None = None
) -> Evaluation:
    """Return objective, score and information of each candidate at `theta`, shape (c, p).

    With `ramp`, shape (c,), the first regressor's coefficient is held at it where not NaN.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        spectrum, slopes = _spectrum(ordinates, candidates, theta)
        beta, covariance, rest = regress(ordinates, candidates.regressors, spectrum, ramp)
        ratio = rest / spectrum
        # einsum, not @: these products are too small for the threads of a linear algebra library.
        objective = 0.5 * (np.einsum("cb,b->c", np.log(spectrum), ordinates.size) + ratio.sum(axis=1))
        residual = 0.5 * (ordinates.size - ratio)
        score = np.einsum("cpb,cb->cp", slopes, residual)
        slopes *= np.sqrt(0.5 * ordinates.size)
        information = np.matmul(slopes, slopes.transpose(0, 2, 1))
    objective[~np.isfinite(objective)] = np.inf
    return Evaluation(
        candidates=candidates,
        theta=theta,
        objective=objective,
        score=score,
        information=information,
        beta=beta,
        beta_covariance=covariance,
        spectrum=spectrum,
    )


def derivatives(ordinates: Ordinates, candidate: Candidates, theta: FloatArray) -> FloatArray:
    """Return the derivative of one candidate's spectrum in each parameter at `theta`, shape (p, b).

    Those in the logs of the variances are what each term adds, the response included.
    """
    spectrum, slopes = _spectrum(ordinates, candidate, theta)
    return np.asarray(slopes[0] * spectrum[0])


def _spectrum(
    ordinates: Ordinates, candidates: Candidates, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return S, shape (c, b), and its logarithmic derivatives, shape (c, p, b)."""
    count, bins = candidates.variances, ordinates.size.size
    slopes = np.zeros((candidates.count, candidates.width, bins))
    variance = np.where(candidates.laws, np.exp(theta[:, :SHAPED]), 0.0)
    np.multiply(variance[:, :, None], ordinates.basis, out=slopes[:, :SHAPED])
    # The terms of one kind of all candidates, as many at a time as stay in the cache.
    step = max(_CACHED // bins, 1)
    for index, kind in enumerate(candidates.kinds):
        rows, terms = np.nonzero(candidates.shaped == index)
        for start in range(0, rows.size, step):
            row, term = rows[start : start + step], terms[start : start + step]
            shape, slope = kind.dct_shapes(
                theta[row, count + term][:, None], ordinates.lam, ordinates.length, ordinates.sign
            )
            level = np.exp(theta[row, SHAPED + term])[:, None]
            slopes[row, SHAPED + term] = level * shape
            slopes[row, count + term] = level * slope
    spectrum = slopes[:, :count].sum(axis=1)
    slopes[:, : candidates.response] /= spectrum[:, None, :]
    if candidates.room_poles:
        _filter(ordinates, candidates, theta, spectrum, slopes)
    return spectrum, slopes


def _filter(
    ordinates: Ordinates, candidates: Candidates, theta: FloatArray, spectrum: FloatArray, slopes: FloatArray
) -> None:
    """Multiply the spectrum by the response and add its slopes, in place."""
    first = candidates.response
    rows = np.flatnonzero((candidates.poles > 0) | (candidates.zeros > 0))
    if not rows.size:
        return
    x = ordinates.lam / ordinates.top
    powers = x ** np.arange(1, candidates.room_poles + 1)[:, None]
    use = np.arange(candidates.room_poles) < candidates.poles[rows, None]
    response = np.where(use, theta[rows, first:], 0.0)
    denominator = 1 + response @ powers
    # It must be positive also between the bins and up to the very end of the band.
    between = _BETWEEN ** np.arange(1, candidates.room_poles + 1)[:, None]
    negative = np.any(denominator <= 0, axis=1) | np.any(1 + response @ between <= 0, axis=1)
    denominator[negative] = np.nan
    numerator = np.maximum(1 - ordinates.lam / 4, 1e-12) ** candidates.zeros[rows, None]
    spectrum[rows] *= numerator / denominator
    slopes[rows, first:] = np.where(use[:, :, None], -powers / denominator[:, None, :], 0.0)


def regress(
    ordinates: Ordinates, has: BoolArray, spectrum: FloatArray, ramp: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return beta (c, r), its covariance (c, r, r) and the squares it leaves in each bin (c, b).

    Given the spectra, shape (c, b), by the regressors that each candidate `has`, shape (c, r).
    """
    if has.size and has.all():
        return _solved(ordinates, has, spectrum, ramp)
    beta = np.zeros(has.shape)
    covariance = np.zeros((*has.shape, has.shape[1]))
    rest = np.broadcast_to(ordinates.power, spectrum.shape)
    rows = np.flatnonzero(has.any(axis=1))
    if not rows.size:
        return beta, covariance, rest
    # Only what some candidate has: where there are many regressors, most steps are with few of them.
    columns = np.flatnonzero(has.any(axis=0))
    seen = replace(
        ordinates, gram=ordinates.gram[np.ix_(columns, columns)], cross=ordinates.cross[columns], names=()
    )
    held = None if ramp is None else np.where(has[rows, 0], ramp[rows], np.nan)
    rest = np.array(rest)
    beta[np.ix_(rows, columns)], covariance[np.ix_(rows, columns, columns)], rest[rows] = _solved(
        seen, has[np.ix_(rows, columns)], spectrum[rows], held
    )
    return beta, covariance, rest


def _solved(
    ordinates: Ordinates, use: BoolArray, spectrum: FloatArray, ramp: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what `regress` does where each regressor is some candidate's; `use`, (c, r), says whose."""
    grams, crosses = ordinates.gram, ordinates.cross
    number = use.shape[1]
    unit = np.eye(number)
    weight = 1 / spectrum
    gram = np.einsum("cb,ijb->cij", weight, grams)
    cross = np.einsum("cb,ib->ci", weight, crosses)
    if ramp is not None:
        held = np.isfinite(ramp)
        value = np.where(held, ramp, 0.0)
        cross -= gram[:, :, 0] * value[:, None]
        use = use.copy()
        use[held, 0] = False
    both_used = use[:, :, None] & use[:, None, :]
    gram = np.where(both_used, gram, 0.0)
    cross = np.where(use, cross, 0.0)
    gram += np.where(use, 0.0, 1.0)[:, :, None] * unit
    gram[~np.isfinite(gram).all(axis=(1, 2))] = unit
    size = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    both = size[:, :, None] * size[:, None, :]
    # The ridge is far below any error; it only keeps regressors that are alike from being singular.
    alike = gram / both + _RIDGE * unit
    inverse = (np.linalg.inv(alike) if number > 1 else 1 / alike) / both
    solution = np.matmul(inverse, cross[:, :, None])[:, :, 0]
    if ramp is not None:
        solution[held, 0] = value[held]
    left = ordinates.power - 2 * np.einsum("ci,ib->cb", solution, crosses)
    for i in range(number):
        left += np.einsum("cj,jb->cb", solution[:, i, None] * solution, grams[i])
    return solution, np.where(both_used, inverse, 0.0), left
