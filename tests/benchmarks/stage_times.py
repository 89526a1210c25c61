"""Sample the CPU time of the functions in a run of imucal; `bench_job` starts it in a separate process.

    python tests/benchmarks/stage_times.py FOUND.json fit LOG --json …

The stack is sampled about 250 times per second of CPU, and every function in it gets the time since the last
sample. A profiler, which stops at every call, makes Python's own share two to three times as large. It
samples one thread: use IMUCAL_THREADS=1 and --jobs 1. It imports no module that imucal may import.
"""

import signal
import sys
import time
from collections import defaultdict
from types import FrameType

#: CPU time between two samples, in s; the system's clock may make it longer.
_INTERVAL = 0.001


class Sampler:
    """CPU time of each function including its calls, by file and name, in s."""

    def __init__(self) -> None:
        self.seconds: defaultdict[tuple[str, str], float] = defaultdict(float)
        self._last = time.process_time()

    def look(self, _signal: int, frame: FrameType | None) -> None:
        """Add the time since the last sample to all functions of the stack."""
        now = time.process_time()
        seen = set()
        while frame is not None:
            seen.add((frame.f_code.co_filename, frame.f_code.co_name))
            frame = frame.f_back
        for function in seen:
            self.seconds[function] += now - self._last
        self._last = now


def main() -> None:
    """Run the command and write the times."""
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
