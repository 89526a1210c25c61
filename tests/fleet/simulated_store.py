"""Stores of simulated fleets: the results of many units without logs."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imucal.fleet.manifest import LABELS
from imucal.fleet.store import AskedLog, RunFile
from imucal.recording import Sensor

#: Settings of the fits.
SETTINGS = {"model": "N + B + K", "level": 0.95}

Z = 1.959963984540054
#: Sensor and term -> SI unit, median, spread between units, relative error.
TERMS = {
    ("gyroscope", "N"): ("rad/s/sqrt(Hz)", 8.7e-5, 0.08, 0.004),
    ("gyroscope", "B"): ("rad/s", 2.4e-5, 0.15, 0.06),
    ("gyroscope", "K"): ("rad/s/sqrt(s)", 1.1e-6, 0.3, 0.5),
    ("accelerometer", "N"): ("m/s^2/sqrt(Hz)", 1.2e-3, 0.05, 0.004),
    ("accelerometer", "B"): ("m/s^2", 2.0e-4, 0.2, 0.05),
    ("accelerometer", "K"): ("m/s^2/sqrt(s)", 2.5e-5, 0.3, 0.3),
}
#: Relative change of a unit's coefficient per °C and per year.
PER_C, PER_YEAR = 0.003, 0.02


def write_store(
    folder: Path,
    *,
    units: int = 24,
    models: Sequence[str] = ("ACME-6",),
    temperatures: Sequence[float] = (10.0, 25.0, 45.0, 25.0),
    labelled: bool = True,
    seed: int = 1,
    weak: str = "x",
    special: bool = True,
    failures: bool = True,
    times: Sequence[float | None] = (),
    absent: str = "",
    names: Sequence[str] = (),
) -> Path:
    """Write the store of a fleet and return its folder.

    If `special`, unit 7 is odd in gyro_z N, and the logs of unit 2 differ in gyro_x N. Only K of the
    gyroscope's axes in `weak` is weak. No log detects K of the gyroscope's axes in `absent`. With `names`,
    such as gyro_x, the logs have only these axes. With `times`, gyro_x has a Gauss-Markov term with these
    correlation times in turn.
    """
    rng = np.random.default_rng(seed)
    logs: list[dict[str, Any]] = []
    for number, model in enumerate(models):
        for unit in range(units):
            own = {
                (s, a, t): rng.standard_normal() * TERMS[s, t][2] + 0.4 * number
                for s, t in TERMS
                for a in "xyz"
            }
            if special and unit == 7:
                own["gyroscope", "z", "N"] += 0.8
            for place, celsius in enumerate(temperatures):
                path = (
                    f"logs/{model}/u{unit:02}/{place}-{celsius:g}C.mcap"
                    if labelled
                    else f"logs/{number}-{unit}-{place}.mcap"
                )
                key = f"{number:02}{unit:04}{place:02}"
                row = _log(key, path, model, f"u{unit:02}" if labelled else None, celsius, place)
                changed = {**own}
                if special and unit == 2 and place == 1:
                    changed["gyroscope", "x", "N"] += 1.0
                row["terms"] = [
                    _hidden(value, absent)
                    for value in _results(rng, changed, celsius, place, weak)
                    if not names or f"{Sensor(value['sensor']).short}_{value['axis']}" in names
                ]
                logs.append(row)
                if times:
                    row["terms"].append(_markov(rng, times[len(logs) % len(times)]))
    if failures:
        logs += _failures(models[0])
    with RunFile(folder, SETTINGS, [asked(log["path"], log) for log in logs]) as file:
        for log in logs:
            file.add(log)
    return folder


def asked(path: str, labels: Mapping[str, Any] | None = None, *, copy_of: str | None = None) -> AskedLog:
    """Return a requested log with the labels of its row."""
    known = {name: labels[name] for name in LABELS if labels and labels.get(name) is not None}
    return AskedLog(path=path, labels=known, reading={}, copy_of=copy_of)


def _log(  # noqa: PLR0917
    key: str, path: str, model: str, unit: str | None, celsius: float, place: int
) -> dict[str, Any]:
    return {
        "key": key,
        "identity": key,
        "path": path,
        "model": model or None,
        "unit": unit,
        "temperature_c": celsius,
        "started": f"202{2 + place}-03-01T10:00:00+00:00",
        "status": "ok",
        "reason": "",
        "code": "",
        "verdict": "good",
        "findings": [],
        "samples": 720_000,
        "seconds": 3600.0,
        "rate_hz": 200.0,
        "bytes": 40_000_000,
        "cpu_s": 2.5,
        "wall_s": 2.6,
        "finished": 1.0,
        "report": "",
        "version": "test",
        "terms": [],
    }


def _results(
    rng: np.random.Generator,
    own: dict[tuple[str, str, str], float],
    celsius: float,
    place: int,
    weak: str,
) -> list[dict[str, Any]]:
    rows = []
    for (sensor, axis, term), level in own.items():
        unit, median, _, error = TERMS[sensor, term]
        moved = level + PER_C * (celsius - 25) + PER_YEAR * place
        rows.append(
            {
                "sensor": sensor,
                "axis": axis,
                "term": term,
                "unit_si": unit,
                "level": 0.95,
                **_drawn(rng, median * math.exp(moved), _error(sensor, axis, error, weak), median=median),
            }
        )
    return rows


def _hidden(row: dict[str, Any], absent: str) -> dict[str, Any]:
    if (row["sensor"], row["term"]) != ("gyroscope", "K") or row["axis"] not in absent:
        return row
    return {
        **row,
        "value": None,
        "low": 0.0,
        "high": 4e-6,
        "variance": -1e-12,
        "variance_sd": 8e-12,
        "variance_growth": 0.0,
    }


def _markov(rng: np.random.Generator, time: float | None) -> dict[str, Any]:
    """Return a row of a Gauss-Markov term of gyro_x, of 3e-5 rad/s."""
    row = {"sensor": "gyroscope", "axis": "x", "term": "GM", "unit_si": "rad/s", "level": 0.95}
    return {**row, **_drawn(rng, 3e-5, (0.1, False), median=3e-5), "correlation_time": time}


def _error(sensor: str, axis: str, error: float, weak: str) -> tuple[float, bool]:
    """Return the error of a term and whether it is weak, as K of the gyroscope's axes in `weak`."""
    if error < 0.3:
        return error, False
    return (error, True) if sensor == "gyroscope" and axis in weak else (0.1, False)


def _drawn(
    rng: np.random.Generator,
    truth: float,
    precision: tuple[float, bool],
    *,
    median: float,
) -> dict[str, float | None]:
    error, weak = precision
    if not weak:
        value = truth * math.exp(error * rng.standard_normal())
        low, high = value * math.exp(-Z * error), value * math.exp(Z * error)
        return {
            "value": value,
            "low": low,
            "high": high,
            "variance": None,
            "variance_sd": None,
            "variance_growth": None,
            "correlation_time": None,
        }
    sd = error * median**2
    square = truth**2 + sd * rng.standard_normal()
    detected = square > Z * sd
    return {
        "value": math.sqrt(square) if detected else None,
        "low": math.sqrt(square - Z * sd) if detected else 0.0,
        "high": math.sqrt(max(square, 0.0) + Z * sd),
        "variance": square,
        "variance_sd": sd,
        "variance_growth": 0.0,
        "correlation_time": None,
    }


def _failures(model: str) -> list[dict[str, Any]]:
    def failed(name: str, status: str, reason: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401
        row = _log(f"f{name}", f"logs/{model}/{name}", model, "u90", 25.0, 0)
        return (
            row | {"status": status, "reason": reason, "verdict": "", "seconds": None, "rate_hz": None} | more
        )

    one, other = (f"the file is damaged: no footer after byte {n}" for n in (12, 99))
    return [
        failed("u90/a.mcap", "unreadable", one, code="no-footer", report="reports/fa"),
        failed("u91/b.mcap", "unreadable", other, code="no-footer", report="reports/fb"),
        failed("u92/c.mcap", "timeout", "took longer than 600 s"),
        failed("u93/d.mcap", "memory", "needed more than 2 GB"),
        failed("u94/e.mcap", "ok", "", verdict="not-noise", findings=["motion", "touch"], seconds=60.0),
    ]
