"""Power of an ideal test for disturbances, compared with imucal.

    python tests/benchmarks/disturbance_limits.py step [records] [seed]
    python tests/benchmarks/disturbance_limits.py cycle [records] [seed]
    python tests/benchmarks/disturbance_limits.py clean [records] [seed]

The ideal test uses the true spectrum of the background and the step's true height. One in a hundred clean
records exceeds its threshold. imucal uses neither. For a cycle the ideal test uses the true spectrum only,
with a false alarm rate of one in 500, from four times as many clean records; another test also uses the true
period. The last command counts the disturbances that imucal finds in clean noise, without other steps.
"""

import sys
from collections import Counter

import numpy as np

import imucal
from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.fitting.regressors import Ramp, Step
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.disturbances.shapes import best_cycle, find_disturbances, with_shape
from imucal.fitting.spectral.disturbances.whitened import Whitened
from imucal.noise.term import PowerLawTerm
from tests.benchmarks.disturbances import (
    BESIDE_A_CYCLE,
    CLEAN,
    CONSUMER,
    N_SHORT,
    QUIET,
    RATE,
    Array,
    noise,
)

LEVEL, DWELL_S, STEP = 6e-5, 40.0, 1e-4
CHANCE, CHANCE_OF_CYCLES = 0.01, 0.002


def variances(text: str, tau0: float) -> dict[str, float]:
    """Return the variance per sample of each term of a model."""
    terms = imucal.NoiseModel.parse(text).terms
    return {term.symbol: term.variance(tau0) for term in terms if isinstance(term, PowerLawTerm)}


def power(with_it: Array, without: Array) -> str:
    """Return the share of records with a disturbance above the `CHANCE` threshold of clean records."""
    return f"{100 * np.mean(with_it > np.quantile(without, 1 - CHANCE)):.0f} %"


def block_of(samples: Array) -> Block:
    """Return the transform of samples without gaps."""
    return Block(offset=0, bins=dct_bins(samples.size), ordinates=dct_ordinates(samples))


def step_gain(samples: Array, text: str) -> tuple[float, bool]:
    """Return the gain of the best step with the known spectrum, and whether imucal finds a step."""
    block = block_of(samples).lowest(4000)
    own = variances(text, 1 / RATE)
    variance = np.array([own.get(symbol, 0.0) for symbol in "QNBK"])
    spectrum = variance @ bin_blocks([block], 1.0).basis
    _, gain, _ = Whitened.by([block], spectrum, ()).step()
    return gain, bool(with_shape(find_disturbances([block_of(1e4 * samples)])[0], Step))


def steps(records: int, seed: int) -> None:
    """Print the power for a step at an unknown place, of the ideal test with known spectrum and of imucal."""
    print(f"step of {STEP:g} that stays, {records} records, seed {seed}")
    print("| background | gain of the step (median) | of noise (99 %) | ideal test | imucal | on clean |")
    for number, text in enumerate((QUIET, CONSUMER)):
        rng = np.random.default_rng([seed, number])
        place = np.arange(N_SHORT)
        clean = [step_gain(noise(text, N_SHORT, rng), text) for _ in range(records)]
        stepped = [
            step_gain(noise(text, N_SHORT, rng) + STEP * (place > rng.uniform(0.2, 0.8) * N_SHORT), text)
            for _ in range(records)
        ]
        with_it, without = (np.array([gain for gain, _ in kind]) for kind in (stepped, clean))
        found = [sum(is_found for _, is_found in kind) for kind in (stepped, clean)]
        print(
            f"| {text} | {np.median(with_it):.0f} | {np.quantile(without, 1 - CHANCE):.0f} "
            f"| {power(with_it, without)} | {found[0]} | {found[1]} |",
            flush=True,
        )


def cycles(records: int, seed: int) -> None:
    """Print the power of the ideal test for a cycle of 7e-5 over 150 to 900 s with a known spectrum."""
    time_s = np.arange(N_SHORT) / RATE
    print(f"cycle of 7e-5 over 150 to 900 s, {records} records, seed {seed}")
    print("| background | of noise (99.8 %) | ideal test | of its four parts by period | period known |")
    for number, text in enumerate((*BESIDE_A_CYCLE, CONSUMER)):
        own = variances(text, 1 / RATE)
        variance = np.array([own.get(symbol, 0.0) for symbol in "QNBK"])

        def gains(samples: Array, period_s: float, variance: Array = variance) -> tuple[float, float]:
            block = block_of(samples).lowest(4000)
            whitened = Whitened.by([block], variance @ bin_blocks([block], 1.0).basis, (Ramp(),))
            known = whitened.cycles(np.array([2 * np.pi / (period_s * RATE)]))
            return best_cycle(whitened, N_SHORT)[0], float(known[0])

        found = []
        for record in range(5 * records):
            rng = np.random.default_rng([seed, number, record])
            period_s = rng.uniform(150, 900)
            swing = 7e-5 * np.sin(2 * np.pi * time_s / period_s + rng.uniform(0, 6.28))
            samples = noise(text, N_SHORT, rng) + (swing if record < records else 0.0)
            found.append((period_s, *gains(samples, period_s)))
        period, best, known = np.array(found).T
        limits = np.quantile([best[records:], known[records:]], 1 - CHANCE_OF_CYCLES, axis=1)
        exceeded = best[:records] > limits[0]
        part = np.digitize(period[:records], [300, 500, 700])
        print(
            f"| {text} | {limits[0]:.1f} | {100 * exceeded.mean():.0f} % "
            f"| {' '.join(f'{100 * exceeded[part == i].mean():.0f}' for i in range(4))} % "
            f"| {100 * np.mean(known[:records] > limits[1]):.0f} % |",
            flush=True,
        )


def clean(records: int, seed: int) -> None:
    """Print how often steps, cycles and warm-ups are found in clean noise."""
    print(f"found in {records} clean records, seed {seed}")
    more = (
        f"N=1e-4 + GM(sigma={LEVEL}, T={DWELL_S / 2})",
        "N=1e-4 + GM(sigma=6e-5, T=10) + GM(sigma=6e-5, T=100)",
    )
    for n in (N_SHORT // 10, N_SHORT):
        for number, text in enumerate((*CLEAN, *more)):
            found: Counter[str] = Counter()
            rng = np.random.default_rng([seed, number, n])
            for _ in range(records):
                samples = noise(text, n, rng)
                found.update(
                    {one.shape.description for one in find_disturbances([block_of(1e4 * samples)])[0]}
                )
            print(f"| {text} | {n} | {dict(found)} |", flush=True)


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[2:4]]
    count, start = (*given, *(200, 1)[len(given) :])
    {"step": steps, "cycle": cycles, "clean": clean}[sys.argv[1]](count, start)
