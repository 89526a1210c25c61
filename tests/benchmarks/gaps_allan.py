"""Effect of treatments of missing samples on the Allan variance: prints a table in Markdown.

    python tests/benchmarks/gaps_allan.py [series]

White noise of N = 1 and a random walk of K² = 1e-5, 65,536 places at 1 Hz. A cell is the mean of
estimate over truth at m = 16, 256, 1024 and 4096, with the standard deviation of one series.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imucal.allan.variance import variances, window_variances
from imucal.arrays import FloatArray, IntArray
from imucal.noise import NoiseModel
from imucal.recording import AxisSeries

__all__ = ["main"]

PLACES = 65_536
FACTORS = np.array([16, 256, 1024, 4096])
MODELS = {
    "N=1 + K=3.1623e-3": NoiseModel.parse("N=1 + K=0.0031622776601683794"),
    "N=1": NoiseModel.parse("N=1"),
}

Way = Callable[[FloatArray, NDArray[np.bool_]], FloatArray]


def full(samples: FloatArray, _: NDArray[np.bool_]) -> FloatArray:
    return variances(samples, FACTORS)


def concatenated(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    return variances(samples[keep], FACTORS)


def mean_filled(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    return variances(np.where(keep, samples, samples[keep].mean()), FACTORS)


def interpolated(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    place = np.arange(samples.size)
    return variances(np.interp(place, place[keep], samples[keep]), FACTORS)


def _gappy(samples: FloatArray, keep: NDArray[np.bool_]) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=1.0).keeping(keep)


def complete_windows(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    """Average over windows without a loss."""
    integral = np.concatenate([[0.0], np.cumsum(np.where(keep, samples - samples[keep].mean(), 0.0))])
    filled = np.concatenate([[0], np.cumsum(keep)])
    avar = np.full(FACTORS.size, np.nan)
    for i, m in enumerate(FACTORS.tolist()):
        whole = filled[2 * m :] - filled[: -2 * m] == 2 * m
        if whole.any():
            steps = integral[2 * m :] - 2 * integral[m:-m] + integral[: -2 * m]
            avar[i] = np.mean(steps[whole] ** 2) / (2 * m * m)
    return avar


def half_windows(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    """Average over half filled windows, without the correction for losses."""
    found = window_variances(_gappy(samples, keep), FACTORS)
    return _placed(found.m, found.avar * found.inflation)


def windows(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    found = window_variances(_gappy(samples, keep), FACTORS)
    return _placed(found.m, found.avar)


def pairs(samples: FloatArray, keep: NDArray[np.bool_]) -> FloatArray:
    """Compute D(k) from all present pairs by the FFT; avar(m) = (Φ(2m) - 4 Φ(m)) / (2 m²)."""
    from scipy.fft import irfft, rfft

    lags, size = 2 * int(FACTORS[-1]), 2 * samples.size
    value = np.where(keep, samples - samples[keep].mean(), 0.0)
    there, plain, squared = (rfft(array, size) for array in (keep.astype(np.float64), value, value**2))
    count = irfft(np.abs(there) ** 2, size)[:lags]
    total = irfft(2 * (there * squared.conj()).real - 2 * np.abs(plain) ** 2, size)[:lags]
    structure = total / np.maximum(count, 0.5)
    phi = np.concatenate([[0.0, 0.0], np.cumsum(np.cumsum(structure[1:]))])
    avar = (phi[2 * FACTORS] - 4 * phi[FACTORS]) / (2.0 * FACTORS**2)
    return np.where(avar > 0, avar, np.nan)


def _placed(m: IntArray, avar: FloatArray) -> FloatArray:
    row = np.full(FACTORS.size, np.nan)
    row[np.isin(FACTORS, m)] = avar
    return row


WAYS: dict[str, Way] = {
    "concatenate": concatenated,
    "fill with the mean": mean_filled,
    "interpolate": interpolated,
    "complete windows only": complete_windows,
    "half filled windows": half_windows,
    "all pairs": pairs,
    "**imucal** (half filled, corrected)": windows,
    "nothing lost (reference)": full,
}


def scattered(rng: np.random.Generator) -> NDArray[np.bool_]:
    return rng.random(PLACES) >= 0.1


def bursts(number: int, length: int) -> Callable[[np.random.Generator], NDArray[np.bool_]]:
    def draw(rng: np.random.Generator) -> NDArray[np.bool_]:
        keep = np.ones(PLACES, dtype=bool)
        for start in rng.integers(0, PLACES - length, number):
            keep[start : start + length] = False
        return keep

    return draw


PATTERNS: dict[str, Callable[[np.random.Generator], NDArray[np.bool_]]] = {
    "10 % scattered": scattered,
    "20 bursts of 0.5 %": bursts(20, PLACES // 200),
    "5 bursts of 4 %": bursts(5, PLACES // 25),
    "819 bursts of 8 samples": bursts(PLACES // 80, 8),
}


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    began = time.perf_counter()
    for name, model in MODELS.items():
        true = model.avar(FACTORS.astype(np.float64), rate_hz=1.0)
        print(f"\n{name}; {PLACES} places, {count} series, m = {', '.join(map(str, FACTORS))}\n")
        print("| way | " + " | ".join(PATTERNS) + " |")
        print("|---" * (len(PATTERNS) + 1) + "|")
        cells: dict[str, list[str]] = {way: [] for way in WAYS}
        for pattern in PATTERNS.values():
            rng = np.random.default_rng(40)
            ratios: dict[str, list[FloatArray]] = {way: [] for way in WAYS}
            for _ in range(count):
                samples, keep = model.simulate(PLACES, rate_hz=1.0, rng=rng), pattern(rng)
                keep[0] = keep[-1] = True
                for way, estimate in WAYS.items():
                    ratios[way].append(estimate(samples, keep) / true)
            for way, rows in ratios.items():
                cells[way].append(_cell(np.array(rows)))
        for way, row in cells.items():
            print(f"| {way} | " + " | ".join(row) + " |")
    print(f"\n{time.perf_counter() - began:.0f} s")


def _cell(ratios: FloatArray) -> str:
    """Return mean and standard deviation of each column; a dash if most series have no value."""
    texts = []
    for column in ratios.T:
        good = column[np.isfinite(column)]
        enough = good.size > ratios.shape[0] / 2
        texts.append(f"{good.mean():.2f} ({good.std():.2f})" if enough else "–")
    return ", ".join(texts)


if __name__ == "__main__":
    main()
