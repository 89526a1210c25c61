"""Tests that every estimator of the table is complete: witness, published value, docs and option."""

from pathlib import Path

import pytest

from imucal.allan import variance
from imucal.allan.variance import ESTIMATORS, Estimator
from imucal.cli.adev import command
from tests.allan.witness import PUBLISHED, WITNESSES

PAGE = Path(__file__).parents[2] / "docs" / "science-allan.md"


def missing_parts(name: str, estimator: Estimator) -> list[str]:
    """Return the missing parts of an estimator, each with the place to add it."""
    offered = next(option.type for option in command.params if option.name == "estimator")
    lacks = {
        f"its line says {estimator.name!r}: give it the name of its key in ESTIMATORS": estimator.name
        != name,
        "no slow witness: add its definition, word for word, to WITNESSES in tests/allan/witness.py": (
            name not in WITNESSES
        ),
        "no published value: add what NIST SP 1065 prints to PUBLISHED in tests/allan/witness.py": (
            name not in PUBLISHED
        ),
        "no row in the table at the head of imucal/allan/estimators.py": (
            f"\n{name} " not in (variance.__doc__ or "")
        ),
        "no row in the table of docs/science-allan.md": (
            f"\n| `{name}` |" not in PAGE.read_text(encoding="utf-8")
        ),
        "`imucal adev --estimator` does not offer it": name not in getattr(offered, "choices", ()),
    }
    return [f"{name}: {sentence}" for sentence, missing in lacks.items() if missing]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_estimator_is_complete(name: str) -> None:
    """Its names, witness, published value and rows exist."""
    assert missing_parts(name, ESTIMATORS[name]) == []


def test_an_incomplete_new_estimator_is_reported() -> None:
    """An estimator with a wrong name that is only in the table gets one sentence per missing part."""
    fake = Estimator(name="totl", integrations=1, order=2, overlapping=True, weight=2)
    assert missing_parts("total", fake) == [
        "total: its line says 'totl': give it the name of its key in ESTIMATORS",
        "total: no slow witness: add its definition, word for word, to WITNESSES in tests/allan/witness.py",
        "total: no published value: add what NIST SP 1065 prints to PUBLISHED in tests/allan/witness.py",
        "total: no row in the table at the head of imucal/allan/estimators.py",
        "total: no row in the table of docs/science-allan.md",
        "total: `imucal adev --estimator` does not offer it",
    ]
