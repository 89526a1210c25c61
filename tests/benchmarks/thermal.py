"""Bias over temperature: coverage of the curve, the error in unseen parts, and the cubic of flight stacks.

    python -m tests.benchmarks.thermal [--logs 24] [--seed 1]

Ten simulated effects, half of them in a chamber and half with a heater; then the real chamber record.
"""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import imucal
from imucal.arrays import BoolArray
from imucal.temperature.curve import Curve
from imucal.temperature.fitting import Fit, Lags, curve_on, fit_axis, held_out
from imucal.temperature.ramp import AxisBlocks, Ramp
from tests.temperature.ramps import HALF, MIDDLE, SHAPES, SIZE, STATIC, KnownRamp, known_ramp

#: Effects that a polynomial describes.
SMOOTH = ("none", "line", "parabola", "cubic")
#: Temperatures of a curve at which its interval is tested; the middle one is the reference.
_PLACES = 13


def covered(curve: Curve, shape: str) -> BoolArray:
    """Return whether the intervals of the change from the reference contain the true one."""
    temperature = np.delete(np.linspace(curve.low_c, curve.high_c, _PLACES), _PLACES // 2)
    at = np.concatenate([[curve.reference_c], temperature])
    true, found = SIZE * STATIC[shape]((at - MIDDLE) / HALF), curve.static(at)
    off = (found[1:] - found[0]) - (true[1:] - true[0])
    return np.asarray(np.abs(off) <= curve.half_width(temperature) + 1e-15)


def error_in_a_new_log(known: KnownRamp, ramp: Ramp, fit: Fit, rng: np.random.Generator) -> float:
    """Return the rms error in a new log with the same effect and new slow noise, without its mean."""
    slow = known.model.simulate(known.bias.size, rate_hz=2.0, rng=rng)
    block = np.arange(slow.size) * ramp.blocks // slow.size
    means = np.bincount(block, weights=known.bias + slow) / np.bincount(block)
    rest = means - curve_on(fit.curve, ramp, np.arange(ramp.blocks))
    white = 1e-4**2 / ramp.block_s
    return float(np.sqrt(max(float(np.var(rest)) - white, white / ramp.blocks)))


def simulated(logs: int, seed: int, noise: str) -> Iterator[str]:
    """Yield a line for each effect."""
    rng = np.random.default_rng(seed)
    for shape in SHAPES:
        inside, ratios, cubics = [], [], []
        for number in range(logs):
            known = known_ramp(shape, rng, noise=noise, chamber=number % 2 > 0)
            ramp = Ramp.of(known.recording)
            axis = AxisBlocks.of(known.recording.series[0], ramp)
            lags = Lags.of(ramp)
            fit = fit_axis(ramp, lags, axis)
            own = fit.held_out or np.nan
            ratios.append(own / error_in_a_new_log(known, ramp, fit, rng))
            cubics.append(held_out(ramp, lags, axis, "present")[3] / own)
            if shape in SMOOTH:
                inside.append(covered(fit.curve, shape))
        share = f"{100 * np.mean(inside):5.1f} %" if inside else "      –"
        yield f"{shape:22} {share}  {np.median(ratios):5.2f}  {np.median(cubics):5.2f}  {min(cubics):5.2f}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for noise in ("N=1e-4 + B=5e-5 + K=1e-6", "N=1e-4 + B=2e-5 + K=1e-7"):
        print(f"{noise}\n{'effect':22} covered  error  cubic  least")
        for line in simulated(asked.logs, asked.seed, noise):
            print(line, flush=True)
    print("error: in unseen parts / true, median; cubic: error of the cubic / ours, median and least")
    record = Path(os.environ.get("IMUCAL_REAL_DATA", "../shared/data")) / "thermal" / "chamber_ramp.csv"
    if record.exists():
        for axis in imucal.thermal(imucal.read(record, time_unit="us")).axes:
            ratio = (axis.cubic_held_out or np.nan) / (axis.held_out or np.nan)
            print(
                f"{axis.name}: cubic {axis.cubic_held_out:.3g}, ours {axis.held_out:.3g}: {ratio:.2f} times"
            )


if __name__ == "__main__":
    main()
