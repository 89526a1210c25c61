"""Normalised residuals of an estimator against their expectation: how far its noise is from what it saw.

A residual is the square root of ``e' R^-1 e``. If R is the covariance of the error e, its square is
chi-square distributed with as many degrees of freedom as e has components.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imucal._version import __version__
from imucal.checking.verdict import CheckResult, Row, Verdict
from imucal.grading import Grade, NoiseVerdict

#: A noise within this factor of what the residuals show passes.
WITHIN = 2.0
#: Largest noise, as a factor, that may be on purpose.
ON_PURPOSE = 30.0
#: Residuals below this share of the expectation are of no data.
NO_DATA = 1e-4


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Mean, median and standard deviation of the residuals of right noise."""

    mean: float
    median: float
    std: float

    @classmethod
    def of(cls, dimension: int) -> "Expected":
        """Return the moments of a chi distribution with `dimension` degrees of freedom.

        Source: Johnson, Kotz and Balakrishnan, Continuous Univariate Distributions 1, chapter 18.
        """
        from scipy.stats import chi

        law = chi(dimension)
        return cls(mean=float(law.mean()), median=float(law.median()), std=float(law.std()))


def verdict_of(factor: float) -> tuple[Verdict, str]:
    """Return the verdict on a noise that is `factor` times too small, and its words.

    A noise that is too large is often on purpose, and then it is undecided.
    """
    if factor > WITHIN:
        return "fail", f"the noise is {factor:.3g} times too small"
    if factor >= 1 / WITHIN:
        return "pass", f"the noise is right within a factor of {WITHIN:g}"
    too_large = f"the noise is {1 / factor:.3g} times too large"
    return ("undecided" if factor >= 1 / ON_PURPOSE else "fail"), too_large


def result_of(path: Path, rows: Sequence[Row], what: str, level: float) -> CheckResult:
    """Return the result of a file of an estimator; `what` names what its rows judge."""
    passed = sum(row.verdict == "pass" for row in rows)
    grade: Grade = "good" if passed == len(rows) else "check"
    sentence = f"{passed} of {len(rows)} {what} are as expected"
    return CheckResult(
        source=str(path),
        level=level,
        rows=tuple(rows),
        undecided_fails=False,
        version=__version__,
        noise=NoiseVerdict(grade=grade, sentence=sentence, axes=()),
    )
