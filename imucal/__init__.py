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

The public names are loaded on first use (as PEP 562 does).
"""

import importlib
from typing import TYPE_CHECKING

from imucal._version import __version__
from imucal.resources import limit_pools

if TYPE_CHECKING:
    from imucal.allan import AllanCurve, Spectrum, allan_curve, spectrum
    from imucal.calibration import Calibration, calibrate
    from imucal.calibration.applying import apply
    from imucal.calibration.intrinsics_files import load_calibration
    from imucal.clock import Clock
    from imucal.comparison import compare
    from imucal.errors import ChoiceError, DataError, ImucalError, ReadError, WriteError
    from imucal.facade import check, export, fit, info, sensor, simulate
    from imucal.findings import Finding
    from imucal.fitting.decomposition import Decomposition, decompose
    from imucal.fitting.noise_fit import NoiseFit
    from imucal.fleet.as_report import check_fleet, fleet_as_report
    from imucal.fleet.files import write_fleet
    from imucal.fleet.population import Population, population
    from imucal.fleet.running import run_fleet
    from imucal.fleet.summary import Fleet, FleetTerm, SensorModel, load_fleet
    from imucal.fleet.values import LogValue, log_values
    from imucal.grading import NoiseVerdict
    from imucal.noise import NoiseModel
    from imucal.noise.integrals import avar_from_acvf, avar_from_psd
    from imucal.pipeline import Settings, characterize, screen
    from imucal.planning import plan
    from imucal.prediction import Drift, FilterNumbers, drift, filter_numbers
    from imucal.readers import read
    from imucal.recording import AxisSeries, Recording, Sensor
    from imucal.report import AxisReport, Report, load_report, write_report
    from imucal.report.given import model_as_report, part_as_report
    from imucal.report.plotting import plot
    from imucal.rests import at_rest
    from imucal.sensors import Part

__all__ = [
    "AllanCurve", "AxisReport", "AxisSeries", "Calibration", "ChoiceError", "Clock", "DataError",
    "Decomposition", "Drift", "FilterNumbers", "Finding", "Fleet", "FleetTerm", "ImucalError", "LogValue",
    "NoiseFit", "NoiseModel", "NoiseVerdict", "Part", "Population", "ReadError", "Recording", "Report",
    "Sensor", "SensorModel", "Settings", "Spectrum", "WriteError", "__version__", "allan_curve", "apply",
    "at_rest", "avar_from_acvf", "avar_from_psd", "calibrate", "characterize", "check", "check_fleet",
    "compare", "decompose", "drift", "export", "filter_numbers", "fit", "fleet_as_report", "info",
    "load_calibration", "load_fleet", "load_report", "log_values", "model_as_report", "part_as_report",
    "plan", "plot", "population", "read", "run_fleet", "screen", "sensor", "simulate", "spectrum",
    "write_fleet", "write_report",
]  # fmt: skip

_HOMES = {
    "allan": "AllanCurve Spectrum allan_curve spectrum",
    "calibration": "Calibration calibrate",
    "calibration.applying": "apply",
    "calibration.intrinsics_files": "load_calibration",
    "clock": "Clock",
    "comparison": "compare",
    "errors": "ChoiceError DataError ImucalError ReadError WriteError",
    "findings": "Finding",
    "facade": "check export fit info sensor simulate",
    "fitting": "NoiseFit",
    "fitting.decomposition": "Decomposition decompose",
    "fleet.as_report": "check_fleet fleet_as_report",
    "fleet.files": "write_fleet",
    "fleet.population": "Population population",
    "fleet.running": "run_fleet",
    "fleet.summary": "Fleet FleetTerm SensorModel load_fleet",
    "fleet.values": "LogValue log_values",
    "grading": "NoiseVerdict",
    "noise": "NoiseModel",
    "noise.integrals": "avar_from_acvf avar_from_psd",
    "pipeline": "Settings characterize screen",
    "planning": "plan",
    "prediction": "Drift FilterNumbers drift filter_numbers",
    "readers": "read",
    "recording": "AxisSeries Recording Sensor",
    "rests": "at_rest",
    "report": "AxisReport Report load_report write_report",
    "report.given": "model_as_report part_as_report",
    "report.plotting": "plot",
    "sensors": "Part",
}

# Now, because libraries read the number of threads only once.
limit_pools()


def __getattr__(name: str) -> object:
    for module, names in _HOMES.items():
        if name in names.split():
            value: object = getattr(importlib.import_module(f"imucal.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'imucal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
