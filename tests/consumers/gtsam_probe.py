"""Preintegrate one second of rest with an exported module, in an interpreter that has GTSAM.

``python gtsam_probe.py FILE`` prints the version and the standard deviations as JSON.
"""

import json
import runpy
import sys
from importlib.metadata import version

import gtsam
import numpy as np


def main() -> None:
    """Print the standard deviations of attitude (rad), position (m), velocity (m/s) and bias after 1 s."""
    params = runpy.run_path(sys.argv[1])["imu_params"]()
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias())
    for _ in range(200):
        preintegrated.integrateMeasurement(np.array([0.0, 0.0, 9.80665]), np.zeros(3), 1 / 200)
    deviations = np.sqrt(np.diag(preintegrated.preintMeasCov())).reshape(5, 3)
    names = ("attitude", "position", "velocity", "bias_accel", "bias_gyro")
    found = dict(zip(names, deviations.tolist(), strict=True))
    sys.stdout.write(json.dumps({"version": version("gtsam"), **found}) + "\n")


main()
