"""GTSAM: ``PreintegrationCombinedParams`` as a Python module to import or paste.

Continuous covariances: GTSAM divides by dt itself. With the C++ library the setters have the same
names. GTSAM 4.2 adds the covariance of the bias at the start of each integration, the identity if it
isn't set, which drowns the sensor's own noise; 4.3 has no such setter. It is set to zero where it
exists: the bias's own uncertainty is the estimator's to carry.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import DENSITY_SQUARED, Entry, KeyedBody, Target, four, lines, real
from imucal.units import G0

#: Covariance of the integration itself: GTSAM's own default of 1 would drown the sensor's.
_INTEGRATION = 1e-8

_KEYS = four(
    "accelerometerCovariance biasAccCovariance gyroscopeCovariance biasOmegaCovariance", DENSITY_SQUARED
)

_HEAD = '''

def imu_params(gravity: float = {gravity}) -> gtsam.PreintegrationCombinedParams:
    """Return the parameters for a navigation frame whose z axis points up."""
    identity = np.eye(3)
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(gravity)'''
_TAIL = """    params.setIntegrationCovariance(integrationCovariance * identity)
    # GTSAM 4.2 and earlier: the identity by default, which drowns the noise above.
    for name in ("setBiasAccOmegaInit", "setBiasAccOmegaInt"):
        if hasattr(params, name):
            getattr(params, name)(np.zeros((6, 6)))
    return params"""


def _text(numbers: Numbers, found: list[Entry]) -> list[str]:
    return [
        "",
        "import gtsam",
        "import numpy as np",
        "",
        *lines(found, "{name} = {value}  # {remark}"),
        f"integrationCovariance = {real(_INTEGRATION)}  # of the integration's rounding, not of the sensor",
        *_correlation_times(numbers),
        _HEAD.format(gravity=real(G0)),
        *(f"    params.set{e.name[0].upper()}{e.name[1:]}({e.name} * identity)" for e in found),
        _TAIL,
    ]


def _correlation_times(numbers: Numbers) -> list[str]:
    """Return the correlation times of Gauss-Markov biases, for versions and forks of GTSAM that have them."""
    said = []
    for key, sensor in (("tauAcc", Sensor.ACCELEROMETER), ("tauGyro", Sensor.GYROSCOPE)):
        axes = numbers.report.by_sensor.get(sensor, ())
        found = [(term[1], axis.name) for axis in axes if (term := numbers.gauss_markov(axis))]
        if found:
            time, name = max(found)
            said.append(f"{key} = {real(time)}  # s, Gauss-Markov bias of {name}; unused by the walk below")
    return said


TARGETS = (
    Target(
        name="gtsam",
        title="GTSAM PreintegrationCombinedParams (Python)",
        file_name="gtsam_imu_params.py",
        heading="GTSAM PreintegrationCombinedParams",
        source="source: gtsam/navigation/PreintegrationCombinedParams.h; run: gtsam 4.2 and 4.3",
        kind="continuous-time covariances (densities squared), SI; GTSAM makes them discrete with dt",
        formulas=("covariance = N^2, bias covariance = K^2, each times the identity; no factor of the rate",),
        body=KeyedBody(_KEYS, _text),
        carries="N K GM",
    ),
)
