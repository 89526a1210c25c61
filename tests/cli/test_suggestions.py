"""The suggested --skip and --take work when they are typed, and leave out every disturbance."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import run
from tests.slow_cases import first_by_default

RATE = 25.0
#: White noise of the axes, in SI.
NOISE = np.array([1e-3] * 3 + [2e-2] * 3)
OPTIONS = ("--no-report", "--model", "N")
SUGGESTED = re.compile(r"(?:--skip ([\d.]+)s )?--take ([\d.]+)s")


@dataclass(frozen=True)
class Log:
    """A log of a certain length with disturbances (start and end in s), and the typed --skip."""

    rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    length_s: float
    disturbed: list[tuple[float, float]]
    skip_s: float

    def longest_rest_s(self) -> float:
        """Return the longest time without a disturbance in the part that is read."""
        ends = [(self.skip_s, self.skip_s), *self.disturbed, (self.length_s, self.length_s)]
        ends = sorted((max(a, self.skip_s), max(b, self.skip_s)) for a, b in ends)
        rests, last = [], self.skip_s
        for start, end in ends:
            rests.append(start - last)
            last = max(last, end)
        return max(rests)

    def disturbance_is_read(self) -> bool:
        return any(end > self.skip_s + 1 for _, end in self.disturbed)


def drawn(seed: int) -> Log:
    """Draw a log with one or two shakes, knocks, jumps or turns; half of the logs are skipped into."""
    rng = np.random.default_rng([seed, 4077])
    length = float(rng.integers(100, 300))
    t = np.arange(round(length * RATE)) / RATE
    values = rng.standard_normal((t.size, 6)) * NOISE
    angle, disturbed = np.zeros(t.size), []
    for _ in range(rng.integers(1, 3)):
        kind = rng.choice(["shake", "knock", "jump", "turn"])
        start = float(rng.uniform(0, length - 1))
        if kind == "jump":
            values[t >= start] += rng.choice([-1, 1], 6) * NOISE * rng.uniform(6, 20)
            end = start
        else:
            end = min(start + {"shake": rng.uniform(1, 25), "knock": 0.3, "turn": 1.5}[kind], length)
            during = (t >= start) & (t < end)
            values[during] += rng.standard_normal((during.sum(), 6)) * NOISE * rng.uniform(10, 200)
            if kind == "turn":
                angle[t >= start] += np.radians(rng.uniform(3, 90))
        disturbed.append((start, end))
    values[:, 3] += 9.81 * np.sin(angle)
    values[:, 5] += 9.81 * np.cos(angle)
    skip = round(float(rng.uniform(0, length / 2)), 1) if rng.random() < 0.5 else 0.0
    return Log(np.column_stack([t, values]), length, disturbed, skip)


def written(log: Log, path: Path, *, gyroscope: bool) -> None:
    """Write the log; without the gyroscope it is fitted in half the time, and shows the same disturbances."""
    head = ["t [s]", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]", "ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"]
    columns = [*range(7)] if gyroscope else [0, 4, 5, 6]
    header = ",".join(head[k] for k in columns)
    np.savetxt(path, log.rows[:, columns], delimiter=",", fmt="%.9g", header=header, comments="")


def suggestions(text: str) -> set[tuple[float, float]]:
    """Return the parts that a command suggests, as start and end."""
    flat = " ".join(text.split())
    return {(float(a or 0), float(a or 0) + float(b)) for a, b in SUGGESTED.findall(flat)}


@pytest.mark.parametrize("seed", first_by_default(range(120), 4))
def test_a_suggestion_works_and_holds_no_disturbance(seed: int, tmp_path: Path) -> None:
    """One part is suggested wherever there is one; typed, it gives code 0 and is not suggested again."""
    log = drawn(seed)
    written(log, tmp_path / "log.csv", gyroscope=seed % 6 == 0)
    typed = ("--skip", f"{log.skip_s}s") if log.skip_s else ()
    done = run("fit", "log.csv", *OPTIONS, *typed, cwd=tmp_path)
    found = suggestions(done.stderr)
    # Two seconds of each rest are lost on both sides of a disturbance.
    long_enough = min(30.0, (log.length_s - log.skip_s) / 2) + 8.0
    if log.disturbance_is_read() and log.longest_rest_s() > long_enough and done.returncode == 4:
        assert found or "--rests" in done.stderr, done.stderr
    assert len(found) <= 1
    for start, end in found:
        assert start >= log.skip_s
        assert (start, end) != (log.skip_s, log.length_s)
        for first, last in log.disturbed:
            assert last <= start or first >= end
        options = ("--skip", f"{start}s", "--take", f"{end - start:.1f}s")
        again = run("fit", "log.csv", *OPTIONS, *options, cwd=tmp_path)
        assert again.returncode == 0, again.stderr
        assert (start, end) not in suggestions(again.stderr)
    if "with --rests" in done.stderr:
        again = run("fit", "log.csv", *OPTIONS, *typed, "--rests", cwd=tmp_path)
        assert again.returncode == 0, again.stderr
