"""GTSAM: ``PreintegrationCombinedParams`` as a Python module to import or paste.

Continuous covariances: GTSAM divides by dt itself. With the C++ library the setters have the same
names. Source: GTSAM, ``gtsam/navigation/PreintegrationCombinedParams.h``.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, real
from imucal.units import G0

#: Covariance of the integration itself: GTSAM's own default of 1 would drown the sensor's.
_INTEGRATION = 1e-8

_FUNCTION = '''

def imu_params(gravity: float = {gravity}) -> gtsam.PreintegrationCombinedParams:
    """Return the parameters for a navigation frame whose z axis points up."""
    identity = np.eye(3)
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(gravity)
    params.setAccelerometerCovariance(accelerometerCovariance * identity)
    params.setGyroscopeCovariance(gyroscopeCovariance * identity)
    params.setIntegrationCovariance(integrationCovariance * identity)
    params.setBiasAccCovariance(biasAccCovariance * identity)
    params.setBiasOmegaCovariance(biasOmegaCovariance * identity)
    return params
'''


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    lines = [
        "",
        "import gtsam",
        "import numpy as np",
        "",
        _assignment("accelerometerCovariance", values.accel_n, "(m/s^2)^2/Hz"),
        _assignment("gyroscopeCovariance", values.gyro_n, "(rad/s)^2/Hz"),
        _assignment("biasAccCovariance", values.accel_k, "(m/s^3)^2/Hz"),
        _assignment("biasOmegaCovariance", values.gyro_k, "(rad/s^2)^2/Hz"),
        f"integrationCovariance = {real(_INTEGRATION)}  # of the integration's rounding, not of the sensor",
        *_correlation_times(numbers),
    ]
    lines.append(_FUNCTION.format(gravity=real(G0)).rstrip())
    return values, lines


def _assignment(name: str, number: Number, unit: str) -> str:
    return f"{name} = {real(number.value**2)}  # {unit}; {number.note}"


def _correlation_times(numbers: Numbers) -> list[str]:
    """Return the correlation times of Gauss-Markov biases, for versions and forks of GTSAM that have them."""
    lines = []
    for key, sensor in (("tauAcc", Sensor.ACCELEROMETER), ("tauGyro", Sensor.GYROSCOPE)):
        found = [
            (term[1], axis.name) for axis in numbers.axes(sensor) if (term := numbers.gauss_markov(axis))
        ]
        if found:
            time, name = max(found)
            lines.append(f"{key} = {real(time)}  # s, Gauss-Markov bias of {name}; unused by the walk below")
    return lines


TARGET = Target(
    name="gtsam",
    title="GTSAM PreintegrationCombinedParams (Python)",
    file_name="gtsam_imu_params.py",
    heading="GTSAM PreintegrationCombinedParams",
    kind="continuous-time covariances (densities squared), SI; GTSAM makes them discrete with dt",
    formulas=("covariance = N^2, bias covariance = K^2, each times the identity; no factor of the rate",),
    body=_body,
    carries="N K GM",
)
