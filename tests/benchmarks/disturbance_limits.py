"""How well the best test there can be tells a disturbance from noise, and how well imucal does.

    python tests/benchmarks/disturbance_limits.py telegraph [records] [seed]
    python tests/benchmarks/disturbance_limits.py step [records] [seed]
    python tests/benchmarks/disturbance_limits.py cycle [records] [seed]
    python tests/benchmarks/disturbance_limits.py clean [records] [seed]

The ideal test knows every parameter: the background's spectrum, and the levels and how often they jump, or
the step's height. Its threshold is what one in a hundred clean records exceeds: those of two levels are
records with a Gauss-Markov process of the same spectrum in their place. imucal knows nothing. For a cycle
the ideal test knows the spectrum alone, with a threshold at one in 500 of four times as many clean records;
another one knows the period too. The last command counts what imucal finds in records of noise alone,
without the rest of the analysis.
"""

import sys
from collections import Counter

import numpy as np

import imucal
from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.disturbances import Whitened, best_cycle, find_disturbances
from imucal.fitting.spectral.telegraph import Mixtures, _filtered, _states, find_telegraph
from imucal.noise.term import PowerLawTerm
from imucal.recording import AxisSeries
from tests.benchmarks.disturbances import (
    BESIDE_A_CYCLE,
    CLEAN,
    CONSUMER,
    N_SHORT,
    QUIET,
    RATE,
    Array,
    noise,
    telegraph,
)

LEVEL, DWELL_S, STEP = 6e-5, 40.0, 1e-4
SPAN = N_SHORT // 1024
#: Courses of the level that the ideal test keeps; records at a time.
COURSES, AT_ONCE = 128, 25
CHANCE, CHANCE_OF_CYCLES = 0.01, 0.002


def variances(text: str, tau0: float) -> dict[str, float]:
    """Return the variance per sample of each term of a model."""
    terms = imucal.NoiseModel.parse(text).terms
    return {term.symbol: term.variance(tau0) for term in terms if isinstance(term, PowerLawTerm)}


def means(samples: Array) -> Array:
    """Return means over spans, less their own mean."""
    spans = samples[: 1024 * SPAN].reshape(1024, SPAN).mean(axis=1)
    return np.asarray(spans - spans.mean())


def known(text: str, rows: int) -> Mixtures:
    """Return the truth, in variances per span, for `rows` records."""
    own = variances(text, SPAN / RATE)
    values = {
        "white": own["N"],
        "flicker": own["B"],
        "walk": own["K"],
        "markov": LEVEL**2,
        "time": DWELL_S * RATE / SPAN / 2,
    }
    return Mixtures(**{name: np.full(rows, value) for name, value in values.items()})


def log_likelihood_of_courses(samples: Array, truth: Mixtures, rng: np.random.Generator) -> Array:
    """Return log L of two levels in each record, shape (r,), of samples (n, r), by sums over courses.

    A course is what the level was; given it, everything is normal with the same covariance, so that one
    Kalman gain does for all. Of the courses that part at every span, `COURSES` are kept: the likeliest with
    their weights, the others drawn so that the likelihood is unbiased.

    Source: Fearnhead & Clifford (2003), J. R. Statist. Soc. B 65, 887 (the optimal resampling).
    """
    n, rows = samples.shape
    decay, start, drive = (a[:, 0] for a in _states(truth, np.ones(rows, bool), n, float(samples.var())))
    stay = 0.5 * (1 + np.exp(-1 / truth.time[0]))
    size, white = float(np.sqrt(truth.markov[0])), float(truth.white[0])
    covariance = np.diag(start)
    state, level = np.zeros((rows, 1, decay.size)), np.zeros((rows, 1))
    weight, total = np.ones((rows, 1)), np.zeros(rows)
    for place in range(n):
        variance = covariance.sum() + white
        gain = covariance.sum(axis=1) / variance
        covariance = (covariance - variance * np.outer(gain, gain)) * np.outer(decay, decay) + np.diag(drive)
        level, before = np.concatenate([-np.ones_like(level), np.ones_like(level)], axis=1), level
        chance = np.where(level == np.tile(before, 2), stay, 1 - stay) if place else 0.5
        error = samples[place][:, np.newaxis] - np.tile(state.sum(axis=2), 2) - size * level
        weight = np.tile(weight, 2) * chance * np.exp(-0.5 * error**2 / variance) + 1e-300
        summed = weight.sum(axis=1, keepdims=True)
        total += np.log(summed[:, 0]) - 0.5 * np.log(2 * np.pi * variance)
        state = (np.tile(state, (1, 2, 1)) + error[:, :, np.newaxis] * gain) * decay
        weight = weight / summed
        if weight.shape[1] > COURSES:
            kept, weight = _resampled(weight, rng)
            state = np.take_along_axis(state, kept[:, :, np.newaxis], axis=1)
            level = np.take_along_axis(level, kept, axis=1)
    return total


def _resampled(weight: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return which `COURSES` of the columns are kept, and their weights, shapes (r, c)."""
    falling = -np.sort(-weight, axis=1)
    tail = np.cumsum(falling[:, ::-1], axis=1)[:, ::-1]
    limits = tail[:, :COURSES] / (COURSES - np.arange(COURSES))
    first = np.argmax(falling[:, :COURSES] <= limits, axis=1)
    limit = np.take_along_axis(limits, first[:, np.newaxis], axis=1)
    places = np.cumsum(np.minimum(weight / limit, 1.0), axis=1) - rng.random((len(weight), 1))
    drawn = np.diff(np.floor(places + 1e-9), axis=1, prepend=-1.0) > 0
    kept = np.argsort(~drawn, axis=1, kind="stable")[:, :COURSES]
    chosen = np.take_along_axis(np.maximum(weight, limit), kept, axis=1)
    return kept, np.where(np.take_along_axis(drawn, kept, axis=1), chosen, 0.0)


def power(with_it: Array, without: Array) -> str:
    """Return how many records with a disturbance exceed what `CHANCE` of those without do."""
    return f"{100 * np.mean(with_it > np.quantile(without, 1 - CHANCE)):.0f} %"


def ideal_telegraph(text: str, records: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return log-likelihood ratios of known levels and a known Gauss-Markov process, shape (r,).

    By many courses, and by the merging filter of the package.
    """
    courses, merged = [], []
    for part in np.split(records, range(AT_ONCE, len(records), AT_ONCE)):
        samples, truth, rows = part.T.copy(), known(text, len(part)), len(part)
        gaussian = _filtered(samples, truth, np.zeros(rows, bool)).sum(axis=0)
        courses.append(log_likelihood_of_courses(samples, truth, rng) - gaussian)
        merged.append(_filtered(samples, truth, np.ones(rows, bool)).sum(axis=0) - gaussian)
    return np.concatenate(courses), np.concatenate(merged)


def telegraphs(records: int, seed: int) -> None:
    """Print the power of the ideal test, of the same with merged courses, and of imucal."""
    print(f"levels ±{LEVEL:g} for {DWELL_S:g} s each on average, {records} records, seed {seed}")
    print("| background | ideal test | merged | imucal | imucal on Gauss-Markov |")
    for number, text in enumerate((QUIET, CONSUMER)):
        rng = np.random.default_rng([seed, number])
        markov = f"{text} + GM(sigma={LEVEL}, T={DWELL_S / 2})"
        jumping = [
            noise(text, N_SHORT, rng) + LEVEL * telegraph(N_SHORT, DWELL_S * RATE, rng)
            for _ in range(records)
        ]
        gaussian = [noise(markov, N_SHORT, rng) for _ in range(records)]
        ratios = [ideal_telegraph(text, np.array([*map(means, kind)]), rng) for kind in (jumping, gaussian)]
        found = [
            sum(find_telegraph(AxisSeries.from_samples(s, rate_hz=RATE)) is not None for s in kind)
            for kind in (jumping, gaussian)
        ]
        powers = " | ".join(power(*pair) for pair in zip(*ratios, strict=True))
        print(f"| {text} | {powers} | {found[0]} | {found[1]} |", flush=True)


def block_of(samples: Array) -> Block:
    """Return the transform of samples that hold no gap."""
    return Block(offset=0, bins=dct_bins(samples.size), ordinates=dct_ordinates(samples))


def step_gain(samples: Array, text: str) -> tuple[float, bool]:
    """Return what the best step gains beside the known spectrum, and whether imucal finds one."""
    block = block_of(samples).lowest(4000)
    own = variances(text, 1 / RATE)
    variance = np.array([own.get(symbol, 0.0) for symbol in "QNBK"])
    spectrum = variance @ bin_blocks([block], 1.0).basis
    _, gain, _ = Whitened.by([block], spectrum, ()).step()
    return gain, any(one.kind == "step" for one in find_disturbances([block_of(1e4 * samples)])[0])


def steps(records: int, seed: int) -> None:
    """Print the power of the ideal test for a step of known spectrum and unknown place, and of imucal."""
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
        found = [sum(said for _, said in kind) for kind in (stepped, clean)]
        print(
            f"| {text} | {np.median(with_it):.0f} | {np.quantile(without, 1 - CHANCE):.0f} "
            f"| {power(with_it, without)} | {found[0]} | {found[1]} |",
            flush=True,
        )


def cycles(records: int, seed: int) -> None:
    """Print the power of the ideal test for a cycle of 7e-5 over 150 to 900 s beside a known spectrum."""
    time_s = np.arange(N_SHORT) / RATE
    print(f"cycle of 7e-5 over 150 to 900 s, {records} records, seed {seed}")
    print("| background | of noise (99.8 %) | ideal test | of its four parts by period | period known |")
    for number, text in enumerate((*BESIDE_A_CYCLE, CONSUMER)):
        own = variances(text, 1 / RATE)
        variance = np.array([own.get(symbol, 0.0) for symbol in "QNBK"])

        def gains(samples: Array, period_s: float, variance: Array = variance) -> tuple[float, float]:
            block = block_of(samples).lowest(4000)
            whitened = Whitened.by([block], variance @ bin_blocks([block], 1.0).basis, ("R",))
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
        told = best[:records] > limits[0]
        part = np.digitize(period[:records], [300, 500, 700])
        print(
            f"| {text} | {limits[0]:.1f} | {100 * told.mean():.0f} % "
            f"| {' '.join(f'{100 * told[part == i].mean():.0f}' for i in range(4))} % "
            f"| {100 * np.mean(known[:records] > limits[1]):.0f} % |",
            flush=True,
        )


def clean(records: int, seed: int) -> None:
    """Print how often two levels, steps, cycles and warm-ups are found where there is noise alone."""
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
                if find_telegraph(AxisSeries.from_samples(samples, rate_hz=RATE)) is not None:
                    found["telegraph"] += 1
                found.update({one.kind for one in find_disturbances([block_of(1e4 * samples)])[0]})
            print(f"| {text} | {n} | {dict(found)} |", flush=True)


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[2:4]]
    count, start = (*given, *(200, 1)[len(given) :])
    {"telegraph": telegraphs, "step": steps, "cycle": cycles, "clean": clean}[sys.argv[1]](count, start)
