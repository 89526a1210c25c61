"""imucal: noise models of IMUs from a recording at rest, with honest intervals.

Units are SI everywhere: rad/s and m/s² for samples; N in rad/s/√Hz, B in rad/s, K in rad/s/√s,
Q in rad, R in rad/s² (m/s² in place of rad/s for an accelerometer). Coefficients are continuous
and two-sided: the Allan deviation of N reads N at tau = 1 s, that of K reads K at tau = 3 s.
Deviations and intervals are of the rate signal; times are in s, rates in Hz.

    recording = imucal.read("log.mcap")
    report = imucal.characterize(recording)
    imucal.write_report(report, "out")

The public names are loaded on first use (as PEP 562 does).
"""

import importlib
from typing import TYPE_CHECKING

from imucal._version import __version__

if TYPE_CHECKING:
    from imucal.allan import AllanCurve, Spectrum, allan_curve, spectrum
    from imucal.clock import Clock
    from imucal.comparison import compare
    from imucal.errors import ChoiceError, DataError, ImucalError, ReadError, WriteError
    from imucal.findings import Finding
    from imucal.fitting import fit
    from imucal.fitting.noise_fit import NoiseFit
    from imucal.noise import NoiseModel
    from imucal.pipeline import Settings, characterize
    from imucal.planning import plan
    from imucal.readers import read
    from imucal.recording import AxisSeries, Recording, Sensor
    from imucal.report import AxisReport, Report, load_report, write_report
    from imucal.report.exports import export
    from imucal.screening import screen

__all__ = [
    "AllanCurve",
    "AxisReport",
    "AxisSeries",
    "ChoiceError",
    "Clock",
    "DataError",
    "Finding",
    "ImucalError",
    "NoiseFit",
    "NoiseModel",
    "ReadError",
    "Recording",
    "Report",
    "Sensor",
    "Settings",
    "Spectrum",
    "WriteError",
    "__version__",
    "allan_curve",
    "characterize",
    "compare",
    "export",
    "fit",
    "load_report",
    "plan",
    "read",
    "screen",
    "spectrum",
    "write_report",
]

#: Public name -> module it is loaded from (PEP 562).
_HOMES = {
    "AllanCurve": "imucal.allan",
    "AxisReport": "imucal.report",
    "AxisSeries": "imucal.recording",
    "ChoiceError": "imucal.errors",
    "Clock": "imucal.clock",
    "DataError": "imucal.errors",
    "Finding": "imucal.findings",
    "ImucalError": "imucal.errors",
    "NoiseFit": "imucal.fitting.noise_fit",
    "NoiseModel": "imucal.noise",
    "ReadError": "imucal.errors",
    "Recording": "imucal.recording",
    "Report": "imucal.report",
    "Sensor": "imucal.recording",
    "Settings": "imucal.pipeline",
    "Spectrum": "imucal.allan",
    "WriteError": "imucal.errors",
    "allan_curve": "imucal.allan",
    "characterize": "imucal.pipeline",
    "compare": "imucal.comparison",
    "export": "imucal.report.exports",
    "fit": "imucal.fitting",
    "load_report": "imucal.report",
    "plan": "imucal.planning",
    "read": "imucal.readers",
    "screen": "imucal.screening",
    "spectrum": "imucal.allan",
    "write_report": "imucal.report",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        msg = f"module 'imucal' has no attribute {name!r}"
        raise AttributeError(msg)
    value: object = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
