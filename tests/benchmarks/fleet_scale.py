"""Cost of loading a large fleet: ``python -m tests.benchmarks.fleet_scale [--units 100] [--warm]``.

It fits a few records and writes a store of many units with three logs of six axes each. It then prints CPU,
time and memory of `imucal.load_fleet` in separate processes: first without stored answers, then with them.
``--warm`` stores the answers of one unit and of eight units for all questions, so that the answers of a
large fleet need not be computed.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

import imucal
from imucal.fitting.bins import pack
from imucal.fleet.store import MANIFEST, OF_VALUE, FleetStore
from imucal.fleet_report import answers

AXES = [(sensor, axis) for sensor in ("gyroscope", "accelerometer") for axis in "xyz"]
#: Fits from which the store's logs are drawn, and logs per part.
FITS, BATCH = 36, 24


def make_store(folder: Path, *, units: int, seed: int) -> FleetStore:
    """Write the store of a fleet with three logs per unit, at three temperatures."""
    rng = np.random.default_rng(seed)
    fits = []
    for _ in range(FITS):
        model = imucal.NoiseModel.parse(f"N={1e-4 * np.exp(0.1 * rng.standard_normal())} + K=3e-5")
        samples = model.simulate(4000, rate_hz=100.0, rng=rng)
        fit = imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=100.0), model="N + B + K")
        fits.append((pack(fit.bins), imucal.log_values("", fit)) if fit.bins else None)
    store = FleetStore(folder)
    store.create()
    store.keep_settings({"model": "N + B + K", "level": 0.95})
    logs = [_log(number, celsius) for number in range(units) for celsius in (10.0, 25.0, 45.0)]
    for first in range(0, len(logs), BATCH):
        results: list[dict[str, Any]] = []
        bins: list[dict[str, Any]] = []
        for log in logs[first : first + BATCH]:
            for sensor, axis in AXES:
                packed, values = fits[int(rng.integers(FITS))] or (b"", {})
                where = {"key": log["key"], "sensor": sensor, "axis": axis}
                bins.append({**where, "bins": packed})
                for term, value in values.items():
                    labels_of_log = {name: getattr(value, name) for name in OF_VALUE}
                    results.append({**where, "term": term, "unit_si": "1", **labels_of_log})
        store.commit(logs[first : first + BATCH], results, bins)
    store.add_to_manifest(
        pl.DataFrame([[log.get(name) for name in MANIFEST] for log in logs], schema=MANIFEST, orient="row")
    )
    return store


def _log(number: int, celsius: float) -> dict[str, Any]:
    unit = f"u{number:05}"
    key = f"{unit}-{celsius:g}"
    labels = {"model": "ACME-6", "unit": unit, "temperature_c": celsius, "started": "2026-03-01"}
    labels_of_log = {"status": "ok", "verdict": "good", "findings": [], "seconds": 40.0, "rate_hz": 100.0}
    return {
        "key": key,
        "content": key,
        "path": f"logs/{unit}/{celsius:g}.mcap",
        "finished": 1.0,
        **labels,
        **labels_of_log,
    }


def answer_by_one(store: FleetStore) -> None:
    """Store one unit's answers for every unit's questions, and those of eight units for every term's."""
    known: dict[str, Any] = {}

    def ask(questions: Any) -> list[str]:  # noqa: ANN401 - a list of questions
        texts = []
        for one in questions:
            kind = type(one).__name__
            if kind not in known:
                small = one if kind == "UnitQuestion" else _of_few(one)
                known[kind] = asdict(small.answer())
            entry = known[kind]
            if kind == "TermQuestion":
                every = dict.fromkeys(one.logs.rows["unit"])
                few = entry["population"]["units"]
                units = [{**few[i % len(few)], "unit": unit} for i, unit in enumerate(every)]
                entry = {**entry, "population": {**entry["population"], "units": units}}
            texts.append(json.dumps(entry))
        return texts

    imucal.load_fleet(store.folder, ask=ask)


def _of_few(question: answers.TermQuestion) -> answers.TermQuestion:
    few = answers.LogRows(question.logs.rows.head(24))
    return answers.TermQuestion(logs=few, content=question.content, confidence=question.confidence)


def load(folder: Path) -> None:
    """Print the cost of loading a fleet; runs in a separate process."""
    begun, wall = time.process_time(), time.perf_counter()
    fleet = imucal.load_fleet(folder)
    used, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(
        f"{len(fleet.logs)} logs: {time.process_time() - begun:.1f} s of CPU and "
        f"{children.ru_utime + children.ru_stime:.1f} s of other processes, "
        f"{time.perf_counter() - wall:.1f} s, at most {used.ru_maxrss / 1e3:.0f} MB",
        flush=True,
    )


def main() -> None:
    """Write the fleet and load it twice."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--warm", action="store_true")
    parser.add_argument("--seed", type=int, default=8601)
    parser.add_argument("--load", type=Path)
    given = parser.parse_args()
    if given.load:
        load(given.load)
        return
    with tempfile.TemporaryDirectory() as name:
        store = make_store(Path(name) / "fleet", units=given.units, seed=given.seed)
        if given.warm:
            answer_by_one(store)
        again = [sys.executable, "-m", "tests.benchmarks.fleet_scale", "--load", str(store.folder)]
        for _ in range(1 if given.warm else 2):
            subprocess.run(again, check=True)  # noqa: S603 - this very script
        for command in (
            ["compare", str(store.folder), str(store.folder)],
            ["fleet", "status", str(store.folder)],
        ):
            begun = time.perf_counter()
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-m", "imucal", *command], check=True, capture_output=True)  # noqa: S603
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"imucal {command[0]}: {cpu:.1f} s of CPU, {time.perf_counter() - begun:.1f} s", flush=True)


if __name__ == "__main__":
    main()
