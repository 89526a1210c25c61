"""Accelerometer bias, scale and misalignment from the length of gravity at rest.

The model is f = C (raw - b) with lower triangular C; the residual of a rest is |f| - g. Generalised least
squares gives C, b and their covariance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from scipy.linalg import solve_triangular

from imucal.arrays import BoolArray, FloatArray, ReadOnlyArrays
from imucal.errors import DataError

__all__ = [
    "LOWER", "PARAMETERS", "AccelerometerFit", "Status", "Suggestion", "derivatives",
    "faces_edges_corners", "fit_accelerometer", "observability", "relative_size", "residual_covariance",
    "suggest_rest",
]  # fmt: skip

#: The parameters in the order of every covariance.
PARAMETERS = (
    *("scale_x", "misalignment_yx", "scale_y", "misalignment_zx", "misalignment_zy", "scale_z"),
    *("bias_x", "bias_y", "bias_z"),
)
#: Rows and columns of the lower triangle.
LOWER = np.tril_indices(3)
_DIAGONAL = np.array([True, False, True, False, False, True, True, True, True])
_OFF_DIAGONAL = ~_DIAGONAL

#: Share of the largest singular value below which nothing is known.
_NOTHING = 1e-5
#: Share of the largest singular value below which the interval is wide.
_WEAK = 1e-2
#: Least component of a parameter that is part of a direction.
_PART = 1e-3
#: Most steps of Gauss-Newton.
_STEPS = 30
#: Last step of Gauss-Newton, in standard deviations.
_SMALL_STEP = 1e-7
#: Most halvings of a step of Gauss-Newton.
_HALVINGS = 20
#: Share of the misfit by which rounding changes it: |f| - g loses digits.
_ROUNDING = 1e-9
#: Standard deviation of a misalignment before any rest, in rad: 0.5 to 1° is usual in a consumer IMU.
MISALIGNMENT = 0.015
#: Standard deviation of a scale error before any rest: datasheets of consumer IMUs give 1 to 3 %.
_SCALE = 0.02
#: Standard deviation of a bias before any rest, in m/s²: datasheets of consumer IMUs give 40 to 80 mg.
_BIAS = 0.5
#: A misalignment is not observable if its deviation is more than this share of the one before any rest.
#: With larger shares, one of 14 logs of six faces had larger errors than a fit without misalignment.
_PRIOR_DOMINATES = 0.4
#: Below this share the rests show a parameter, and its prior, which would draw it by 6 %, is dropped.
_PRIOR_MATTERS = 0.25
#: Largest misalignment of a start, in rad; larger ones fit noise.
_LARGEST_START = 0.3
#: Relative deviation of a parameter before any rest, for ranking.
_PRIOR_DEVIATION = 0.1
#: Least component of an axis in a direction's text.
_COMPONENT = 0.3

Model: TypeAlias = Literal["full", "diagonal"]
Status: TypeAlias = Literal["estimated", "weak", "not-observable"]


@dataclass(frozen=True, kw_only=True, eq=False)
class AccelerometerFit(ReadOnlyArrays):
    """A calibrated accelerometer: f = C (raw - b).

    C is lower triangular, in m/s² per raw unit; b is in raw units. `covariance`, shape (9, 9), is zero for
    parameters that are not `free`: misalignments that the rests do not show, which stay 0. Free parameters
    that they show only roughly are `with_prior`; scales and biases only if raw units are m/s², `si`. `f`,
    shape (m, 3), and `residual` |f| - g are in m/s². `jacobian`, shape (m, 9), has the derivatives of the
    residuals.
    """

    C: FloatArray
    b: FloatArray
    covariance: FloatArray
    free: BoolArray
    with_prior: BoolArray
    si: bool
    f: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    residual_covariance: FloatArray
    chi2: float
    dof: int
    statuses: tuple[Status, ...]

    @property
    def model(self) -> Model:
        return "full" if self.free[_OFF_DIAGONAL].any() else "diagonal"

    @property
    def theta(self) -> FloatArray:
        """The values of `PARAMETERS`."""
        return np.concatenate([self.C[LOWER], self.b])

    @property
    def up(self) -> FloatArray:
        """Unit vectors of the specific force."""
        return np.asarray(self.f / np.linalg.norm(self.f, axis=1)[:, None])

    @property
    def prior_deviation(self) -> FloatArray:
        """Deviation of each parameter before any rest, 0 if nothing is known, shape (9,)."""
        return _prior_deviation(self.C, si=self.si)

    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Return the k parameters `with_prior` in prior deviations, and their derivatives, shape (k, 9)."""
        return _prior(self.C, self.b, self.with_prior, si=self.si)


def derivatives(means: FloatArray, C: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return |f| of each rest, shape (m,), its derivatives in `PARAMETERS`, (m, 9), and in raw, (m, 3)."""
    moved = means - b
    f = moved @ C.T
    norm = np.linalg.norm(f, axis=1)
    up = f / norm[:, None]
    weights = up @ C
    return norm, np.column_stack([up[:, LOWER[0]] * moved[:, LOWER[1]], -weights]), weights


def residual_covariance(weights: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return the covariance of residuals whose derivatives in the raw means are `weights`, shape (m, m)."""
    return np.asarray(np.einsum("ia,aij,ja->ij", weights, covariances, weights))


def fit_accelerometer(
    means: FloatArray,
    covariances: FloatArray,
    *,
    gravity: float,
    gravity_sigma: float = 0.0,
    model: Model | None = None,
    free: BoolArray | None = None,
    start: tuple[FloatArray, FloatArray] | None = None,
    si: bool = False,
) -> AccelerometerFit:
    """Fit C and b so that |C (mean - b)| is `gravity`, in m/s², at every rest.

    `means`, shape (m, 3), are raw readings, `covariances`, shape (3, m, m), those of each axis. `si` is
    whether the means are in m/s².

    Misalignments have a prior of 0 ± 0.015 rad. If `si`, scales have one of 1 ± 0.02, and biases one of
    0 ± 0.5 m/s². A prior is dropped if the rests show its parameter. Misalignments that the rests do not
    show stay 0, and count as noise; so do all of them with ``diagonal`` as `model`, and those that are not
    `free`, shape (9,).

    A DataError is raised if the rests do not determine bias and scale of each axis, a ValueError if they do
    not determine a requested full model.
    """
    means = np.asarray(means, dtype=np.float64).reshape(-1, 3)
    noise = np.asarray(covariances, dtype=np.float64)
    extremes = _extremes(means, gravity)
    if model == "diagonal" or len(means) < len(PARAMETERS):
        free = _DIAGONAL
    elif free is None:
        free = np.ones(len(PARAMETERS), dtype=np.bool_)
    begin = start or extremes
    if start is None and free.all():
        begin = _ellipsoid(means, gravity) or extremes
    solve = partial(_gauss_newton, means, noise, (gravity, gravity_sigma), si=si)
    fit = _fit_observable(solve, begin, free, si=si)
    if model == "full" and not fit.free.all():
        raise ValueError("these rests do not determine all nine parameters")
    undetermined = [
        name.replace("_", " ")
        for name, status, bias_or_scale in zip(PARAMETERS, fit.statuses, _DIAGONAL, strict=True)
        if bias_or_scale and status == "not-observable"
    ]
    if undetermined:
        raise _undetermined(means, ", ".join(undetermined))
    return fit


def _fit_observable(
    solve: Callable[..., AccelerometerFit],
    start: tuple[FloatArray, FloatArray],
    free: BoolArray,
    *,
    si: bool,
) -> AccelerometerFit:
    """Fix the misalignments that the rests do not show, and drop the prior of parameters that they show."""
    with_prior = free if si else free & _OFF_DIAGONAL
    while True:
        fit = solve(start, free=free, with_prior=with_prior)
        shares = _shares_of_prior(fit)
        unseen = with_prior & _OFF_DIAGONAL & (shares > _PRIOR_DOMINATES)
        if not unseen.any():
            break
        free, with_prior = free & ~unseen, with_prior & ~unseen
        start = _without(fit.C, unseen), fit.b
    # A prior must not draw or narrow a parameter that the rests show.
    clear = with_prior & (shares < _PRIOR_MATTERS)
    return solve((fit.C, fit.b), free=free, with_prior=with_prior & ~clear) if clear.any() else fit


def _undetermined(means: FloatArray, what: str) -> DataError:
    msg = (
        f"{len(means)} rests do not determine {what} of the accelerometer; put the IMU down on each of its "
        "six faces and on six edges, 5 s each"
    )
    return DataError(msg)


def _ellipsoid(means: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray] | None:
    """Return the algebraic ellipsoid through the means, or None."""
    centre = means.mean(axis=0)
    size = np.abs(means - centre).max()
    if not size > 0:
        return None
    x, y, z = ((means - centre) / size).T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z])
    p = np.linalg.lstsq(design, np.ones(len(means)))[0]
    A = np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])
    if np.linalg.matrix_rank(A) < 3:
        return None
    offset = -np.linalg.solve(A, p[6:])
    A = A / (1 + offset @ A @ offset)
    if np.linalg.eigvalsh(A).min() <= 0:
        return None
    # Reversed axes give A = C'C with C lower triangular.
    C = np.linalg.cholesky(A[::-1, ::-1])[::-1, ::-1].T * (gravity / size)
    if np.abs(np.tril(C / np.diag(C), -1)).max() > _LARGEST_START:
        return None
    return C, centre + size * offset


def _extremes(means: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    low, high = (means.min(axis=0), means.max(axis=0)) if len(means) else (np.zeros(3), np.zeros(3))
    if constant := [axis for axis, same in zip("xyz", high <= low, strict=True) if same]:
        raise _undetermined(means, f"bias and scale of {', '.join(constant)}")
    return np.diag(2 * gravity / (high - low)), (high + low) / 2


def _gauss_newton(
    means: FloatArray,
    noise: FloatArray,
    gravity: tuple[float, float],
    start: tuple[FloatArray, FloatArray],
    *,
    free: BoolArray,
    with_prior: BoolArray,
    si: bool,
) -> AccelerometerFit:
    C, b = (np.array(value, dtype=np.float64) for value in start)
    m = len(means)
    for step_number in range(_STEPS + 1):
        norm, J, weights = derivatives(means, C, b)
        S0 = residual_covariance(weights, noise)
        ignored = J * (_prior_deviation(C, si=si) * ~free)
        S = S0 + gravity[1] ** 2 + ignored @ ignored.T
        residual = norm - gravity[0]
        L = np.linalg.cholesky(S)
        prior, prior_slopes = _prior(C, b, with_prior, si=si)
        rw = solve_triangular(L, residual, lower=True)
        Jw = np.vstack([solve_triangular(L, J[:, free], lower=True), prior_slopes[:, free]])
        both = np.concatenate([rw, prior])
        size = np.linalg.norm(Jw, axis=0)
        size[size == 0] = 1.0
        step = np.linalg.lstsq(Jw / size, -both, rcond=_NOTHING / 10)[0]
        misfit = float(both @ both)
        if np.all(np.abs(step) < _SMALL_STEP * max(1.0, math.sqrt(misfit))) or step_number == _STEPS:
            break
        change = np.zeros(9)
        change[free] = step / size
        # A full step can leave the region where the residuals are linear.
        for _ in range(_HALVINGS):
            following = C.copy()
            following[LOWER] += change[:6]
            moved = (means - b - change[6:]) @ following.T
            after = solve_triangular(L, np.linalg.norm(moved, axis=1) - gravity[0], lower=True)
            positive = np.all(np.diag(following) > 0)
            from_prior = _prior(following, b + change[6:], with_prior, si=si)[0]
            if positive and after @ after + from_prior @ from_prior <= (1 + _ROUNDING) * misfit:
                break
            change /= 2
        else:
            break
        C, b = following, b + change[6:]
    covariance = np.zeros((9, 9))
    covariance[np.ix_(free, free)] = np.linalg.pinv((Jw / size).T @ (Jw / size), rcond=1e-13) / np.outer(
        size, size
    )
    # An unknown gravity must not make the scales look weak, nor a prior a scale or bias look seen.
    _, misalignment_slopes = _prior(C, b, with_prior & _OFF_DIAGONAL, si=si)
    count = len(misalignment_slopes)
    noise_and_prior = np.zeros((m + count, m + count))
    noise_and_prior[:m, :m] = S0
    noise_and_prior[m:, m:] = np.eye(count)
    slopes = np.vstack([J, misalignment_slopes]) * relative_size(C, gravity[0])
    seen = observability(slopes, noise_and_prior, free)
    statuses: tuple[Status, ...] = tuple(
        "weak" if own_prior and status == "estimated" else status
        for status, own_prior in zip(seen, with_prior, strict=True)
    )
    return AccelerometerFit(
        C=C,
        b=b,
        covariance=covariance,
        free=free,
        with_prior=with_prior,
        si=si,
        f=(means - b) @ C.T,
        residual=residual,
        jacobian=J,
        residual_covariance=S,
        chi2=float(rw @ rw),
        dof=max(m - int(free.sum()), 0),
        statuses=statuses,
    )


def _without(C: FloatArray, unseen: BoolArray) -> FloatArray:
    kept = C.copy()
    kept[LOWER] = np.where(unseen[:6], 0.0, kept[LOWER])
    return kept


def _prior_deviation(C: FloatArray, *, si: bool) -> FloatArray:
    """Return the deviation of each parameter before any rest, 0 if nothing is known, shape (9,)."""
    # A misalignment of one radian changes C_kl by about C_ll.
    misalignments = np.diag(C)[LOWER[1]] * _OFF_DIAGONAL[:6] * MISALIGNMENT
    scales = _DIAGONAL[:6] * _SCALE * si
    return np.concatenate([misalignments + scales, np.full(3, _BIAS * si)])


def _prior(C: FloatArray, b: FloatArray, with_prior: BoolArray, *, si: bool) -> tuple[FloatArray, FloatArray]:
    """Return the k parameters `with_prior` minus their prior means, in deviations, and their derivatives.

    The derivatives are in `PARAMETERS`, shape (k, 9).
    """
    own = np.flatnonzero(with_prior)
    deviation = _prior_deviation(C, si=si)[own]
    mean = np.concatenate([np.eye(3)[LOWER], np.zeros(3)])[own]
    slopes = np.zeros((own.size, len(PARAMETERS)))
    slopes[np.arange(own.size), own] = 1 / deviation
    return (np.concatenate([C[LOWER], b])[own] - mean) / deviation, slopes


def _shares_of_prior(fit: AccelerometerFit) -> FloatArray:
    """Return the deviation of each parameter divided by that before any rest; 0 without a prior."""
    prior = fit.prior_deviation
    return np.divide(np.sqrt(np.diag(fit.covariance)), prior, out=np.zeros(9), where=prior > 0)


def relative_size(C: FloatArray, gravity: float) -> FloatArray:
    """Return the sizes of `PARAMETERS` that change f by about gravity."""
    return np.concatenate([np.diag(C)[LOWER[1]], gravity / np.diag(C)])


def observability(J: FloatArray, S: FloatArray, free: BoolArray) -> tuple[Status, ...]:
    """Return which parameters the residuals determine.

    A parameter is ``not-observable`` if it has a part in a direction whose singular value is below 1e-5 of
    the largest, and ``weak`` if directions below 1e-2 cause most of its variance. J, shape (m, p), is in
    parameters of comparable size.
    """
    Jw = solve_triangular(np.linalg.cholesky(S), J[:, free], lower=True)
    _, values, V = np.linalg.svd(Jw, full_matrices=True)
    values = np.concatenate([values, np.zeros(V.shape[0] - values.size)])
    nothing, weak = (values <= share * values[0] for share in (_NOTHING, _WEAK))
    unseen = (np.abs(V[nothing]) > _PART).any(axis=0)
    variances = V[~nothing] ** 2 / values[~nothing, None] ** 2
    mostly_weak = variances[weak[~nothing]].sum(axis=0) > 0.5 * variances.sum(axis=0)
    statuses: list[Status] = ["not-observable"] * free.size
    for at, is_unseen, is_weak in zip(np.flatnonzero(free), unseen, mostly_weak, strict=True):
        statuses[at] = "not-observable" if is_unseen else "weak" if is_weak else "estimated"
    return tuple(statuses)


@dataclass(frozen=True, kw_only=True)
class Suggestion:
    """An attitude that would help most.

    `down` is the unit vector of gravity. `parameter` is the least certain one now; `ratio` is the worst
    relative deviation after one more rest there, divided by the one now.
    """

    down: tuple[float, float, float]
    text: str
    parameter: str
    ratio: float


def suggest_rest(fit: AccelerometerFit, *, gravity: float) -> Suggestion:
    """Return the attitude whose rest reduces the worst relative deviation most."""
    up = _candidates()
    size = relative_size(fit.C, gravity)
    J = (
        np.column_stack(
            [up[:, LOWER[0]] * (gravity * up @ np.linalg.inv(fit.C).T)[:, LOWER[1]], -(up @ fit.C)]
        )
        * size
    )
    Jw = solve_triangular(np.linalg.cholesky(fit.residual_covariance), fit.jacobian * size, lower=True)
    covariance = np.linalg.inv(Jw.T @ Jw + np.eye(9) / _PRIOR_DEVIATION**2)
    variance = float(np.median(np.diag(fit.residual_covariance)))
    gain = J @ covariance
    after = np.diag(covariance) - gain**2 / (variance + np.einsum("ij,ij->i", gain, J))[:, None]
    best = int(np.argmin(after.max(axis=1)))
    worst = int(np.argmax(np.diag(covariance)))
    down = -up[best]
    ratio = math.sqrt(after[best].max() / covariance[worst, worst])
    x, y, z = (float(value) for value in down)
    return Suggestion(down=(x, y, z), text=describe_direction(down), parameter=PARAMETERS[worst], ratio=ratio)


def describe_direction(down: FloatArray) -> str:
    """Return words such as ``down between -x and +z, 40° from -x``."""
    order = [int(i) for i in np.argsort(-np.abs(down)) if abs(down[i]) > _COMPONENT]
    names = [f"{'-' if down[i] < 0 else '+'}{'xyz'[i]}" for i in order]
    if len(names) == 1:
        return f"down along {names[0]}"
    angle = math.degrees(math.acos(min(1.0, float(np.abs(down).max()))))
    return f"down between {', '.join(names[:-1])} and {names[-1]}, {angle:.0f}° from {names[0]}"


def _candidates() -> FloatArray:
    """Return 300 even directions (Fibonacci lattice), then faces, edges and corners."""
    k = np.arange(300) + 0.5
    z, angle = 1 - 2 * k / 300, math.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    even = np.column_stack([np.cos(angle) * ring, np.sin(angle) * ring, z])
    return np.vstack([even, faces_edges_corners()])


def faces_edges_corners() -> FloatArray:
    """Return the unit vectors of faces, then of edges and of corners."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    grid = grid[np.argsort(np.abs(grid).sum(axis=1), kind="stable")][1:]
    return np.asarray(grid / np.linalg.norm(grid, axis=1)[:, None])
