"""Coverage of the intervals of an Allan curve: prints tables in Markdown.

    python tests/benchmarks/coverage_allan.py [replications]

Every series has n = 4096 samples; the curve is the default one (octaves, m <= n/4). The method was
designed on the settings of the first table; those of the second are held out.
"""

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from imucal.allan import allan_curve
from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.recording import AxisSeries

__all__ = ["GAPPY", "HELD_OUT", "STANDARD", "N", "Setting", "coverage"]

N = 4096
LEVELS = (0.68, 0.95)

#: Draws a series. The truth is a function of the averaging factors.
Setting = tuple[Callable[[np.random.Generator], FloatArray], Callable[[FloatArray], FloatArray]]


def of_model(text: str) -> Setting:
    """Return the setting of a model at one sample per second."""
    model = NoiseModel.parse(text)
    return partial(_draw_model, model), partial(_model_truth, model)


def _draw_model(model: NoiseModel, rng: np.random.Generator) -> FloatArray:
    return model.simulate(N, rate_hz=1.0, rng=rng)


def _model_truth(model: NoiseModel, m: FloatArray) -> FloatArray:
    return model.avar(m, rate_hz=1.0)


def filtered(numerator: FloatArray, denominator: FloatArray) -> Setting:
    """Return the setting of unit white noise behind a digital filter."""
    return partial(_draw_filtered, numerator, denominator), partial(_filtered_truth, numerator, denominator)


def _draw_filtered(numerator: FloatArray, denominator: FloatArray, rng: np.random.Generator) -> FloatArray:
    from scipy.signal import lfilter

    settled = np.asarray(lfilter(numerator, denominator, rng.standard_normal(N + 2000)))
    return settled[2000:]


def _filtered_truth(numerator: FloatArray, denominator: FloatArray, m: FloatArray) -> FloatArray:
    """Return the mean of the psd times the response of the Allan variance over a fine frequency grid."""
    from scipy.signal import freqz

    omega = np.pi * (np.arange(1 << 18) + 0.5) / (1 << 18)
    _, gain = freqz(numerator, denominator, worN=omega)
    psd = np.abs(gain) ** 2
    return np.array([np.mean(psd * 2 * np.sin(k * omega / 2) ** 4 / (k * np.sin(omega / 2)) ** 2) for k in m])


def heavy(draw: Callable[[np.random.Generator], FloatArray]) -> Setting:
    """Return the setting of independent values of unit variance."""
    return draw, _white_truth


def _white_truth(m: FloatArray) -> FloatArray:
    return 1 / m


def _laplace(rng: np.random.Generator) -> FloatArray:
    draw: FloatArray = rng.laplace(size=N) / np.sqrt(2)
    return draw


def _student(rng: np.random.Generator) -> FloatArray:
    draw: FloatArray = rng.standard_t(5, size=N) / np.sqrt(5 / 3)
    return draw


def _butterworth(order: int, corner: float) -> Setting:
    from scipy.signal import butter

    return filtered(*butter(order, corner))


STANDARD: dict[str, Setting] = {
    "N": of_model("N=1"),
    "N + K": of_model("N=1 + K=0.03"),
    "N + B": of_model("N=1 + B=0.2"),
    "N + GM": of_model("N=1 + GM(sigma=0.3, T=50)"),
    "Q + N": of_model("Q=2 + N=1"),
    "K": of_model("K=1"),
}

HELD_OUT: dict[str, Setting] = {
    "N + 2*GM": of_model("N=1 + GM(sigma=0.5, T=10) + GM(sigma=0.3, T=300)"),
    "Q + N + B + K": of_model("Q=2 + N=1 + B=0.2 + K=0.01"),
    "Butterworth-4, 0.5 Nyquist": _butterworth(4, 0.5),
    "Butterworth-4, 0.75 Nyquist": _butterworth(4, 0.75),
    "Butterworth-4, 0.3 Nyquist": _butterworth(4, 0.3),
    "one pole, 0.2 Nyquist": _butterworth(1, 0.2),
    "resonance": filtered(np.array([1.0]), np.array([1.0, -1.2, 0.8])),
    "Laplace": heavy(_laplace),
    "Student t, 5 dof": heavy(_student),
    "N + R": of_model("N=1 + R=2e-4"),
}


def _scattered(rng: np.random.Generator) -> NDArray[np.bool_]:
    return rng.random(N) < 0.1


def _bursts(number: int, length: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    lost = np.zeros(N, dtype=bool)
    for start in rng.integers(0, N - length, number):
        lost[start : start + length] = True
    return lost


def losing(text: str, lose: Callable[[np.random.Generator], NDArray[np.bool_]]) -> Setting:
    """Return the setting of a model with some samples NaN, except the first and last."""
    model = NoiseModel.parse(text)

    def draw(rng: np.random.Generator) -> FloatArray:
        samples = model.simulate(N, rate_hz=1.0, rng=rng)
        lost = lose(rng)
        lost[0] = lost[-1] = False
        return np.where(lost, np.nan, samples)

    return draw, partial(_model_truth, model)


LOSSES: dict[str, Callable[[np.random.Generator], NDArray[np.bool_]]] = {
    "scattered": _scattered,
    "5 bursts of 4 %": partial(_bursts, 5, N // 25),
    "51 bursts of 8": partial(_bursts, N // 80, 8),
}

GAPPY: dict[str, Setting] = {
    f"{text}, {name}": losing(text, lose)
    for text in ("N=1", "N=1 + K=0.03", "N=1 + B=0.2", "K=1")
    for name, lose in LOSSES.items()
}

GROUPS = {"standard": STANDARD, "held out": HELD_OUT, "gaps": GAPPY}


def coverage(
    setting: Setting, replications: int, seed: int, *, level: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Return the averaging factors and the share of intervals that cover the truth, each (k,)."""
    draw, truth = setting
    rng = np.random.default_rng(seed)
    m = np.exp2(np.arange(np.log2(N / 4) + 1))
    true = np.sqrt(truth(m))
    held, count = np.zeros((2, m.size))
    for _ in range(replications):
        curve = allan_curve(AxisSeries.from_samples(draw(rng), rate_hz=1.0))
        there = np.isin(m, curve.m)
        low, high = curve.confidence_interval(level)
        held[there] += (low <= true[there]) & (true[there] <= high)
        count[there] += 1
    return m, held / np.maximum(count, 1)


def _row(job: tuple[str, str, int, int]) -> tuple[str, str, FloatArray, FloatArray]:
    group, name, replications, seed = job
    m, share = coverage(GROUPS[group][name], replications, seed)
    return group, name, m, share


def main() -> None:
    replications = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    began = time.perf_counter()
    jobs = [(g, name, replications, 100 + i) for g, s in GROUPS.items() for i, name in enumerate(s)]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(_row, jobs))
    print(f"Coverage of 95 % intervals, in %; n = {N}, {replications} replications.")
    for group in GROUPS:
        mine = [row for row in rows if row[0] == group]
        print(f"\n| {group}, m = | " + " | ".join(f"{m:.0f}" for m in mine[0][2]) + " | mean |")
        print("|---" * (mine[0][2].size + 2) + "|")
        for _, name, _, share in mine:
            print(
                f"| {name} | "
                + " | ".join(f"{100 * s:.1f}" for s in share)
                + f" | {100 * share.mean():.1f} |"
            )
        every = np.array([share for *_, share in mine])
        print(f"\n{group}: {100 * every.min():.1f} to {100 * every.max():.1f}, mean {100 * every.mean():.1f}")
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
