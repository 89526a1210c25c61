"""Random command lines: no bug's exit code, no traceback, no wait, and suggestions that work when typed.

``python -m tests.benchmarks.command_lines --seed 7 --number 500`` runs commands with valid, extreme and
wrong options on sample logs, reports, folders and wrong files in a scratch folder, and prints the exit codes
and the failures. A suggestion is the rest of a line after ``type:``, or a command in backquotes or quotes; it
fails with the exit code 2 or 70, or if it repeats the error that proposed it.
"""

import argparse
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"
#: Longest time of a command, in seconds: a fit of a sample log takes 10 s.
TIMEOUT_S = 90
#: Exit codes in `imucal --help`, except 70.
EXPECTED = {0, 1, 2, 3, 4, 5, 130, 141}

NUMBERS = ("1", "0", "-1", "1e-300", "1e300", "nan", "inf", "100", "0.5", "9" * 400, "", "1,5", "٣", "200")
TEXTS = (
    *("", "x", "g=0:3", "g=0:3,a=3:6", "t=0,g=1:4,a=4:7", "t=9", "gx+gy+gz", "rad/s", "deg/s", "g", "m/s^2"),
    *(
        "ms",
        "log",
        "N=1e-4",
        "N=1e-4 + K=1e-6",
        "N + B + K",
        "kalibr",
        "px4",
        "nosuch",
        "worst",
        "10min",
        "1h",
    ),
    *("\x1b[31m", "a\nb", "%s", "{x}", "../..", "/dev/full", "-", "--", "é", "a" * 3000, "1:2:3", "white=3"),
)
PATHS = (
    *("consumer_mems.mcap", "tactical.bag", "too_short.db3", "with_gaps.csv", "poses.mcap", "truth.json"),
    *(
        "rep",
        "rep/report.json",
        "cal",
        "imu.yaml",
        "limits.toml",
        "empty.csv",
        "binary.bin",
        "folder",
        "nosuch",
    ),
    *("bytes.mcap", "-", "pipe.csv", "/dev/null", "no header.csv", "fleet", "columns.txt"),
)
#: Usual values of options; others get a random text.
USUAL = {
    "--rate": ("100", "200Hz", "50"),
    "--gyro-unit": ("rad/s", "deg/s", "mdeg/s", "rad", "count"),
    "--accel-unit": ("g", "m/s^2", "mg", "m/s", "count"),
    "--gyro-scale": ("1e-3", "1.06e-3"),
    "--accel-scale": ("1e-2", "5.98e-4"),
    "--columns": ("t=0,g=1:4,a=4:7", "g=0:3,a=3:6", "gyro=1:4", "@columns.txt"),
    "--topic": ("/imu", "/imu/data", "imu"),
    "--time": ("log", "header", "stamps", "0"),
    "--time-unit": ("s", "ms", "100ns"),
    "--skip": ("0", "1s", "10s", "1h"),
    "--take": ("5s", "10s", "1min"),
    "--model": ("N", "N + B + K", "auto", "N + B"),
    "--method": ("mle", "gmwm", "slope"),
    "--level": ("0.9", "95%", "0.68"),
    "--format": ("png", "svg", "pdf"),
    "--to": ("kalibr", "openvins", "px4", "gm", "all", "python"),
    "--out": ("out", "out.yaml", "-", "out/", "/dev/full", "rep"),
    "--limits": ("limits.toml", "rep", "imu.yaml"),
    "--config": ("imu.yaml", "cal"),
    "--baseline": ("rep", "tactical.bag"),
    "--noise": ("rep", "tactical.bag", "N=1e-4"),
    "--latitude": ("47.4", "0", "-90"),
    "--height": ("400",),
    "--gravity": ("9.81", "9.8072"),
    "--turns": ("360deg", "90deg+-1deg"),
    "--rest-at-least": ("0.5s", "2s"),
    "--frame": ("kalibr", "nearest"),
    "--apply": ("fixed.csv", "fixed.mcap"),
    "--gyro": ("N=1e-4", "N=1e-4 + B=1e-5"),
    "--accel": ("N=2e-3", "N=2e-3 + K=1e-5"),
    "--duration": ("10min", "1h"),
    "--rests": ("6", "18", "all"),
    "--rest": ("5s", "1s"),
    "--taus": ("octave", "decade:20", "0.1,1,10"),
    "--seed": ("1", "7"),
    "--workers": ("1", "2"),
    "--memory": ("1GB", "500MB"),
    "--timeout": ("1min",),
}  # fmt: skip
LOGS = ("consumer_mems.mcap", "tactical.bag", "with_gaps.csv", "poses.mcap", "no header.csv", "folder")
RESULTS = ("rep", "rep/report.json", "cal", "fleet", "tactical.bag", "N=1e-4", "imu.yaml")
#: Commands that read results rather than logs.
OF_RESULTS = {"export", "check", "compare", "drift", "plan"}
#: Share of usual values and of usual paths.
USUALLY = 0.75
_SUGGESTION = re.compile(r"type:\s+(?P<line>.+)|`(?P<quoted>imucal [^`]+)`|'(?P<single>imucal [^']+)'")


class Outcome(NamedTuple):
    """A command with its exit code, None after a timeout, and the text that it printed."""

    arguments: tuple[str, ...]
    code: int | None
    text: str

    @property
    def failure(self) -> str:
        if self.code is None:
            return "timeout"
        if "Traceback" in self.text:
            return "traceback"
        return "" if self.code in EXPECTED else f"exit {self.code}"


def prepared(folder: Path) -> None:
    """Write logs, a report, a calibration and wrong files."""
    for log in SAMPLE_LOGS.iterdir():
        shutil.copy(log, folder)
    (folder / "empty.csv").touch()
    (folder / "binary.bin").write_bytes(bytes(range(256)) * 40)
    (folder / "bytes.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    rows = "".join(f"{0.01 * i},{i % 7},{i % 5},{i % 3},{i % 2},1,9.81\n" for i in range(3000))
    (folder / "no header.csv").write_text(rows, encoding="utf-8")
    (folder / "columns.txt").write_text("t=0,g=1:4,a=4:7\n", encoding="utf-8")
    (folder / "limits.toml").write_text("[gyro]\nN = { max = 0.3 }\n", encoding="utf-8")
    (folder / "folder").mkdir()
    (folder / "folder" / "a.csv").write_text(rows, encoding="utf-8")
    for arguments in (
        ("fit", "tactical.bag", "-o", "rep", "-q"),
        ("calibrate", "poses.mcap", "-o", "cal", "-q"),
        ("export", "rep", "--to", "kalibr", "-o", "imu.yaml"),
        ("fleet", "run", "tactical.bag", "-o", "fleet", "-q"),
    ):
        run(arguments, folder)


def run(arguments: tuple[str, ...], folder: Path) -> Outcome:
    command = [sys.executable, "-m", "imucal", *arguments]
    try:
        done = subprocess.run(  # noqa: S603 - our own command
            command, cwd=folder, input=b"", capture_output=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return Outcome(arguments, None, "")
    return Outcome(arguments, done.returncode, (done.stdout + done.stderr).decode("utf-8", "replace"))


def options() -> dict[tuple[str, ...], tuple[list[str], list[str]]]:
    """Return the flags and the options with values of each command, from its help."""
    found = {}
    known = ("info", "fit", "export", "check", "plan", "calibrate", "compare", "drift", "adev", "decompose")
    groups = [(name,) for name in (*known, "simulate", "completion")]
    for command in [*groups, ("fleet", "run"), ("fleet", "status"), ("fleet", "report")]:
        help_text = run((*command, "--help"), Path.cwd()).text
        lines = re.findall(r"^  (?:-\w, )?(--[\w-]+)( \S)?", help_text, re.MULTILINE)
        flags = [name for name, value in lines if not value and name != "--help"]
        found[command] = (flags, [name for name, value in lines if value])
    return found


def command_line(
    source: random.Random, known: dict[tuple[str, ...], tuple[list[str], list[str]]]
) -> tuple[str, ...]:
    command = source.choice(list(known))
    flags, valued = known[command]
    usual_paths = RESULTS if command[0] in OF_RESULTS else LOGS
    arguments = [
        source.choice(usual_paths if source.random() < USUALLY else PATHS)
        for _ in range(source.choice((0, 1, 1, 1, 1, 1, 1, 1, 2, 3)))
    ]
    for _ in range(source.choice((0, 0, 1, 1, 2, 3))):
        if flags and source.random() < 0.3:
            arguments.append(source.choice(flags))
        elif valued:
            name = source.choice(valued)
            value = source.choice(source.choice((NUMBERS, TEXTS, PATHS)))
            if name in USUAL and source.random() < USUALLY:
                value = source.choice(USUAL[name])
            arguments += [name, value]
    if source.random() < 0.03:
        source.shuffle(arguments)
    return (*command, *(each.replace("\0", "") for each in arguments))


def suggestions(text: str) -> list[tuple[str, ...]]:
    """Return the commands of imucal that a text proposes, without placeholders in capitals."""
    # Lines of the terminal are wrapped.
    joined = re.sub(r"\s*\n\s+", " ", text)
    lines = [next(filter(None, match.groups())) for match in _SUGGESTION.finditer(joined)]
    found = []
    for line in lines:
        try:
            words = shlex.split(line)
        except ValueError:
            continue
        # The name of a command alone is no suggestion.
        if (
            words[:1] == ["imucal"]
            and len(words) > 2
            and not any(re.fullmatch(r"[A-Z]{2,}|\.\.\.|…", word) for word in words)
        ):
            found.append(tuple(words[1:]))
    return found


def report(seed: int, number: int) -> None:
    source, codes, failures = random.Random(seed), Counter[str](), list[Outcome]()  # noqa: S311 - a benchmark
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        prepared(folder)
        known = options()
        tried = set[tuple[str, ...]]()
        for _ in range(number):
            outcome = run(command_line(source, known), folder)
            codes[str(outcome.code)] += 1
            if outcome.failure:
                failures.append(outcome)
                _show(outcome.failure, outcome)
            for words in suggestions(outcome.text) if outcome.code else ():
                if words in tried:
                    continue
                tried.add(words)
                typed = run(words, folder)
                codes["suggestions"] += 1
                if typed.failure or typed.code == 2 or (typed.code == 3 and typed.text == outcome.text):
                    failures.append(typed)
                    _show(f"suggested by {shlex.join(outcome.arguments)[:200]!r}", typed)
    print(*(f"{code}: {count}" for code, count in sorted(codes.items())), sep=", ")
    print(f"{len(failures)} failures of {number} command lines with seed {seed}")


def _show(why: str, outcome: Outcome) -> None:
    print(
        f"{why}: imucal {shlex.join(outcome.arguments)[:300]}\n    {outcome.text.strip()[-400:]!r}",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--number", type=int, default=500)
    given = parser.parse_args()
    report(given.seed, given.number)
