"""A log that is fitted quickly: one axis of white noise."""

import numpy as np

__all__ = ["OPTIONS", "one_axis"]

#: The header does not contain the unit.
OPTIONS = ("--gyro-unit", "rad/s")


def one_axis(seed: int = 1414) -> bytes:
    """Return a table of 1500 rows at 100 Hz."""
    samples = 1e-3 * np.random.default_rng(seed).standard_normal(1500)
    return "".join(["t,gz\n", *(f"{i / 100:.2f},{x:.9f}\n" for i, x in enumerate(samples))]).encode()
