"""Normalised innovations of a filter (NIS) in a CSV file -> verdicts on their mean.

The normalised innovation squared is ``v' S^-1 v`` of an innovation v and its covariance S in the filter. If S
is right, the mean is the number of components of v, and the innovations are white.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4.2.
"""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray
from imucal.checking.residuals import WITHIN, result_of, verdict_of
from imucal.checking.verdict import CheckResult, Row, Verdict
from imucal.errors import Fix, LimitsError
from imucal.report.numbers import Quantity

__all__ = ["are_innovations", "check_innovations"]

#: Names of a column with the normalised innovation squared, without the name of the sensor.
_NAMES = ("normalized_innovation_squared", "normalised_innovation_squared", "nis")
#: Names of the column with the number of components.
_SIZES = ("dof", "dim", "nis_dof")
#: Longest header.
_HEAD = 4096
#: Smallest number of innovations for a verdict.
_LEAST = 30
#: Confidence level of the intervals.
_LEVEL = 0.95
#: Correlation of successive values above which the innovations are not white.
_WHITE = 0.3


def are_innovations(path: Path) -> bool:
    """Return whether a file is a CSV file with a column of normalised innovations."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD).partition(b"\n")[0].decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return any(map(_is_nis, next(csv.reader([head]), [])))


def _is_nis(column: str) -> bool:
    """Return whether a column contains normalised innovations: ``nis``, ``gps_nis`` or ``nis_gps``."""
    name = column.strip().lower().replace(" ", "_")
    if name in _SIZES:
        return False
    return any(name == each or name.endswith(f"_{each}") or name.startswith(f"{each}_") for each in _NAMES)


def check_innovations(path: Path, dof: int | None = None) -> CheckResult:
    """Judge the mean of each column of normalised innovations; empty cells and NaN are left out.

    `dof` is the number of components of an innovation, unless the file has a column ``dof``. Raises
    LimitsError if the number is unknown, a cell is not a number, or there are too few innovations.
    """
    header, cells = _read(path)
    sizes = next((header.index(name) for name in header if name.strip().lower() in _SIZES), None)
    if sizes is None and dof is None:
        problem = "found normalised innovations but no column 'dof', the number of their components"
        raise LimitsError(problem, place=path, fix=Fix("give --dof, such as --dof 3 for a position"))
    rows = []
    for column, name in enumerate(header):
        if _is_nis(name):
            nis = cells[:, column]
            components = np.full_like(nis, dof) if dof is not None or sizes is None else cells[:, sizes]
            there = np.isfinite(nis) & (components > 0)
            rows.append(_row(path, name.strip(), nis[there], components[there]))
    return result_of(path, rows, "innovations", _LEVEL)


def _read(path: Path) -> tuple[list[str], FloatArray]:
    """Return the header and the cells as numbers, of shape (rows, columns)."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            header = next(lines)
            rows = [_numbers(path, number, line, len(header)) for number, line in enumerate(lines, 2) if line]
    except (OSError, UnicodeDecodeError, csv.Error, StopIteration) as error:
        raise LimitsError(f"can't be read ({error}); expected a CSV file", place=path) from error
    return header, np.array(rows, dtype=float).reshape(len(rows), len(header))


def _numbers(path: Path, number: int, line: Sequence[str], columns: int) -> list[float]:
    if len(line) != columns:
        problem = f"line {number} has {len(line)} cells, and the header has {columns}"
        raise LimitsError(problem, place=path)
    return [_number(cell) for cell in line]


def _number(cell: str) -> float:
    """Return a number; NaN for a text, which another column may contain."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _row(path: Path, name: str, nis: FloatArray, components: FloatArray) -> Row:
    where = name.lower()
    if len(nis) < _LEAST:
        problem = f"column {name} has {len(nis)} numbers; expected at least {_LEAST} innovations"
        raise LimitsError(problem, place=path)
    if np.any(nis < 0):
        raise LimitsError(f"column {name} has negative numbers; expected squares", place=path)
    ratio, low, high = mean_with_limits(nis, components)
    verdict, words = _verdict(math.sqrt(ratio), math.sqrt(low), math.sqrt(high))
    if (correlation := _correlation(nis / components)) > _WHITE + 2 / math.sqrt(len(nis)):
        verdict = "fail" if verdict == "fail" else "undecided"
        words += (
            f"; successive values have a correlation of {correlation:.2f}: the innovations are not white, so "
            "a model of the filter is wrong, not only its noise"
        )
    found = f"mean NIS / dof is {ratio:.3g} ({low:.3g} to {high:.3g}), expected 1; {words}"
    return Row(
        where, "NIS / dof", verdict, found, measured=Quantity(value=ratio, low=low, high=high), in_words=True
    )


def _verdict(factor: float, low: float, high: float) -> tuple[Verdict, str]:
    """Return the verdict on a factor of the standard deviation with its limits."""
    verdict, words = verdict_of(factor)
    if low <= 1 <= high:
        return "pass" if verdict == "pass" else "undecided", "as expected within the limits"
    beyond = (WITHIN, 1 / WITHIN)
    if any(low <= limit <= high for limit in beyond):
        return "undecided", f"{words}; the limits contain the factor {WITHIN:g}, so log for longer to decide"
    return verdict, words.replace("the noise", "the standard deviation of the innovations in the filter")


def mean_with_limits(nis: FloatArray, components: FloatArray) -> tuple[float, float, float]:
    """Return the sum of the NIS over the sum of their components, with chi-square limits of its truth.

    Correlated innovations count as fewer.
    """
    from scipy.stats import chi2

    ratio = float(nis.sum() / components.sum())
    freedom = float(components.sum()) / _correlated_for(nis / components)
    tail = (1 - _LEVEL) / 2
    low = ratio * freedom / float(chi2.ppf(1 - tail, freedom))
    high = ratio * freedom / float(chi2.ppf(tail, freedom))
    return ratio, low, high


def _correlated_for(values: FloatArray) -> float:
    """Return the number of values that count as one: 1 plus twice the sum of the autocorrelation.

    Source: Geyer, Practical Markov Chain Monte Carlo, Statistical Science 7 (1992): the sum ends where a pair
    of successive lags is not positive.
    """
    spectrum = np.fft.rfft(values - values.mean(), 2 * len(values))
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: len(values)]
    if covariance[0] <= 0:
        return float(len(values))
    lags = covariance / covariance[0]
    pairs = lags[: len(lags) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs <= 0)) if np.any(pairs <= 0) else len(pairs)
    return max(1.0, float(2 * pairs[:end].sum() - 1))


def _correlation(values: FloatArray) -> float:
    """Return the correlation of successive values; 1 if all are equal."""
    centred = values - values.mean()
    power = float(centred @ centred)
    return float(centred[1:] @ centred[:-1]) / power if power > 0 else 1.0
