"""Sample where a run of imucal spends its CPU time; `bench_job` calls it in a process of its own.

    python tests/benchmarks/stage_times.py FOUND.json fit LOG --json …

Some 250 times a second of CPU the stack is looked at, and every function in it is given the time since the
last look. A profiler, which stops at every call, makes Python's own share two to three times as large. It
sees one thread: say IMUCAL_THREADS=1 and --jobs 1. Nothing is imported that imucal may import.
"""

import signal
import sys
import time
from collections import defaultdict
from types import FrameType

#: CPU time between two looks, in s; the system's clock may make it longer.
_INTERVAL = 0.001


class Sampler:
    """CPU time of each function, with what it calls, by file and name, in s."""

    def __init__(self) -> None:
        self.seconds: defaultdict[tuple[str, str], float] = defaultdict(float)
        self._last = time.process_time()

    def look(self, _signal: int, frame: FrameType | None) -> None:
        """Give the time since the last look to all functions of the stack."""
        now = time.process_time()
        seen = set()
        while frame is not None:
            seen.add((frame.f_code.co_filename, frame.f_code.co_name))
            frame = frame.f_back
        for function in seen:
            self.seconds[function] += now - self._last
        self._last = now


def main() -> None:
    """Run the command and write what was found."""
    found, *arguments = sys.argv[1:]
    sampler = Sampler()
    signal.signal(signal.SIGPROF, sampler.look)
    signal.setitimer(signal.ITIMER_PROF, _INTERVAL, _INTERVAL)
    try:
        from imucal.cli import main as imucal

        imucal(arguments)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        import json
        from pathlib import Path

        every = [[*function, seconds] for function, seconds in sampler.seconds.items()]
        Path(found).write_text(json.dumps(every), encoding="utf-8")


if __name__ == "__main__":
    main()
