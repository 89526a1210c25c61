"""Tests whether several records share one coefficient; the reference is a general minimiser."""

import numpy as np
import pytest
from scipy import optimize

from imucal.arrays import FloatArray
from imucal.fitting.spectral.given_model import BinFit, fit_bins, record_tests
from imucal.fitting.spectral.likelihood import evaluate
from imucal.fitting.spectral.maximum import bounds
from imucal.fitting.spectral.ordinates import SHAPED
from tests.fleet.records import bins_from, simulated


def _least(fit: BinFit, shared: int | None) -> float:
    """Return the least -log L of all records, with one common variance in the column `shared`."""
    columns = [c for _, c in fit.whole.columns() if c < SHAPED]
    low = [bounds(one, fit.whole.models)[0][columns] for one in fit.records]
    begin = fit.whole.theta[0]
    own = [column for column in columns if column != shared]

    def objective(values: FloatArray) -> tuple[float, FloatArray]:
        total, slope = 0.0, np.zeros_like(values)
        for i, one in enumerate(fit.records):
            place = 1 + i * len(own) + np.arange(len(own))
            theta = begin.copy()
            theta[own] = values[place]
            if shared is not None:
                theta[shared] = values[0]
            found = evaluate(one, fit.whole.models, theta[None])
            total += float(found.objective[0])
            slope[place] += found.score[0, own]
            slope[0] += 0.0 if shared is None else found.score[0, shared]
        return total, slope

    limits = [(min(r[columns.index(shared)] for r in low) if shared is not None else 0.0, 50.0)]
    limits += [(r[columns.index(column)], 50.0) for r in low for column in own]
    # Starts are the joint fit, nearly invisible variances and visible ones.
    joint = np.array([begin[shared or 0], *np.tile(begin[own], len(fit.records))])
    starts = [joint, *(np.maximum(joint, np.array(limits)[:, 0] + more) for more in (8.0, 16.0))]
    ends = [
        optimize.minimize(
            objective, start, jac=True, bounds=limits, method="L-BFGS-B",
            options={"maxiter": 5000, "ftol": 1e-13, "gtol": 1e-7},
        )
        for start in starts
    ]  # fmt: skip
    return min(float(end.fun) for end in ends)


@pytest.mark.parametrize("case", range(3))
def test_the_statistic_agrees_with_a_general_minimiser(case: int) -> None:
    """The records share a coefficient or not, and the terms are strong, weak or absent."""
    scales = [(1.0, 1.0, 1.0), (1.0, 1.3, 1.0), (1.0, 0.7, 1.5)][case]
    walk = (2e-5, 2e-4, 1e-6)[case]
    every = [
        bins_from(simulated(f"N={1e-3 * scale} + B=2e-4 + K={walk}", 3000, 90_417, case, i))
        for i, scale in enumerate(scales)
    ]
    fit = fit_bins(every, ("N", "B", "K"), level=0.95)
    tests = {test.key: test for test in record_tests(fit)}
    free = _least(fit, None)
    for name, column in fit.whole.columns():
        drop = 2 * (_least(fit, column) - free) / fit.problem.widening.get(name, 1.0) ** 2
        assert tests[name].statistic == pytest.approx(max(drop, 0.0), rel=1e-5, abs=1e-4)
