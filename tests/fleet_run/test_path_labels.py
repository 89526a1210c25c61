"""Tests of labels from paths."""

import pytest

from imucal.errors import ArgumentError
from imucal.fleet_run.logs import label_pattern
from imucal.fleet_run.plan import labels_in


@pytest.mark.parametrize(
    ("pattern", "path", "labels"),
    [
        ("{model}/{unit}/*.mcap", "a/bmi/007/x.mcap", {"model": "bmi", "unit": "007"}),
        ("{unit}/{temperature_c}C/*", "u1/-25C/x.bag", {"unit": "u1", "temperature_c": -25.0}),
        ("{model}-{unit}.*", "logs/adis-3-b.csv", {"model": "adis", "unit": "3-b"}),
        ("{unit}/**/*.csv", "u1/2026/05/x.csv", {"unit": "u1"}),
        ("{unit}_run?.npz", "u1_run7.npz", {"unit": "u1"}),
        ("{model}/{unit}/*.mcap", "s3://bucket/bmi/007/x.mcap", {"model": "bmi", "unit": "007"}),
        ("{model}/{unit}/*.mcap", "C:\\logs\\bmi\\007\\x.mcap", {"model": "bmi", "unit": "007"}),
        ("{unit}.(1).csv", "u.(1).csv", {"unit": "u"}),
        ("{model}/{unit}/*.mcap", "007/x.mcap", {}),
        ("{model}/{unit}/*.mcap", "bmi/007/x.mcap.part", {}),
        ("{unit}/*.csv", "u1/deep/x.csv", {"unit": "deep"}),
    ],
)
def test_a_pattern_is_matched_with_the_end_of_a_path(
    pattern: str, path: str, labels: dict[str, str | float]
) -> None:
    """A star and a label match within one folder name."""
    assert labels_in(path, pattern) == labels


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("*.mcap", "no label; write for example '{model}/{unit}/"),
        ("{unit}/{unit}", "'unit' is duplicated; give each label its own name"),
        ("{unit/*", "an unmatched brace; write for example"),
        ("{}/x", "'' is not a label name; write for example {unit}"),
        ("{path}/x", "'path' is not a label name"),
    ],
)
def test_invalid_patterns_are_rejected(pattern: str, message: str) -> None:
    """The error contains a valid example."""
    with pytest.raises(ArgumentError, match=r"^labels ") as caught:
        label_pattern(pattern)
    assert message in str(caught.value)
