"""The likelihood of many models at once, on binned DCT ordinates.

A debiased Whittle likelihood: the ordinates X_k of the DCT-II are modelled as independent normal with
variance S_k, the exact expectation of X_k² for the sampled, finite series:

    -log L = 1/2 sum_k [log S_k + (X_k - c_k beta)² / S_k]

It is exact for white noise plus random walk plus ramp. beta (ramp, temperature …) is the generalised
least-squares solution.

Source: Sykulski et al. (2019), Biometrika 106, "The debiased Whittle likelihood". The DCT instead of the
Fourier transform removes the leakage.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.models import Models, Structure
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates
from imucal.noise.terms import ALWAYS, TERMS

#: Added to the diagonal of the regressors' correlation.
_RIDGE = 1e-10
#: Elements of an array such that a dozen arrays fit in the cache.
_CACHED = 16384
#: Places in a band, lam / top, where a response must be positive, in addition to the bins.
_BETWEEN = np.linspace(0.4, 1.0, 25)
#: A parameter with less information than this is undetermined.
_NONE = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class Fits:
    """The likelihood of each of c models at one row of parameters, usually its maximum.

    At `theta`, shape (c, p), `objective` is -log L less a constant, infinite if the response is not positive;
    `score` is its gradient, and `information`, shape (c, p, p), the expected one. `beta`, shape (c, r), are
    the regressors' coefficients, and `beta_covariance` their covariance given the `spectrum` S, shape (c, b).
    Properties refer to the first row.
    """

    models: Models
    theta: FloatArray
    objective: FloatArray
    score: FloatArray
    information: FloatArray
    beta: FloatArray
    beta_covariance: FloatArray
    spectrum: FloatArray

    def __getitem__(self, index: IntArray | list[int]) -> "Fits":
        return Fits(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    @property
    def structure(self) -> Structure:
        return self.models[[0]].structures[0]

    @property
    def missing(self) -> list[str]:
        return [symbol for symbol in ALWAYS if symbol not in self.structure]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, shape (p, p), inf for undetermined ones."""
        return covariance(self.information[0], self.models.free[0])

    def columns(self, added: Iterable[str] = ()) -> list[tuple[str, int]]:
        """Return name and column of each parameter except R."""
        return self.models.with_laws(added).columns(self.theta[0])

    def variances(self, added: Iterable[str] = ()) -> dict[str, int]:
        """Return the column of each term's variance by its key."""
        first = self.models.variances
        return {name.partition(".")[0]: at for name, at in self.columns(added) if at < first}

    def unfiltered(self, ordinates: Ordinates) -> FloatArray:
        """Return the spectrum of the noise before the output filter, shape (b,)."""
        none = np.zeros(self.models.count, dtype=np.int64)
        bare = replace(self.models, poles=none)[[0]]
        return np.asarray(spectra(ordinates, bare, self.theta[[0]])[0][0])


def evaluate(
    ordinates: Ordinates, models: Models, theta: FloatArray, *, ramp: FloatArray | None = None
) -> Fits:
    """Return the likelihood of each model at `theta`, shape (c, p).

    Where `ramp`, shape (c,), is not NaN, it is the fixed coefficient of the first regressor.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        spectrum, slopes = spectra(ordinates, models, theta)
        beta, covariance, rest = regress(ordinates, models.regressors, spectrum, ramp)
        ratio = rest / spectrum
        # einsum, not @: these products are too small for the threads of a linear algebra library.
        objective = 0.5 * (np.einsum("cb,b->c", np.log(spectrum), ordinates.size) + ratio.sum(axis=1))
        residual = 0.5 * (ordinates.size - ratio)
        score = np.einsum("cpb,cb->cp", slopes, residual)
        slopes *= np.sqrt(0.5 * ordinates.size)
        information = np.matmul(slopes, slopes.transpose(0, 2, 1))
    objective[~np.isfinite(objective)] = np.inf
    return Fits(
        models=models,
        theta=theta,
        objective=objective,
        score=score,
        information=information,
        beta=beta,
        beta_covariance=covariance,
        spectrum=spectrum,
    )


def covariance(information: FloatArray, free: BoolArray) -> FloatArray:
    """Return the covariance of the `free` parameters, shape (p,), as a matrix of shape (p, p).

    Undetermined parameters have variance inf and are fixed for the others.
    """
    size = free.size
    result = np.zeros((size, size))
    diagonal = np.diag(information)
    used = np.flatnonzero(free & (diagonal > _NONE))
    result[np.arange(size), np.arange(size)] = np.inf
    if used.size:
        root = np.sqrt(diagonal[used])
        correlation = information[np.ix_(used, used)] / np.outer(root, root)
        values, vectors = np.linalg.eigh(correlation)
        inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
        result[np.ix_(used, used)] = inverse / np.outer(root, root)
    return result


def derivatives(ordinates: Ordinates, model: Models, theta: FloatArray) -> FloatArray:
    """Return the derivatives of one model's spectrum at `theta`, shape (p, b)."""
    spectrum, slopes = spectra(ordinates, model, theta)
    return np.asarray(slopes[0] * spectrum[0])


def spectra(ordinates: Ordinates, models: Models, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return S, shape (c, b), and its logarithmic derivatives, shape (c, p, b)."""
    count, bins = models.variances, ordinates.size.size
    slopes = np.zeros((models.count, models.width, bins))
    variance = np.where(models.has[:, :SHAPED], np.exp(theta[:, :SHAPED]), 0.0)
    np.multiply(variance[:, :, None], ordinates.basis, out=slopes[:, :SHAPED])
    # All terms of one kind together, in groups that fit in the cache.
    step = max(_CACHED // bins, 1)
    for symbol in models.kinds:
        same = np.array([slot == symbol for slot in models.slots[SHAPED:]])
        rows, terms = np.nonzero(models.has[:, SHAPED:] & same)
        for start in range(0, rows.size, step):
            row, term = rows[start : start + step], terms[start : start + step]
            shape, slope = TERMS[symbol].dct_shapes(
                theta[row, count + term][:, None], ordinates.lam, ordinates.length, ordinates.sign
            )
            level = np.exp(theta[row, SHAPED + term])[:, None]
            slopes[row, SHAPED + term] = level * shape
            slopes[row, count + term] = level * slope
    spectrum = slopes[:, :count].sum(axis=1)
    slopes[:, : models.response] /= spectrum[:, None, :]
    if models.room_poles:
        _filter(ordinates, models, theta, spectrum, slopes)
    return spectrum, slopes


def _filter(
    ordinates: Ordinates, models: Models, theta: FloatArray, spectrum: FloatArray, slopes: FloatArray
) -> None:
    """Multiply the spectrum by the response and add its slopes, in place."""
    first = models.response
    rows = np.flatnonzero(models.poles > 0)
    if not rows.size:
        return
    x = ordinates.lam / ordinates.top
    powers = x ** np.arange(1, models.room_poles + 1)[:, None]
    use = np.arange(models.room_poles) < models.poles[rows, None]
    response = np.where(use, theta[rows, first:], 0.0)
    denominator = 1 + response @ powers
    # It must also be positive between the bins.
    between = _BETWEEN ** np.arange(1, models.room_poles + 1)[:, None]
    negative = np.any(denominator <= 0, axis=1) | np.any(1 + response @ between <= 0, axis=1)
    denominator[negative] = np.nan
    spectrum[rows] /= denominator
    slopes[rows, first:] = np.where(use[:, :, None], -powers / denominator[:, None, :], 0.0)


def regress(
    ordinates: Ordinates, has: BoolArray, spectrum: FloatArray, ramp: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return beta (c, r), its covariance (c, r, r) and each bin's sum of squares without it (c, b).

    `has`, shape (c, r), is the mask of each model's regressors.
    """
    if has.size and has.all():
        return _solved(ordinates, has, spectrum, ramp)
    beta = np.zeros(has.shape)
    covariance = np.zeros((*has.shape, has.shape[1]))
    rest = np.broadcast_to(ordinates.power, spectrum.shape)
    rows = np.flatnonzero(has.any(axis=1))
    if not rows.size:
        return beta, covariance, rest
    # Skip regressors that no model has.
    columns = np.flatnonzero(has.any(axis=0))
    seen = replace(
        ordinates,
        gram=ordinates.gram[np.ix_(columns, columns)],
        cross=ordinates.cross[columns],
        regressors=(),
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
    # The ridge is far below any error; it keeps collinear regressors from being singular.
    correlation = gram / both + _RIDGE * unit
    inverse = (np.linalg.inv(correlation) if number > 1 else 1 / correlation) / both
    solution = np.matmul(inverse, cross[:, :, None])[:, :, 0]
    if ramp is not None:
        solution[held, 0] = value[held]
    left = ordinates.power - 2 * np.einsum("ci,ib->cb", solution, crosses)
    for i in range(number):
        left += np.einsum("cj,jb->cb", solution[:, i, None] * solution, grams[i])
    return solution, np.where(both_used, inverse, 0.0), left
