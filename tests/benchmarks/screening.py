"""False alarm rate of the screening on logs at rest, by check and kind of noise.

The logs contain a temperature that rises by 2 degrees and is unrelated to the noise. Run as
``python -m tests.benchmarks.screening [LOGS] [SAMPLES]``.
"""

import sys
from collections import Counter

from imucal.pipeline import screen
from tests.screening.still import KINDS, recording, still, unrelated_temperature


def main() -> None:
    """Print the share of logs (not axes) with a warning or an error, by kind and code."""
    logs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    n = int(sys.argv[2]) if len(sys.argv) > 2 else 20_000
    total: Counter[str] = Counter()
    for kind in KINDS:
        counts: Counter[str] = Counter()
        for seed in range(10_000, 10_000 + logs):
            found = screen(recording(*still(n, seed, kind), temperature=unrelated_temperature(n, seed)))
            counts.update({f"{f.code}{'' if f.level != 'info' else ' (info)'}" for f in found})
        total += counts
        print(f"{kind:26s}", ", ".join(f"{c} {k / logs:.1%}" for c, k in counts.most_common()) or "none")
    print(f"{'all':26s}", ", ".join(f"{c} {k / logs / len(KINDS):.2%}" for c, k in total.most_common()))


if __name__ == "__main__":
    main()
