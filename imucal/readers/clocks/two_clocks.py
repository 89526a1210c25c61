"""Header stamps against log time: the delay between them, and whether the clocks agree on a second."""

import numpy as np

from imucal.arrays import IntArray
from imucal.findings import Finding

#: Samples looked at, evenly spread.
_MOST = 100_000
#: Shortest log whose clocks are compared, in s, and difference worth a word, as a fraction.
_SHORTEST, _DRIFT = 60.0, 5e-4


def compare_clocks(stamps: IntArray, log: IntArray) -> list[Finding]:
    """Return findings about the delay of recording and the ratio of the two clocks."""
    if stamps.size < 2 or not log.any() or np.array_equal(stamps, log):
        return []
    step = max(stamps.size // _MOST, 1)
    some, recorded = stamps[::step], log[::step]
    delay = (recorded - some) / 1e9
    median, most = float(np.median(delay)), float(delay.max())
    text = f"Messages were recorded {median * 1e3:.4g} ms after their stamps, at most {most * 1e3:.4g} ms."
    if abs(median) > 86_400:
        text = f"Stamps and log time count from different times: {median:.6g} s apart."
    findings = [Finding(level="info", code="delay", text=text)]
    own, other = (int(some[-1]) - int(some[0])) / 1e9, (int(recorded[-1]) - int(recorded[0])) / 1e9
    if min(own, other) > _SHORTEST and abs(own / other - 1) > _DRIFT:
        ratio = f"{own / other - 1:+.2%}"
        text = f"The stamps span {own:.6g} s, the log time {other:.6g} s: the clocks differ by {ratio}."
        findings.append(Finding(level="warning", code="clocks-differ", text=text))
    return findings
