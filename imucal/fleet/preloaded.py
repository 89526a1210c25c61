"""Imports that each log of a fleet needs, once for all logs of a run."""

import importlib

#: Loaded when they are needed: the fit, the report of a log, and the readers of most formats.
_LAZY = (
    "imucal.fitting.moments",
    "imucal.report.page",
    "mcap.reader",
    "polars",
    "rosbags.highlevel",
    "scipy.fft",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.special",
    "imucal.fleet.work",
)

for _name in _LAZY:
    importlib.import_module(_name)
