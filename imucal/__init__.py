"""imucal: noise models of IMUs from a recording at rest, with honest intervals.

Units are SI everywhere: rad/s and m/s² for samples; N in rad/s/√Hz, B in rad/s, K in rad/s/√s,
Q in rad, R in rad/s² (m/s² in place of rad/s for an accelerometer). Coefficients are continuous
and two-sided: the Allan deviation of N reads N at tau = 1 s, that of K reads K at tau = 3 s.
Deviations and intervals are of the rate signal; times are in s, rates in Hz.

    recording = imucal.read("log.mcap").skip("60s")
    report = imucal.fit(recording)
    imucal.plot(report)
    imucal.write_report(report, "out")
    imucal.export(report, "kalibr", "imu.yaml")

`docs/python.md` has an example of each public name. They are loaded on first use (as PEP 562 does).
"""

import importlib
from typing import TYPE_CHECKING

from imucal._version import __version__
from imucal.resources import limit_pools

if TYPE_CHECKING:
    from imucal.allan import allan_curve
    from imucal.calibration import calibrate
    from imucal.calibration.intrinsics_files import load_calibration
    from imucal.comparison import compare
    from imucal.errors import ImucalError
    from imucal.facade import apply, check, doctor, export, fit, info, sensor, simulate, thermal
    from imucal.fitting.decomposition import decompose
    from imucal.fleet.running import run_fleet
    from imucal.fleet.summary import load_fleet
    from imucal.noise import NoiseModel
    from imucal.planning import plan
    from imucal.prediction import drift
    from imucal.readers import read
    from imucal.recording import AxisSeries, Recording
    from imucal.report import Report, load_report, write_report
    from imucal.report.plotting import plot
    from imucal.rests import at_rest

__all__ = [
    "AxisSeries",
    "ImucalError",
    "NoiseModel",
    "Recording",
    "Report",
    "__version__",
    "allan_curve",
    "apply",
    "at_rest",
    "calibrate",
    "check",
    "compare",
    "decompose",
    "doctor",
    "drift",
    "export",
    "fit",
    "info",
    "load_calibration",
    "load_fleet",
    "load_report",
    "plan",
    "plot",
    "read",
    "run_fleet",
    "sensor",
    "simulate",
    "thermal",
    "write_report",
]

#: Public name -> the module that defines it.
_HOMES = {
    "AxisSeries": "recording",
    "ImucalError": "errors",
    "NoiseModel": "noise",
    "Recording": "recording",
    "Report": "report",
    "allan_curve": "allan",
    "apply": "facade",
    "at_rest": "rests",
    "calibrate": "calibration",
    "check": "facade",
    "compare": "comparison",
    "decompose": "fitting.decomposition",
    "doctor": "facade",
    "drift": "prediction",
    "export": "facade",
    "fit": "facade",
    "info": "facade",
    "load_calibration": "calibration.intrinsics_files",
    "load_fleet": "fleet.summary",
    "load_report": "report",
    "plan": "planning",
    "plot": "report.plotting",
    "read": "readers",
    "run_fleet": "fleet.running",
    "sensor": "facade",
    "simulate": "facade",
    "thermal": "facade",
    "write_report": "report",
}

# Now, because libraries read the number of threads only once.
limit_pools()


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'imucal' has no attribute {name!r}")
    value: object = getattr(importlib.import_module(f"imucal.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
