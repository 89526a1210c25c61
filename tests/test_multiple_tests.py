"""Adjusted p-values."""

import math

import numpy as np
import pytest

from imucal.multiple_tests import SIGNIFICANCE, holm


def test_holms_values_agree_with_a_manual_calculation() -> None:
    """0.01 of three tests is 0.03; a larger one is never adjusted to less; the order is kept."""
    assert holm([0.04, 0.01, 0.02, 0.9]) == pytest.approx([0.08, 0.04, 0.06, 0.9])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_a_hypothesis_is_rejected_as_in_holms_procedure() -> None:
    """Step down: compare the smallest p-value with alpha / n, the next with alpha / (n - 1) ..., and stop."""
    rng = np.random.default_rng(7713)
    for _ in range(200):
        p_values = rng.random(9) ** 4
        rejected = set()
        for rank, place in enumerate(np.argsort(p_values)):
            if p_values[place] > SIGNIFICANCE / (9 - rank):
                break
            rejected.add(int(place))
        found = {place for place, p in enumerate(holm(p_values)) if p <= SIGNIFICANCE}
        assert found == rejected


def test_one_fleet_in_twenty_has_a_false_alarm_although_a_test_is_true() -> None:
    """A true difference must not raise the chance of a false one."""
    rng = np.random.default_rng(4410)
    alarms = 0
    for _ in range(4000):
        p_values = rng.random(30)
        p_values[0] = 1e-6
        alarms += any(p <= SIGNIFICANCE for p in holm(p_values)[1:])
    # Four standard errors.
    assert abs(alarms / 4000 - SIGNIFICANCE) < 4 * math.sqrt(0.05 * 0.95 / 4000)
