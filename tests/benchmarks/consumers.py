"""Table of the values that GTSAM and pymavlink read from exports; it only needs the standard venv module.

``IMUCAL_CONSUMERS=venv42/bin/python:venv43/bin/python python -m tests.benchmarks.consumers``, where the
environments were created by ``pip install 'gtsam==4.2' 'numpy<2'``, ``pip install gtsam==4.3.0``, and
``pip install pymavlink``.
"""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

from imucal.report.exports import export
from tests.consumers.probes import interpreters, probe
from tests.report.downstream import READERS
from tests.report.synthetic import consumer_report


def main() -> None:
    """Print one line per program and number: its value, the fit's value, and their ratio."""
    print(f"{'program':<18} {'after 1 s, or key':<24} {'found':>12} {'expected':>12} {'ratio':>9}")
    with TemporaryDirectory() as folder:
        _gtsam(Path(folder))
        for target in ("px4", "ardupilot"):
            _pymavlink(Path(folder), target)


def _gtsam(folder: Path) -> None:
    (file,) = export(consumer_report(), "gtsam", folder)
    # Variant without the initial covariance of the bias.
    bare = folder / "bare.py"
    bare.write_text(file.read_text().replace("hasattr(params, name)", "False"))
    given = READERS["gtsam"](file)
    gyro = math.hypot(given["gyro", "N"], given["gyro", "K"] / math.sqrt(3))
    accel = math.hypot(given["accel", "N"], given["accel", "K"] / math.sqrt(3))
    for python in interpreters("gtsam"):
        for label, each in (("", file), (" unset", bare)):
            found = probe(python, "gtsam", each)
            name = f"gtsam {found['version']}{label}"
            _line(name, "attitude, rad", found["attitude"][0], gyro)
            _line(name, "velocity z, m/s", found["velocity"][2], accel)


def _pymavlink(folder: Path, target: str) -> None:
    (file,) = export(consumer_report(), target, folder)
    rows = [line.split() for line in file.read_text().splitlines() if line.startswith("EK")]
    for python in interpreters("pymavlink"):
        found = probe(python, "pymavlink", file)
        for name, value in rows:
            _line(f"pymavlink {found['version']}", name, found["parameters"][name], float(value))


def _line(program: str, what: str, found: float, expected: float) -> None:
    print(f"{program:<18} {what:<24} {found:>12.5g} {expected:>12.5g} {found / expected:>9.5g}")


if __name__ == "__main__":
    main()
