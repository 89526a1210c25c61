"""Gyroscope scale and misalignment from the direction of gravity before and after each turn.

The gyroscope, with C_g, carries the direction of gravity from one rest to the next; the accelerometer shows
where it ends. Two components of the difference are the residuals. Their covariance includes the gyroscope's
noise, the two bias estimates, and the error of both directions.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh, solve_triangular
from scipy.special import chdtrc, stdtrit

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.accelerometer import AccelerometerFit, Status, observability
from imucal.calibration.frames import LOWER_SLOPES, Frame
from imucal.calibration.gyro_prior import GyroPrior
from imucal.calibration.mean_covariance import mean_covariance
from imucal.calibration.turn_data import Headings, TurnData, rotations, start_of
from imucal.noise import NoiseModel

__all__ = ["GyroNoise", "TurnsFit", "direction_covariance", "fit_turns"]

#: Most steps of Gauss-Newton.
_STEPS = 15
#: Steps of Gauss-Newton that compute the covariance.
_UPDATES = (0, 2)
#: Last step of Gauss-Newton, in standard deviations.
_SMALL_STEP = 1e-4
#: Blocks of a turn with constant weights on the noise.
_BLOCKS = 8
#: P-value of a wrong turn, given the others.
_WRONG = 1e-4
#: Largest share of excluded turns.
_MAX_WRONG_SHARE = 0.2
#: Least share of a turn's information that the other turns leave for a test of it.
_TOLD = 1e-3
#: P-value of chi² below which the intervals are widened.
_MISFIT = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class GyroNoise(ReadOnlyArrays):
    """Noise of the three axes: models, and further deviation `tau` of each rest's mean, shape (3,).

    `samples` is the length of the log. `horizontal` is the deviation of each component of the earth's
    horizontal rate, in rad/s.
    """

    models: tuple[NoiseModel, ...]
    tau: FloatArray
    rest_spans: IntArray
    samples: int
    headings: Headings | None = None
    horizontal: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TurnsFit(ReadOnlyArrays):
    """Scale and misalignment of a gyroscope: w = C (raw - b - G f).

    `covariance` of C by rows, shape (9, 9), includes `widening`. `by_directions`, shape (9, 3m), are the
    derivatives of C in the unit vectors at the rests. `quantile` is the half-width of a 95 % interval in
    deviations. `residual` and `before`, shape (t, 3), are angles in rad with C and with the start: two
    between the carried and the measured direction of gravity, and the error of a known angle, NaN for other
    turns. `chi2` and `dof` are of the `used` turns.
    """

    C: FloatArray
    covariance: FloatArray
    by_directions: FloatArray
    quantile: float
    residual: FloatArray
    before: FloatArray
    p: FloatArray
    used: BoolArray
    chi2: float
    dof: int
    p_fit: float
    widening: float
    statuses: tuple[Status, ...]

    def turned(self, frame: Frame, more: FloatArray) -> "TurnsFit":
        """Return the fit in a frame; `more` is the covariance that its rotation adds to the directions."""
        own = self.covariance + self.by_directions @ more @ self.by_directions.T
        by_rows = np.kron(frame.R, np.eye(3))
        return replace(self, C=frame.R @ self.C, covariance=by_rows @ own @ by_rows.T)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Carried(ReadOnlyArrays):
    """Directions carried along the turns: gravity, and a horizontal one along turns by a known angle.

    Gravity has two residuals for each of t turns; each of the known turns has one more, after them. The r
    residuals belong to the turns `turn`, shape (r,). `J`, shape (r, 9), are their derivatives in C.
    `tangents`, shape (r, 3), are the directions in which the ends are compared, and `lever` their products
    with the carried directions. `whole`, shape (t, 3, 3), and `to_end`, shape (t, n, 3, 3), are the
    rotations over a turn, and from each sample to its end.
    """

    residual: FloatArray
    turn: IntArray
    J: FloatArray
    whole: FloatArray
    to_end: FloatArray
    tangents: FloatArray
    lever: FloatArray

    @property
    def by_turn(self) -> FloatArray:
        """Residuals by turn, shape (t, 3), NaN if a turn has only two."""
        t = len(self.whole)
        table = np.full((t, 3), np.nan)
        table[:, :2] = self.residual[: 2 * t].reshape(t, 2)
        table[self.turn[2 * t :], 2] = self.residual[2 * t :]
        return table


def fit_turns(
    data: TurnData, noise: GyroNoise, directions: FloatArray, start: FloatArray | None = None
) -> TurnsFit:
    """Fit C to the turns, and exclude wrong turns one after the other; begin with `start`, if it is given.

    A DataError is raised if no scale or orientation of the gyroscope explains the turns.
    """
    start = start_of(data) if start is None else start
    prior = GyroPrior.of(start)
    while True:
        fit = _without_wrong_turns(data, noise, directions, start, prior)
        following = prior.after(fit.C, fit.covariance)
        if following is prior:
            break
        prior = following
    C, carried, S, covariance, p, used = fit
    part = data.keeping(used)
    rw = solve_triangular(np.linalg.cholesky(S), carried.residual, lower=True)
    by_directions = -covariance @ np.linalg.solve(S, carried.J).T @ _by_directions(part, carried)
    everything = _carry(data, C)
    statuses = _statuses(carried.J * np.repeat(np.diag(C), 3), S, prior)
    chi2, dof = float(rw @ rw), len(rw) - int((prior.free & ~prior.with_prior).sum())
    p_fit = float(chdtrc(dof, chi2)) if dof > 0 else math.nan
    misfit = p_fit < _MISFIT
    widening = math.sqrt(chi2 / dof) if misfit else 1.0
    return TurnsFit(
        C=C,
        covariance=covariance * widening**2,
        by_directions=by_directions,
        quantile=float(stdtrit(dof, 0.975)) if misfit else 1.959963985,
        residual=everything.by_turn,
        before=_carry(data, start).by_turn,
        p=p,
        used=used,
        chi2=chi2,
        dof=dof,
        p_fit=p_fit,
        widening=widening,
        statuses=statuses,
    )


class _Fit(NamedTuple):
    """C, its derivatives and covariances, and which turns were used."""

    C: FloatArray
    carried: _Carried
    S: FloatArray
    covariance: FloatArray
    p: FloatArray
    used: BoolArray


def _without_wrong_turns(
    data: TurnData, noise: GyroNoise, directions: FloatArray, start: FloatArray, prior: GyroPrior
) -> _Fit:
    used = np.ones(len(data.rests), dtype=np.bool_)
    p = np.ones(used.size)
    C = start
    while True:
        part = data.keeping(used)
        C, carried, S = _gauss_newton(part, noise, directions, C, prior)
        Jw, _, size = _whitened(C, carried, S, prior)
        inner = (Jw / size).T @ (Jw / size)
        of_basis = np.linalg.pinv(inner, rcond=1e-10) / np.outer(size, size)
        covariance = np.asarray(prior.basis @ of_basis @ prior.basis.T)
        p[used], chi2 = _tested(carried, S, covariance)
        # Several p-values may be 0.
        worst = int(np.flatnonzero(used)[np.lexsort((-chi2, p[used]))[0]])
        if p[worst] >= _WRONG or np.sum(~used) + 1 > _MAX_WRONG_SHARE * used.size:
            return _Fit(C, carried, S, covariance, p, used)
        used[worst] = False


def _statuses(J: FloatArray, S: FloatArray, prior: GyroPrior) -> tuple[Status, ...]:
    if not prior.free.any():
        unseen: Status = "not-observable"
        return (unseen,) * prior.free.size
    seen: list[Status] = list(observability(J, S, prior.free))
    for entry in np.flatnonzero(prior.free & prior.with_prior):
        seen[entry] = "weak"
    return tuple(seen)


def direction_covariance(
    fit: AccelerometerFit, means: FloatArray, covariances: FloatArray, slopes: FloatArray = LOWER_SLOPES
) -> FloatArray:
    """Return the covariance of the unit vectors of the specific force, by rest, shape (3m, 3m).

    The noise of the raw `means` moves a direction itself, and through C and b; so do misalignments, by
    their prior. `covariances`, shape (3, m, m), are of the means. `slopes`, shape (3, 3, 6), are
    derivatives of C in its lower triangle.
    """
    m = len(means)
    up = fit.up
    across = (np.eye(3) - up[:, :, None] * up[:, None, :]) / np.linalg.norm(fit.f, axis=1)[:, None, None]
    by_parameter = np.empty((m, 3, 9))
    by_parameter[:, :, :6] = np.einsum("ijk,mj->mik", slopes, means - fit.b)
    by_parameter[:, :, 6:] = -fit.C
    by_parameter = (across @ by_parameter).reshape(3 * m, 9)
    gain = -fit.covariance @ np.linalg.solve(fit.residual_covariance, fit.jacobian).T
    weights = up @ fit.C
    by_ignored = (by_parameter + by_parameter @ gain @ fit.jacobian) * fit.prior_deviation
    total: FloatArray = by_ignored @ by_ignored.T
    for axis in range(3):
        own = np.zeros((m, 3, m))
        own[np.arange(m), :, np.arange(m)] = across @ fit.C[:, axis]
        by_noise = own.reshape(3 * m, m) + by_parameter @ (gain * weights[:, axis])
        total += by_noise @ covariances[axis] @ by_noise.T
    return total


def _carry(data: TurnData, C: FloatArray) -> _Carried:
    t, n, _ = data.rates.shape
    steps = rotations(-_rotation_vectors(data.tau0 * data.rates @ C.T))
    to_end = np.empty((n, t, 3, 3))
    whole = np.broadcast_to(np.eye(3), (t, 3, 3))
    for k in range(n - 1, -1, -1):
        to_end[k] = whole
        whole = whole @ steps[:, k]
    to_end = to_end.transpose(1, 0, 2, 3)
    target = data.after
    carried = np.einsum("tij,tj->ti", whole, data.before)
    one = _at_right_angles(target)
    other = np.cross(target, one)
    turn = np.repeat(np.arange(t), 2)
    tangents = np.stack([one, other], axis=1).reshape(2 * t, 3)
    error = (carried - target)[turn]
    lever = np.cross(tangents, carried[turn])
    known = np.flatnonzero(np.isfinite(data.known))
    if known.size:
        ahead, ahead_after = _horizontal(data.before[known], data.after[known], data.known[known])
        ahead_carried = np.einsum("tij,tj->ti", whole[known], ahead)
        across = np.cross(target[known], ahead_after)
        turn = np.concatenate([turn, known])
        tangents = np.vstack([tangents, across])
        error = np.vstack([error, ahead_carried - ahead_after])
        lever = np.vstack([lever, np.cross(across, ahead_carried)])
    # d r = (tangent x carried) . sum over samples of R(to the end) dC x dt
    products = to_end.reshape(t, n, 9).transpose(0, 2, 1) @ (data.rates * data.tau0)
    J = np.einsum("rj,rjil->ril", lever, products.reshape(t, 3, 3, 3)[turn]).reshape(len(turn), 9)
    residual = np.einsum("ri,ri->r", tangents, error)
    return _Carried(
        residual=residual, turn=turn, J=J, whole=whole, to_end=to_end, tangents=tangents, lever=lever
    )


def _at_right_angles(directions: FloatArray) -> FloatArray:
    """Return a unit vector at right angles to each unit vector, shape (t, 3)."""
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    found = np.cross(directions, helper)
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def _horizontal(before: FloatArray, after: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a horizontal direction before each turn and where a known angle takes it, shape (t, 3) each.

    The angles are about the vertical, in rad. A change of the vertical itself is the shortest rotation.
    """
    ahead = _at_right_angles(before)
    axis = np.cross(before, after)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("ti,ti->t", before, after))
    shortest = rotations(axis * (angle / np.maximum(sine, 1e-300))[:, None])
    # In axes of the body, directions of the earth turn the other way.
    about_vertical = rotations(-known[:, None] * after)
    return ahead, np.einsum("tij,tjk,tk->ti", about_vertical, shortest, ahead)


def _rotation_vectors(angles: FloatArray) -> FloatArray:
    """Return the rotation of each sample, shape (t, n, 3), of order 4 in the period.

    `angles` is rate times period. The rate and its axis change within a sample; beyond a turn it is zero.
    Source: Magnus (1954), Communications on Pure and Applied Mathematics 7, 649, the first two terms.
    """
    before, after = np.zeros_like(angles), np.zeros_like(angles)
    before[:, 1:], after[:, :-1] = angles[:, :-1], angles[:, 1:]
    curved = after - 2 * angles + before
    return np.asarray(angles + (curved + np.cross(angles, after - before)) / 24)


def _gauss_newton(
    data: TurnData, noise: GyroNoise, directions: FloatArray, C: FloatArray, prior: GyroPrior
) -> tuple[FloatArray, _Carried, FloatArray]:
    carried = _carry(data, C)
    S = np.zeros(0)
    for number in range(_STEPS):
        if number in _UPDATES:
            fixed = carried.J * prior.fixed_deviation(C)
            S = _covariance(data, carried, noise, directions, C) + fixed @ fixed.T
        Jw, rw, size = _whitened(C, carried, S, prior)
        step = prior.basis @ (np.linalg.lstsq(Jw / size, -rw, rcond=1e-5)[0] / size)
        C = C + step.reshape(3, 3)
        carried = _carry(data, C)
        moved = solve_triangular(np.linalg.cholesky(S), carried.J @ step, lower=True)
        if number >= max(_UPDATES) and np.all(np.abs(moved) < _SMALL_STEP):
            break
    return C, carried, S


def _whitened(
    C: FloatArray, carried: _Carried, S: FloatArray, prior: GyroPrior
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return derivatives in the fitted parameters, residuals with those of the prior, and column sizes."""
    L = np.linalg.cholesky(S)
    differences, slopes = prior.rows(C)
    Jw = np.vstack([solve_triangular(L, carried.J, lower=True), slopes]) @ prior.basis
    rw = np.concatenate([solve_triangular(L, carried.residual.ravel(), lower=True), differences])
    size = np.linalg.norm(Jw, axis=0)
    return Jw, rw, np.where(size > 0, size, 1.0)


def _covariance(
    data: TurnData, carried: _Carried, noise: GyroNoise, directions: FloatArray, C: FloatArray
) -> FloatArray:
    t, m, r = len(data.rests), len(data.up), len(carried.turn)
    # A turn with few samples has empty blocks.
    edges = (np.diff(data.spans) * np.linspace(0, 1, _BLOCKS + 1)).astype(np.int64)
    filled = np.diff(edges) > 0
    blocks = data.spans[:, :1, None] + np.stack([edges[:, :-1], edges[:, 1:]], axis=2)
    spans = blocks[filled]
    to_end = carried.to_end * data.tau0
    own = _sums(to_end, edges)[carried.turn]
    later = _sums(data.share[..., None, None] * to_end, edges)[carried.turn]
    lever = carried.lever[:, None, None]
    by_own, by_later = ((lever @ sums)[:, :, 0] @ C for sums in (own, later))
    A = np.zeros((r, len(spans) + m, 3))
    residual, which = np.nonzero(filled[carried.turn])
    column = np.cumsum(filled).reshape(filled.shape) - 1
    A[residual, column[carried.turn[residual], which]] = by_own[residual, which]
    rest = len(spans) + data.rests[carried.turn]
    A[np.arange(r), rest] = (by_later - by_own).sum(axis=1)
    A[np.arange(r), rest + 1] = -by_later.sum(axis=1)
    where = np.vstack([spans, noise.rest_spans])
    S = np.zeros((r, r))
    S[np.arange(2 * t, r), np.arange(2 * t, r)] = data.known_deviation**2
    extra = np.concatenate([np.zeros(len(spans)), np.ones(m)])
    known: dict[NoiseModel, FloatArray] = {}
    for axis, model in enumerate(noise.models):
        if model not in known:
            known[model] = mean_covariance(model, where, rate_hz=1 / data.tau0, samples=noise.samples)
        weights = A[:, :, axis]
        S += weights @ known[model] @ weights.T + noise.tau[axis] ** 2 * (weights * extra) @ weights.T
    if noise.headings is not None:
        S += noise.horizontal**2 * _by_earth(data, carried, noise.headings)
    D = _by_directions(data, carried)
    return S + D @ directions @ D.T


def _sums(values: FloatArray, edges: IntArray) -> FloatArray:
    """Return the sums between edges, shape (t, k + 1), of values, (t, n, 3, 3), as shape (t, k, 3, 3)."""
    total = np.cumsum(values, axis=1)
    before = np.concatenate([np.zeros_like(total[:, :1]), total], axis=1)
    return np.diff(np.take_along_axis(before, edges[..., None, None], axis=1), axis=1)


def _by_earth(data: TurnData, carried: _Carried, headings: Headings) -> FloatArray:
    """Return the covariance of the residuals, shape (r, r), by a horizontal rate with components of 1.

    The bias between two rests contains the rate at both: only its change within the turn has an effect.
    """
    E = np.empty((2, len(carried.turn)))
    for which, ahead in enumerate((headings.ahead, headings.aside)):
        first, last = ahead[data.rests], ahead[data.rests + 1]
        end = np.einsum("tij,tj->ti", carried.whole, first)
        bias = first[:, None] + data.share[..., None] * (last - first)[:, None]
        # Nothing is integrated beyond a turn's end.
        live = np.arange(data.share.shape[1]) < np.diff(data.spans)
        seen = end[:, None] - np.einsum("tnij,tnj->tni", carried.to_end, bias)
        turned = np.einsum("tni,tn->ti", seen, live * data.tau0)
        E[which] = np.einsum("ri,ri->r", carried.lever, turned[carried.turn])
    chain = headings.chain[data.rests][carried.turn]
    return np.asarray(E.T @ E * (chain[:, None] == chain))


def _by_directions(data: TurnData, carried: _Carried) -> FloatArray:
    """Return the derivatives of the residuals in the unit vectors at the rests, shape (r, 3m).

    Those of known angles are of second order, because the vertical hardly changes.
    """
    D = np.zeros((len(carried.turn), 3 * len(data.up)))
    for k, rest in enumerate(data.rests):
        here = slice(2 * k, 2 * k + 2)
        D[here, 3 * rest : 3 * rest + 3] = carried.tangents[here] @ carried.whole[k]
        D[here, 3 * rest + 3 : 3 * rest + 6] = -carried.tangents[here]
    return D


def _tested(carried: _Carried, S: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the p-value and chi² of the residuals of each turn, given the other turns, shape (t,) each."""
    inverse = np.linalg.inv(S)
    SJ = inverse @ carried.J
    P = inverse - SJ @ covariance @ SJ.T
    weighted = P @ carried.residual
    p, chi2 = np.ones(len(carried.whole)), np.zeros(len(carried.whole))
    for turn in range(p.size):
        rows = np.flatnonzero(carried.turn == turn)
        shares, directions = eigh(P[np.ix_(rows, rows)], inverse[np.ix_(rows, rows)])
        # The other turns say nothing about a direction that this turn alone determines.
        told = shares > _TOLD
        if told.any():
            chi2[turn] = np.sum((directions.T @ weighted[rows])[told] ** 2 / shares[told])
            p[turn] = chdtrc(int(told.sum()), chi2[turn])
    return p, chi2
