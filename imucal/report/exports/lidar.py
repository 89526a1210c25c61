"""LiDAR-inertial odometry: LIO-SAM, FAST-LIO, FAST-LIVO2, Point-LIO, GLIM, DLIO.

LIO-SAM and GLIM hand the squares of continuous densities to GTSAM. The filters of the FAST-LIO
family multiply a variance by dt² at each step, so that a sample's variance is wanted, and ``K² f``
of the walk. Point-LIO takes the same numbers as input noise, and the sample's variance as that of a
measurement; its ``*_cov_output`` describe how the vehicle moves. DLIO's observer has gains and no
noise at all: what a log at rest gives it is the gyroscope's bias.
"""

import math

from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import (
    ACCEL,
    GYRO,
    SAMPLE_SQUARED,
    Body,
    Key,
    Target,
    beside_json,
    comment,
    entries,
    four,
    json_object,
    json_origins,
    keyed_body,
    real,
    vector,
)
from imucal.units import G0

#: Time between two scans of a LiDAR at 10 Hz, in s.
_SCAN_S = 0.1
#: Time over which DLIO averages the IMU at start, in s (odom/imu/calibration/time).
_DLIO_AVERAGE_S = 3.0

_PER_SAMPLE = "discrete variances per sample, SI, right for the rate f above only"
_VARIANCES = "cov = N^2 * f, b_cov = K^2 * f (variances: an inflation enters squared)"
_FAST_KEYS = four("acc_cov b_acc_cov gyr_cov b_gyr_cov", SAMPLE_SQUARED)
_POINT_KEYS = (
    Key("imu_meas_acc_cov", ACCEL, "N", SAMPLE_SQUARED),
    Key("imu_meas_omg_cov", GYRO, "N", SAMPLE_SQUARED),
    *four("acc_cov_input b_acc_cov gyr_cov_input b_gyr_cov", SAMPLE_SQUARED),
)


def _ros2(above: str) -> str:
    return f"ROS 2: put '/**:' and '  ros__parameters:' above {above}, and indent by four"


def _glim(numbers: Numbers) -> Body:
    found = entries(numbers, (Key("imu_acc_noise", ACCEL, "N"), Key("imu_gyro_noise", GYRO, "N")))
    walks = [numbers.one(sensor, "K") for sensor in numbers.sensors]
    step = max(walk.value for walk in walks) * math.sqrt(_SCAN_S)
    members = [(entry.name, real(entry.value)) for entry in found]
    members.append(("imu_bias_noise", real(step)))
    said = [f"{entry.name}: {entry.remark}" for entry in found]
    said += [f"imu_bias_noise: {walk.note}" for walk in walks]
    used = [*(entry.number for entry in found), *walks]
    return used, [*json_origins(said), *json_object("sensors", members)]


def _dlio(numbers: Numbers) -> Body:
    if GYRO not in numbers.sensors:
        return (), ["dlio: {}"]
    white = numbers.each(GYRO, "N")
    bias = vector(axis.mean for axis in numbers.triad(GYRO))
    known = ", ".join(f"{number.value / math.sqrt(_DLIO_AVERAGE_S):.3g}" for number in white)
    return white, [
        *comment(number.note for number in white),
        "dlio:",
        "  imu:",
        "    intrinsics:",
        "      gyro:",
        f"        bias: {bias}  # rad/s, mean of this log",
        f"# DLIO's own average at start, over {_DLIO_AVERAGE_S:g} s, is known to N/sqrt(3 s) = {known} rad/s",
    ]


TARGETS = (
    Target(
        name="lio-sam",
        title="LIO-SAM params.yaml (IMU part)",
        file_name="lio_sam_imu.yaml",
        source="source: config/params.yaml, src/imuPreintegration.cpp",
        kind="continuous-time densities, SI; GTSAM makes them discrete with the stamps",
        formulas=("Noise = N, BiasN = K; no factor of the rate",),
        body=keyed_body(
            four("imuAccNoise imuAccBiasN imuGyrNoise imuGyrBiasN"),
            above=("lio_sam:",),
            below=(f"  imuGravity: {real(G0)}  # m/s^2, standard gravity; set that of your place",),
            indent="  ",
        ),
        notes=("ROS 2: put the keys under '/**: ros__parameters:' in place of 'lio_sam:'",),
    ),
    Target(
        name="fast-lio",
        title="FAST-LIO / FAST-LIO2 config (mapping covariances)",
        file_name="fast_lio_imu.yaml",
        heading="FAST-LIO / FAST-LIO2 config, its IMU part",
        source="source: src/IMU_Processing.hpp (UndistortPcl), include/IKFoM_toolkit",
        kind=_PER_SAMPLE,
        formulas=(_VARIANCES,),
        body=keyed_body(_FAST_KEYS, above=("mapping:",), indent="  "),
        notes=(_ros2("'mapping:'"),),
        aliases=("fastlio2",),
    ),
    Target(
        name="fast-livo2",
        title="FAST-LIVO2 config (imu covariances)",
        file_name="fast_livo2_imu.yaml",
        heading="FAST-LIVO2 config, its IMU part",
        source="source: src/IMU_Processing.cpp (UndistortPcl), config/avia.yaml",
        kind=_PER_SAMPLE,
        formulas=(_VARIANCES,),
        body=keyed_body(_FAST_KEYS, above=("imu:",), indent="  "),
        notes=(_ros2("'imu:'"),),
    ),
    Target(
        name="point-lio",
        title="Point-LIO config (mapping covariances)",
        file_name="point_lio_imu.yaml",
        heading="Point-LIO config, its IMU part",
        source="source: src/Estimator.cpp, IKFoM_toolkit/esekfom/esekfom.hpp (predict), config/avia.yaml",
        kind=_PER_SAMPLE,
        formulas=(
            "imu_meas_cov, cov_input = N^2 * f; b_cov = K^2 * f (variances: an inflation enters squared)",
            "imu_time_inte = 1 / f: the period at which the covariance is propagated",
        ),
        body=keyed_body(
            _POINT_KEYS,
            above=("mapping:",),
            below=lambda numbers: (
                f"  imu_time_inte: {real(1 / numbers.stream_hz)}  # s, of the {numbers.sensors[0]}",
            ),
            indent="  ",
        ),
        notes=(
            "acc_cov_output, gyr_cov_output say how your vehicle moves; no log at rest shows them",
            _ros2("'mapping:'"),
        ),
    ),
    Target(
        name="glim",
        title="GLIM config_sensors.json (IMU part)",
        file_name="glim_sensors.json",
        source="source: src/glim/common/imu_integration.cpp, src/glim/odometry/odometry_estimation_imu.cpp",
        kind="continuous-time densities, SI; imu_bias_noise is discrete, from scan to scan",
        formulas=(
            "imu_acc_noise, imu_gyro_noise = N",
            f"imu_bias_noise = K * sqrt(time between two scans), {_SCAN_S:g} s; the larger of both sensors",
        ),
        body=_glim,
        notes=("imu_int_noise is of the integration, not of the sensor: keep your own",),
        layout=beside_json,
    ),
    Target(
        name="dlio",
        title="DLIO dlio.yaml (gyroscope bias; it has no noise parameters)",
        file_name="dlio_imu.yaml",
        heading="DLIO dlio.yaml, its IMU part",
        source="source: src/dlio/odom.cc, cfg/dlio.yaml, cfg/params.yaml",
        kind="no noise, continuous or discrete: DLIO's observer has gains (odom/geo/Kp … Kgb) in its place",
        formulas=("bias = mean of each axis of the gyroscope",),
        body=_dlio,
        carries="N",
        per_axis=True,
        notes=(
            "read with imu/calibration: false only",
            "a bias changes from start to start: where the vehicle rests then, DLIO's own is better",
        ),
    ),
)
