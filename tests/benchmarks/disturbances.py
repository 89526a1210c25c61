"""Effect of disturbances on the fit, and false alarms in clean records.

    python tests/benchmarks/disturbances.py table [records] [seed]      input | N, B, K | findings
    python tests/benchmarks/disturbances.py coverage [records] [seed] [part of a name]
                                                                        input | coverage of N, B, K
    python tests/benchmarks/disturbances.py clean [records] [seed]      truth | how often each finding
    python tests/benchmarks/disturbances.py filters [records] [seed]    filter | how often each finding
    python tests/benchmarks/disturbances.py cycles [records] [seed]     truth | cycles found, and K covered
    python tests/benchmarks/disturbances.py lengths                     length | CPU of transform and analysis

With another version on PYTHONPATH, it prints the figures of that version.
"""

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import imucal
from imucal.clock import Clock
from imucal.fitting.spectral.blocks import make_blocks
from imucal.fitting.spectral.disturbances.shapes import exact_places, find_disturbances
from imucal.pipeline import characterize
from imucal.report import AxisReport

if TYPE_CHECKING:
    from imucal.fitting.noise_fit import NoiseFit
from imucal.recording import AxisSeries, Recording, Sensor, Source, Temperature

RATE = 100.0
N_SHORT, N_LONG = 200_000, 1_080_000
Array = np.ndarray
Draw = Callable[[int, np.random.Generator], Array]
Make = Callable[[np.random.Generator], tuple[Array, Array | None]]
SLOW = "N=1e-4 + K=1e-6"
CONSUMER = "N=1e-4 + B=3e-5 + K=3e-6"
QUIET = "N=1e-4 + B=1e-5 + K=1e-6"
BESIDE_A_CYCLE = ("N=1e-4 + B=3e-5", "N=1e-4 + K=3e-6", "N=1e-4 + B=3e-5 + K=5e-6")
CLEAN = (
    *("N=1e-4", SLOW, CONSUMER, QUIET, "N=1e-4 + K=3e-5", "N=1e-4 + B=1e-4"),
    *("N=1e-4 + GM(sigma=4e-5, T=5)", "N=1e-4 + GM(sigma=4e-5, T=100)", "N=1e-4 + R=4e-7"),
)


def noise(text: str, n: int, rng: np.random.Generator) -> Array:
    """Return samples of a model."""
    return imucal.NoiseModel.parse(text).simulate(n, rate_hz=RATE, rng=rng)


def telegraph(n: int, dwell: float, rng: np.random.Generator) -> Array:
    """Return alternating +1 and -1, each for an exponential time of mean `dwell` samples."""
    times = np.cumsum(rng.exponential(dwell, int(3 * n / dwell) + 20))
    return np.where(np.searchsorted(times, np.arange(n)) % 2, 1.0, -1.0)


def lagging(samples: Array, lag: float) -> Array:
    """Return samples delayed by a first-order lag, in samples."""
    from scipy.signal import lfilter

    phi = np.exp(-1 / lag)
    return np.asarray(samples[0] + lfilter([1 - phi], [1, -phi], samples - samples[0]))


def thermostat(n: int, rng: np.random.Generator) -> Array:
    """Return a temperature that swings by half a degree in 20 min, with the thermometer's noise."""
    t = np.arange(n) / RATE
    return 25 + 0.5 * np.sin(2 * np.pi * t / 1200 + rng.uniform(0, 6)) + 0.01 * rng.standard_normal(n)


def held(n: int, rng: np.random.Generator) -> Array:
    return np.asarray(np.repeat(noise(CONSUMER, n // 4 + 1, rng), 4)[:n])


def mean_of(k: int) -> Draw:
    return lambda n, rng: np.convolve(noise(CONSUMER, n + k - 1, rng), np.full(k, 1 / k), "valid")


def recursive(numerator: list[float], denominator: list[float]) -> Draw:
    def filtered(n: int, rng: np.random.Generator) -> Array:
        from scipy.signal import lfilter

        x = noise(CONSUMER, n + 2000, rng)
        return lfilter(np.array(numerator) * sum(denominator) / sum(numerator), denominator, x - x[0])[2000:]

    return filtered


def butterworth(order: int, corner: float) -> Draw:
    from scipy.signal import butter

    return recursive(*(coefficients.tolist() for coefficients in butter(order, corner)))


_POLE = 0.95 * np.exp(0.4j * np.pi)
FILTERS: dict[str, Draw] = {
    "mean of 4": mean_of(4),
    "mean of 8": mean_of(8),
    "held 4 times": held,
    "one-pole": recursive([1.0], [1.0, -0.7]),
    "Butterworth 2": butterworth(2, 0.2),
    "Butterworth 4": butterworth(4, 0.5),
    "resonance": recursive([1.0], [1.0, -2 * _POLE.real, abs(_POLE) ** 2]),
}


def _plus(text: str, n: int, shape: Callable[[Array, np.random.Generator], Array]) -> Make:
    return lambda rng: (noise(text, n, rng) + shape(np.arange(n) / RATE, rng), None)


def _heated(lag: float) -> Make:
    def make(rng: np.random.Generator) -> tuple[Array, Array]:
        warm = thermostat(N_LONG, rng)
        return noise(SLOW, N_LONG, rng) + 1e-4 * lagging(warm, lag * RATE), warm

    return make


def _student(rng: np.random.Generator) -> tuple[Array, None]:
    white = 1e-4 * np.sqrt(RATE / 2) * rng.standard_t(4, N_SHORT)
    return white + noise("K=1e-6", N_SHORT, rng), None


#: Name -> truth, and function that returns samples and temperature of a record.
INPUTS = {
    "cycle of 20 min in 3 h": (
        SLOW,
        _plus(SLOW, N_LONG, lambda t, rng: 5e-5 * np.sin(2 * np.pi * t / 1200 + rng.uniform(0, 6))),
    ),
    "temperature, lag 60 s": (SLOW, _heated(60.0)),
    "cycle of 151 s in 33 min": (
        SLOW,
        _plus(SLOW, N_SHORT, lambda t, rng: 5e-5 * np.sin(2 * np.pi * t / 151 + rng.uniform(0, 6))),
    ),
    "Student t, 4 dof": (SLOW, _student),
    "telegraph 6e-5, 40 s": (
        QUIET,
        _plus(QUIET, N_SHORT, lambda t, rng: 6e-5 * telegraph(t.size, 4000, rng)),
    ),
    "step of 1e-4": (QUIET, _plus(QUIET, N_SHORT, lambda t, rng: 1e-4 * (t > rng.uniform(400, 1600)))),
    "step of 1e-4, strong B": (
        CONSUMER,
        _plus(CONSUMER, N_SHORT, lambda t, rng: 1e-4 * (t > rng.uniform(400, 1600))),
    ),
}


def report(samples: Array, temperature: Array | None = None, rate: float = RATE) -> AxisReport:
    """Return the default analysis of one axis."""
    clock = Clock.even(samples.size, rate)
    series = AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=samples, clock=clock)
    warm = None if temperature is None else Temperature(samples=temperature, clock=clock)
    recording = Recording(source=Source(path="made", format="made"), series=(series,), temperature=warm)
    return characterize(recording).axes[0]


def holds(fit: "NoiseFit", truth: str) -> dict[str, bool]:
    """Return whether the interval of each of N, B and K covers the truth."""
    known = {term.symbol: term.coefficient for term in imucal.NoiseModel.parse(truth).terms}
    return {symbol: fit[symbol].low <= known.get(symbol, 0.0) <= fit[symbol].high for symbol in "NBK"}


def shown(fit: "NoiseFit", truth: str) -> str:
    """Return each estimate with its interval, marked if it misses the truth."""
    words = []
    for symbol, held in holds(fit, truth).items():
        e = fit[symbol]
        off = "" if held else " MISSES"
        number = f"<{e.high:.2g}" if e.value is None else f"{e.value:.3g} [{e.low:.3g}, {e.high:.3g}]"
        words.append(f"{symbol} {number}{off}")
    return ", ".join(words)


def coverage(records: int, seed: int) -> None:
    """Print how many records of each disturbance cover the truth, and their findings."""
    wanted = sys.argv[4] if len(sys.argv) > 4 else ""
    for number, (name, (truth, make)) in enumerate(INPUTS.items()):
        if wanted not in name:
            continue
        held: Counter[str] = Counter()
        codes: Counter[str] = Counter()
        for record in range(records):
            axis = report(*make(np.random.default_rng([seed, number, record])))
            held.update(symbol for symbol, held_it in holds(axis.fit, truth).items() if held_it)
            codes.update({f.code for f in axis.findings} - {"record-length", "model-choice"})
        counts = " / ".join(str(held[symbol]) for symbol in "NBK")
        print(f"| {name} ({truth}) | {counts} of {records} | {dict(codes)} |", flush=True)


def table(records: int, seed: int) -> None:
    """Print the effect of each disturbance."""
    for name, (truth, make) in INPUTS.items():
        for record in range(records):
            samples, warm = make(np.random.default_rng([seed, record, len(name)]))
            axis = report(samples, warm)
            codes = sorted({f.code for f in axis.findings if f.code not in {"record-length", "model-choice"}})
            print(f"| {name} ({truth}) | {shown(axis.fit, truth)} | {', '.join(codes)} |", flush=True)
    for record in range(records):
        rng = np.random.default_rng([seed + 1, record])
        tone = 5e-3 * np.sin(np.pi / 2 * np.arange(2732) + rng.uniform(0, 6))
        try:
            outcome = ", ".join(
                sorted(
                    {f.code for f in report(1.5e-4 * rng.standard_normal(2732) + tone, rate=40.0).findings}
                )
            )
        except Exception as error:  # noqa: BLE001 - the error is the result
            outcome = f"{type(error).__name__}: {error}"
        print(f"| tone at rate/4 | | {outcome} |", flush=True)


def _counted(kinds: dict[str, Draw], records: int, n: int, seed: int) -> None:
    for number, (name, make) in enumerate(kinds.items()):
        codes: Counter[str] = Counter()
        for record in range(records):
            found = report(make(n, np.random.default_rng([seed, number, record, n]))).findings
            codes.update(
                {f.code for f in found} - {"record-length", "model-choice", "output-filter", "roll-off"}
            )
        print(f"| {name} | {n} | {records} | {dict(codes)} |", flush=True)


def clean(records: int, seed: int) -> None:
    """Print how often each finding occurs in clean noise of the model's kinds."""
    kinds: dict[str, Draw] = {text: partial(noise, text) for text in CLEAN}
    for n in (20_000, N_SHORT):
        _counted(kinds, records, n, seed)


def filters(records: int, seed: int) -> None:
    """Print how often a line or a misfit is reported in clean records behind a filter."""
    _counted(FILTERS, records, N_SHORT, seed)


def cycles(records: int, seed: int) -> None:
    """Print how often a cycle of 7e-5 over 150 to 900 s is found, and K covered.

    It also prints how often a cycle is found in ten times as many clean records.
    """
    time_s = np.arange(N_SHORT) / RATE
    for number, text in enumerate(BESIDE_A_CYCLE):
        found: Counter[str] = Counter()
        for record in range(records):
            rng = np.random.default_rng([seed, number, record, 1])
            swing = 7e-5 * np.sin(2 * np.pi * time_s / rng.uniform(150, 900) + rng.uniform(0, 6.28))
            fit = imucal.fit(AxisSeries.from_samples(noise(text, N_SHORT, rng) + swing, rate_hz=RATE))
            found["K held"] += holds(fit, text)["K"]
            found["K shown"] += fit["K"].value is not None
            found.update({f.code for f in fit.findings} & {"cycle", "cycle-doubtful"})
        print(f"| 7e-5 beside {text} | {records} | {dict(found)} |", flush=True)
    for number, text in enumerate(CLEAN):
        codes: Counter[str] = Counter()
        for record in range(10 * records):
            rng = np.random.default_rng([seed, number, record, 2])
            series = AxisSeries.from_samples(noise(text, N_SHORT, rng), rate_hz=RATE)
            named, doubtful = find_disturbances(make_blocks(series).blocks, exact=exact_places(series))
            codes.update({one.shape.description for one in named} | {"doubtful" for _ in doubtful})
        print(f"| clean {text} | {10 * records} | {dict(codes)} |", flush=True)


def _neighbours() -> Iterator[int]:
    for n in (100_000, 1_000_000, 2_160_000):
        yield from (n, n - 1, n + 1, n - 2, n - 7, n - 20, n + 3, n + 20)
    yield from (99_991, 999_983, 1_000_003, 2_159_977)


def lengths(_: int, seed: int) -> None:
    """Print the CPU time of the analysis of one axis; best of three."""
    samples = noise(QUIET, 2_200_000, np.random.default_rng(seed))
    report(samples[:20_000])
    for n in _neighbours():
        seconds = []
        for _ in range(3):
            begin = time.process_time()
            report(samples[:n])
            seconds.append(time.process_time() - begin)
        print(f"| {n} | {min(seconds):.3f} s |", flush=True)


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "table"
    given = [int(text) for text in sys.argv[2:4]]
    every = (table, coverage, clean, filters, cycles, lengths)
    kinds = {kind.__name__: kind for kind in every}
    kinds[what](*given, *(3, 1011)[len(given) :])
