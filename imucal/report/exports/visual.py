"""Visual-inertial odometry: Kalibr, OpenVINS, VINS, ORB-SLAM3, OKVIS2, Kimera-VIO, and others.

All but VINS take continuous densities, some squared. VINS' covariance propagation takes half of the
white variance twice (mid-point integration), so that the wanted value is ``N sqrt(2 f)``; the common
``N sqrt(f)`` is sqrt(2) low. The walk enters once, ``K sqrt(f)``. ORB-SLAM3 multiplies N by, and
divides K by, the root of ``IMU.Frequency``: a wrong frequency moves them in opposite directions.
Kalibr divides by sqrt(dt) itself and refuses a value that is not positive; its ``*_random_walk`` is K,
not the angle random walk.
"""

from functools import partial

import numpy as np

from imucal.report.exports.config_numbers import NOMINAL_TIME_S, Numbers
from imucal.report.exports.target import (
    ACCEL,
    DENSITY_SQUARED,
    GYRO,
    HALVED_TWICE,
    SAMPLE,
    YAML_LINE,
    Body,
    Key,
    Target,
    below_comment,
    beside_json,
    entries,
    four,
    json_object,
    json_origins,
    keyed_body,
    lines,
    matrix,
    opencv_yaml,
    plain,
    quoted,
    real,
    stream_rate,
    triads,
    vector,
)
from imucal.units import G0

#: The four keys, as EuRoC and Kimera-VIO have them too.
_KALIBR = four(
    "accelerometer_noise_density accelerometer_random_walk gyroscope_noise_density gyroscope_random_walk"
)
_KALIBR_FORMULA = "noise_density = N (white noise), random_walk = K (of the bias); no factor of the rate"


def _topic(numbers: Numbers) -> str:
    name, remark = numbers.topic()
    return f"rostopic: {quoted(name)}  # {plain(remark)}"


_UPDATE_RATE = stream_rate("update_rate")


def _intrinsics(numbers: Numbers) -> list[str]:
    unit, zero = np.eye(3).tolist(), np.zeros((3, 3)).tolist()
    text = [
        f"  {_topic(numbers)}",
        "  time_offset: 0.0",
        f"  {_UPDATE_RATE(numbers)[0]}",
        '  model: "kalibr"',
    ]
    for key, rows in (("Tw", unit), ("R_IMUtoGYRO", unit), ("Ta", unit), ("R_IMUtoACC", unit), ("Tg", zero)):
        text += [f"  {key}:", *matrix(rows, "    ")]
    return text


_PLAIN = "no factor of the rate"
_OWN_KEYS = "the other keys of this section are yours: the program refuses a file that lacks one"


def _identity(*, said: str) -> list[str]:
    """Return the pose of the IMU in the body, as EuRoC's files spell it."""
    rows = [vector(row)[1:-1] for row in np.eye(4).tolist()]
    data = [f"  data: [{rows[0]},", *(f"         {row}," for row in rows[1:-1]), f"         {rows[-1]}]"]
    return [f"T_BS:  # {said}", "  cols: 4", "  rows: 4", *data]


def _gravity(name: str) -> str:
    return f"{name}: {real(G0)}  # m/s^2, standard gravity; set that of your place"


def _orbslam3_rate(numbers: Numbers) -> list[str]:
    return [
        *stream_rate("IMU.Frequency")(numbers),
        '# A config without File.version: "1.0" goes through the old loader, which takes an integer alone:',
        f"# IMU.Frequency: {round(numbers.stream_hz)}",
    ]


_OKVIS2 = four("sigma_a_c sigma_aw_c sigma_g_c sigma_gw_c")


def _okvis2(numbers: Numbers) -> Body:
    """Return the four numbers, those of the accelerometer for a bias that forgets after tau."""
    found, time = entries(numbers, _OKVIS2), NOMINAL_TIME_S
    if numbers.covers and ACCEL in numbers.sensors:
        (pair,) = numbers.timed([numbers.chosen(ACCEL)])
        time = pair.correlation_time_s or time
        values = (pair.white * numbers.choices.factor("N"), pair.walk * numbers.choices.factor("K"))
        found[:2] = [entry._replace(value=value) for entry, value in zip(found[:2], values, strict=True)]
    return [entry.number for entry in found], [
        "imu_parameters:",
        *lines(found, f"    {YAML_LINE}"),
        f"    tau: {real(time)}  # s, of the accelerometer's bias",
        f"    {_gravity('g')}",
    ]


_RATE_HZ = stream_rate("rate_hz", remark="of the")
_KIMERA_TAIL = (
    "imu_integration_sigma: 1.0e-08  # of the integration's rounding, not of the sensor",
    "imu_time_shift: 0.0",
    "do_initial_time_alignment: 0",
    f"n_gravity: {vector((0.0, 0.0, -G0))}",
)


def _kimera_head(numbers: Numbers) -> list[str]:
    pose = _identity(said="identity: Kimera-VIO takes no other")
    return ["imu_preintegration_type: 1", *pose, *_RATE_HZ(numbers)]


def _euroc_head(numbers: Numbers) -> list[str]:
    pose = _identity(said="identity: the body frame is the IMU's; set yours")
    comment = f"comment: {quoted(numbers.report.source.path)}"
    return ["sensor_type: imu", comment, *pose, *_RATE_HZ(numbers)]


_ROVIO = (
    Key("vel_{i}", ACCEL, "N", DENSITY_SQUARED),
    Key("acb_{i}", ACCEL, "K", DENSITY_SQUARED),
    Key("gyb_{i}", GYRO, "K", DENSITY_SQUARED),
    Key("att_{i}", GYRO, "N", DENSITY_SQUARED),
)


_BASALT = (
    Key("accel_noise_std", ACCEL, "N"),
    Key("gyro_noise_std", GYRO, "N"),
    Key("accel_bias_std", ACCEL, "K"),
    Key("gyro_bias_std", GYRO, "K"),
)


def _basalt(numbers: Numbers) -> Body:
    used, lists = triads(numbers, _BASALT)
    members = [("imu_update_rate", real(numbers.stream_hz)), *lists]
    return used, [*json_origins(number.note for number in used), *json_object("value0", members)]


TARGETS = (
    Target(
        name="kalibr",
        title="Kalibr imu.yaml",
        file_name="kalibr_imu.yaml",
        source="source: aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py",
        kind="continuous-time densities, SI; Kalibr makes them discrete with update_rate",
        formulas=(_KALIBR_FORMULA,),
        body=keyed_body(_KALIBR, below=lambda numbers: (_topic(numbers), *_UPDATE_RATE(numbers))),
    ),
    Target(
        name="openvins",
        title="OpenVINS kalibr_imu_chain.yaml",
        file_name="kalibr_imu_chain.yaml",
        source="source: config/euroc_mav/kalibr_imu_chain.yaml, ov_core/src/utils/opencv_yaml_parse.h",
        kind="continuous-time densities, SI; OpenVINS makes them discrete with the stamps of the messages",
        formulas=(_KALIBR_FORMULA,),
        body=keyed_body(
            _KALIBR,
            above=("imu0:", "  T_i_b:", *matrix(np.eye(4).tolist(), "    ")),
            below=_intrinsics,
            indent="  ",
        ),
        notes=(
            "matrices: identity (no intrinsics are measured at rest); T_i_b, Tw, Ta, Tg are yours to set",
        ),
        layout=opencv_yaml,
        aliases=("ovins",),
    ),
    Target(
        name="vins",
        title="VINS-Mono / VINS-Fusion config (IMU part)",
        file_name="vins_imu.yaml",
        source="source: vins_estimator/src/factor/integration_base.h",
        kind="discrete standard deviations per sample, SI, right for the rate f above only",
        formulas=(
            "acc_n, gyr_n = N * sqrt(2 f): VINS averages two samples but takes half of the variance twice",
            "acc_w, gyr_w = K * sqrt(f)",
        ),
        body=keyed_body(
            four("acc_n acc_w gyr_n gyr_w", HALVED_TWICE, SAMPLE),
            below=(_gravity("g_norm"),),
        ),
        layout=opencv_yaml,
        aliases=("vinsmono", "vinsfusion"),
    ),
    Target(
        name="orbslam3",
        title="ORB-SLAM3 config (IMU part)",
        file_name="orbslam3_imu.yaml",
        source="source: src/Tracking.cc (ParseIMUParamFile), src/Settings.cc, src/ImuTypes.cc",
        kind="continuous-time densities, SI; ORB-SLAM3 makes them discrete with IMU.Frequency",
        formulas=(
            f"Noise = N, Walk = K; {_PLAIN}",
            "IMU.Frequency must be the true rate: the code takes N * sqrt(f) and K / sqrt(f)",
        ),
        body=keyed_body(four("IMU.NoiseAcc IMU.AccWalk IMU.NoiseGyro IMU.GyroWalk"), below=_orbslam3_rate),
        layout=opencv_yaml,
        aliases=("orbslam",),
    ),
    Target(
        name="okvis2",
        title="OKVIS2 config (imu_parameters)",
        file_name="okvis2_imu.yaml",
        source="source: okvis_ceres/src/ImuError.cpp, okvis_common/src/ViParametersReader.cpp",
        kind="continuous-time densities, SI; OKVIS2 multiplies their squares by dt",
        formulas=(f"sigma_a_c, sigma_g_c = N; sigma_aw_c, sigma_gw_c = K, tau = T; {_PLAIN}",),
        body=_okvis2,
        notes=(f"{_OWN_KEYS} (a_max, g_max, sigma_ba, sigma_bg, a0, g0, T_BS …)",),
        layout=opencv_yaml,
    ),
    Target(
        name="kimera-vio",
        title="Kimera-VIO ImuParams.yaml",
        file_name="ImuParams.yaml",
        source="source: src/imu-frontend/ImuFrontendParams.cpp, src/imu-frontend/ImuFrontend.cpp",
        kind="continuous-time densities, SI; squared and handed to GTSAM, which uses the stamps",
        formulas=(_KALIBR_FORMULA,),
        body=keyed_body(_KALIBR, above=_kimera_head, below=_KIMERA_TAIL),
        notes=("imu_preintegration_type: 1; for 0 the code sets GTSAM's biasAccOmegaInt to the identity",),
        layout=opencv_yaml,
        aliases=("kimera",),
    ),
    Target(
        name="msckf-vio",
        title="MSCKF-VIO (S-MSCKF) node parameters",
        file_name="msckf_vio_imu.yaml",
        heading="MSCKF-VIO (S-MSCKF) node parameters, the IMU's",
        source="source: src/msckf_vio.cpp (loadParameters, processModel)",
        kind="continuous-time densities, SI; the filter multiplies their squares by dt",
        formulas=(f"gyro, acc = N; gyro_bias, acc_bias = K; {_PLAIN}",),
        body=keyed_body(four("acc acc_bias gyro gyro_bias"), above=("noise:",), indent="  "),
        notes=('load it in the node\'s own namespace: <rosparam command="load" file="…"/> inside its tag',),
        aliases=("smsckf",),
    ),
    Target(
        name="svo-pro",
        title="SVO Pro calibration (imu_params)",
        file_name="svo_pro_imu.yaml",
        source="source: svo_common/include/svo/common/imu_calibration.h, svo/src/imu_handler.cpp",
        kind="continuous-time densities, SI",
        formulas=(f"sigma_acc_c, sigma_omega_c = N; sigma_acc_bias_c, sigma_omega_bias_c = K; {_PLAIN}",),
        body=keyed_body(
            four("sigma_acc_c sigma_acc_bias_c sigma_omega_c sigma_omega_bias_c"),
            above=("imu_params:",),
            below=lambda numbers: (*stream_rate("  imu_rate")(numbers), f"  {_gravity('g')}"),
            indent="  ",
        ),
        notes=(f"{_OWN_KEYS} (delay_imu_cam, max_imu_delta_t, acc_max, omega_max, sigma_integration)",),
        aliases=("svo", "rpgsvopro"),
    ),
    Target(
        name="rovio",
        title="ROVIO rovio.info (PredictionNoise)",
        file_name="rovio_imu.info",
        source="source: include/rovio/ImuPrediction.hpp, cfg/rovio.info",
        kind="continuous-time covariances (densities squared), SI; ROVIO scales them with dt",
        formulas=("vel, att = N^2; acb, gyb = K^2 of each axis (an inflation enters squared)",),
        body=keyed_body(
            _ROVIO,
            above=("Prediction", "{", "    PredictionNoise", "    {"),
            below=("    }", "}"),
            indent=" " * 8,
            layout="{name} {value};  {remark}",
        ),
        per_axis=True,
        notes=("include this file at the end of your rovio.info, or copy the lines into it",),
        layout=partial(below_comment, sign=";"),
    ),
    Target(
        name="basalt",
        title="Basalt calibration.json (IMU part)",
        file_name="basalt_imu.json",
        source="source: basalt-headers calibration.hpp, eigen_io.h; src/vi_estimator (bias_weight)",
        kind="continuous-time densities, SI; Basalt makes them discrete with imu_update_rate",
        formulas=(f"noise_std = N, bias_std = K of each axis; {_PLAIN}",),
        body=_basalt,
        per_axis=True,
        notes=(
            "copy the keys into value0 of your calibration; versions before 2020 take one number, not three",
        ),
        layout=beside_json,
    ),
    Target(
        name="isaac-ros",
        title="Isaac ROS Visual SLAM parameters",
        file_name="isaac_ros_imu.yaml",
        heading="Isaac ROS Visual SLAM parameters, the IMU's",
        source="documentation: isaac_ros_visual_slam, parameters",
        kind="continuous-time densities, SI; the node makes them discrete with calibration_frequency",
        formulas=(f"noise_density = N, random_walk = K; {_PLAIN}",),
        body=keyed_body(
            four("accel_noise_density accel_random_walk gyro_noise_density gyro_random_walk"),
            above=("/**:", "  ros__parameters:"),
            below=stream_rate("    calibration_frequency"),
            indent="    ",
        ),
        aliases=("cuvslam",),
    ),
    Target(
        name="euroc",
        title="EuRoC (ASL dataset) sensor.yaml",
        file_name="euroc_sensor.yaml",
        source="documentation: Burri et al. (2016), The EuRoC micro aerial vehicle datasets",
        kind="continuous-time densities, SI",
        formulas=(_KALIBR_FORMULA,),
        body=keyed_body(_KALIBR, above=_euroc_head),
        aliases=("asl",),
    ),
)
