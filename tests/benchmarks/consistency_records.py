"""Records of known noise and their fits, stored in a file that another run extends.

There are ten truths and four lengths; the fits are the default ones, with a chosen model.
"""

import pickle
import time
import zlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import numpy as np

import imucal
from imucal import NoiseModel
from imucal.fitting import NoiseFit

__all__ = ["LENGTHS", "TRUTHS", "Record", "fits"]

#: White noise of a consumer gyroscope, in rad/s/sqrt(Hz), with slower noise.
TRUTHS = {
    "N": "N=1e-3",
    "N + K": "N=1e-3 + K=3e-5",
    "N + B": "N=1e-3 + B=3e-4",
    "N + B + K": "N=1e-3 + B=3e-4 + K=3e-5",
    "N + B + K, strong": "N=1e-3 + B=1e-3 + K=2e-4",
    "N + GM, 5 s": "N=1e-3 + GM(sigma=1e-3, T=5)",
    "N + GM, 100 s": "N=1e-3 + GM(sigma=5e-4, T=100)",
    "N + GM, 1000 s": "N=1e-3 + GM(sigma=1e-3, T=1000)",
    "Q + N + B": "Q=3e-4 + N=1e-3 + B=3e-4",
    "N + 2 GM, 2 and 200 s": "N=1e-3 + GM(sigma=4e-4, T=2) + GM(sigma=4e-4, T=200)",
}
#: Duration in s and rate in Hz.
LENGTHS = {"10 min": (600, 10.0), "33 min": (2000, 10.0), "2 h": (7200, 10.0), "11 h": (40_000, 4.0)}


class Record(NamedTuple):
    """Identity of a record: names of truth and length, its number, and the seed of the set."""

    truth: str
    length: str
    number: int
    seed: int

    @property
    def rate_hz(self) -> float:
        """Sampling rate."""
        return LENGTHS[self.length][1]

    @property
    def model(self) -> NoiseModel:
        """True model."""
        return NoiseModel.parse(TRUTHS[self.truth])

    def fit(self) -> tuple[NoiseFit, float]:
        """Return the fit and its CPU seconds."""
        duration_s, rate_hz = LENGTHS[self.length]
        rng = np.random.default_rng(
            [self.seed, zlib.crc32(f"{self.truth} {self.length}".encode()), self.number]
        )
        samples = self.model.simulate(round(duration_s * rate_hz), rate_hz=rate_hz, rng=rng)
        begin = time.process_time()
        series = imucal.AxisSeries.from_samples(samples, rate_hz=rate_hz, sensor="gyroscope", axis="x")
        return imucal.fit(series), time.process_time() - begin


def fits(file: Path, *, count: int, seed: int, jobs: int) -> dict[Record, NoiseFit]:
    """Return the fits of `count` records per cell; missing ones are computed and added to the file."""
    found = dict(_kept(file))
    wanted = [Record(t, n, i, seed) for i in range(count) for n in LENGTHS for t in TRUTHS]
    missing = [record for record in wanted if record not in found]
    seconds = dict.fromkeys(LENGTHS, 0.0)
    with ProcessPoolExecutor(jobs) as pool, file.open("ab") as kept:
        work = {pool.submit(Record.fit, record): record for record in missing}
        for done in as_completed(work):
            record = work.pop(done)
            found[record], spent = done.result()
            seconds[record.length] += spent
            pickle.dump((record, found[record]), kept)
            kept.flush()
    for length, total in seconds.items():
        new = sum(record.length == length for record in missing)
        if new:
            print(f"{new} fits of {length}: {total / new:.2f} CPU s each", flush=True)
    return {record: found[record] for record in wanted}


def _kept(file: Path) -> Iterator[tuple[Record, NoiseFit]]:
    """Yield the stored fits; a killed run may have left an incomplete fit at the end."""
    if not file.exists():
        return
    with file.open("rb") as kept:
        whole = 0
        while True:
            try:
                yield pickle.load(kept)  # noqa: S301 - our own file
                whole = kept.tell()
            except (EOFError, pickle.UnpicklingError):
                break
    with file.open("r+b") as kept:
        kept.truncate(whole)
