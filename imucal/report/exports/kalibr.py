"""Kalibr's ``imu.yaml`` and OpenVINS' ``kalibr_imu_chain.yaml``: Kalibr's numbers, with the IMU's intrinsics.

Continuous densities; Kalibr divides by sqrt(dt) itself and refuses a value that is not positive. Its
``*_random_walk`` is K, not the angle random walk.
"""

import numpy as np

from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import (
    Target,
    four,
    keyed_body,
    matrix,
    opencv_yaml,
    plain,
    quoted,
    stream_rate,
)

#: The four keys, as EuRoC and Kimera-VIO have them too.
KEYS = four(
    "accelerometer_noise_density accelerometer_random_walk gyroscope_noise_density gyroscope_random_walk"
)
FORMULA = "noise_density = N (white noise), random_walk = K (of the bias); no factor of the rate"


def _topic(numbers: Numbers) -> str:
    name, remark = numbers.topic()
    return f"rostopic: {quoted(name)}  # {plain(remark)}"


_RATE = stream_rate("update_rate")


def _intrinsics(numbers: Numbers) -> list[str]:
    unit, zero = np.eye(3).tolist(), np.zeros((3, 3)).tolist()
    lines = [f"  {_topic(numbers)}", "  time_offset: 0.0", f"  {_RATE(numbers)[0]}", '  model: "kalibr"']
    for key, rows in (("Tw", unit), ("R_IMUtoGYRO", unit), ("Ta", unit), ("R_IMUtoACC", unit), ("Tg", zero)):
        lines += [f"  {key}:", *matrix(rows, "    ")]
    return lines


TARGETS = (
    Target(
        name="kalibr",
        title="Kalibr imu.yaml",
        file_name="kalibr_imu.yaml",
        source="source: aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py",
        kind="continuous-time densities, SI; Kalibr makes them discrete with update_rate",
        formulas=(FORMULA,),
        body=keyed_body(KEYS, below=lambda numbers: (_topic(numbers), *_RATE(numbers))),
    ),
    Target(
        name="openvins",
        title="OpenVINS kalibr_imu_chain.yaml",
        file_name="kalibr_imu_chain.yaml",
        source="source: config/euroc_mav/kalibr_imu_chain.yaml, ov_core/src/utils/opencv_yaml_parse.h",
        kind="continuous-time densities, SI; OpenVINS makes them discrete with the stamps of the messages",
        formulas=(FORMULA,),
        body=keyed_body(
            KEYS,
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
)
