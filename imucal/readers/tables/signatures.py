"""Formats known by their column names: what units they use where the header doesn't say.

A unit in the header always goes first; these are the makers' own conventions.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """A format of tables.

    Attributes
    ----------
    name
        What people call it.
    headers
        Regular expressions; each must match the whole of some column's name, in small letters.
    preamble
        Regular expression that must be found in the lines before the header, or empty.
    gyro_unit, accel_unit
        Units of its samples; None where they differ from file to file.
    time_ns
        Name of a time column in small letters -> ns per count.
    """

    name: str
    headers: tuple[str, ...]
    preamble: str = ""
    gyro_unit: str | None = None
    accel_unit: str | None = None
    time_ns: tuple[tuple[str, int], ...] = ()

    def matches(self, headers: Sequence[str], preamble: str) -> bool:
        """Return whether a table with these columns and this preamble has this format."""
        if self.preamble and not re.search(self.preamble, preamble, re.IGNORECASE | re.MULTILINE):
            return False
        return all(any(re.fullmatch(pattern, name) for name in headers) for pattern in self.headers)


_SI: Any = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}

#: In the order in which they are tried.
SIGNATURES: tuple[Signature, ...] = (
    # EuRoC and TUM-VI data.csv; the header of the data sets has the units, copies often lost them.
    Signature(name="EuRoC", headers=(r"w_rs_s_x.*", r"a_rs_s_x.*"), **_SI),
    # Kalibr's bagextractor and OpenVINS.
    Signature(name="Kalibr", headers=(r"omega_x", r"alpha_x"), **_SI),
    # sensor_msgs/Imu: REP 103 and the message's own comments.
    Signature(
        name="ROS",
        headers=(r"field\.header\.stamp", r"field\..*(angular_velocity|linear_acceleration)\.x"),
        **_SI,
        time_ns=(("field.header.stamp", 1),),
    ),
    Signature(name="ROS", headers=(r".*angular_velocity[./_ ]?x.*",), **_SI),
    Signature(name="ROS", headers=(r".*linear_acceleration[./_ ]?x.*",), **_SI),
    # Xsens DOT User Manual XD0502P: SampleTimeFine counts microseconds, Gyr is in deg/s.
    Signature(
        name="Xsens DOT",
        headers=(r"gyr_x", r"acc_x"),
        preamble=r"^DeviceTag|^Measurement server",
        gyro_unit="deg/s",
        accel_unit="m/s^2",
        time_ns=(("sampletimefine", 1_000),),
    ),
    # Xsens MTi low-level protocol: SampleTimeFine counts 10 kHz ticks.
    Signature(
        name="Xsens",
        headers=(r"gyr_x", r"acc_x", r"packetcounter|counter"),
        **_SI,
        time_ns=(("sampletimefine", 100_000),),
    ),
    Signature(name="Xsens", headers=(r"gyr_x", r"acc_x"), preamble=r"^// ", **_SI),
    # ArduPilot dataflash message IMU.
    Signature(name="ArduPilot", headers=(r"timeus", r"gyrx", r"accx"), **_SI),
    # PX4 sensor_combined, sensor_gyro and sensor_accel through ulog2csv: microseconds since boot.
    Signature(name="PX4", headers=(r"timestamp", r"gyro_rad\[0\]"), **_SI, time_ns=(("timestamp", 1_000),)),
    Signature(
        name="PX4",
        headers=(r"timestamp", r"timestamp_sample", r"device_id", r"x"),
        **_SI,
        time_ns=(("timestamp", 1_000), ("timestamp_sample", 1_000)),
    ),
    # Betaflight blackbox_decode: gyroADC in deg/s, accelerometer in raw counts.
    Signature(
        name="Betaflight",
        headers=(r"loopiteration", r"gyroadc\[0\].*"),
        gyro_unit="deg/s",
        time_ns=(("time", 1_000), ("time (us)", 1_000)),
    ),
    # SensorLog for iOS: Core Motion gives g and rad/s.
    Signature(
        name="SensorLog",
        headers=(r"accelerometeraccelerationx.*", r"gyrorotationx.*"),
        gyro_unit="rad/s",
        accel_unit="g",
    ),
    # librealsense: rs-data-collect.
    Signature(name="RealSense", headers=(r"stream type", r"3dof_x"), **_SI),
    # Sensor Logger for Android and iOS.
    Signature(name="Sensor Logger", headers=(r"time", r"seconds_elapsed", r"x", r"y", r"z"), **_SI),
    # MicroStrain: MIP descriptors 0x8004 scaled accelerometer (g), 0x8005 scaled gyroscope (rad/s).
    Signature(name="MicroStrain", headers=(r"x accel \[x8004\]",), gyro_unit="rad/s", accel_unit="g"),
    Signature(name="MicroStrain", headers=(r"scaledaccelx.*",), gyro_unit="rad/s", accel_unit="g"),
    # VectorNav Control Center and INSTINCT.
    Signature(name="VectorNav", headers=(r"uncompgyrox|uncompaccx",), **_SI),
    Signature(name="VectorNav", headers=(r"\$vn.*", r"gyrox", r"accelx"), **_SI),
    # KITTI raw data: oxts/dataformat.txt.
    Signature(name="KITTI", headers=(r"oxts wx", r"oxts ax"), **_SI),
)


def find_signature(headers: Sequence[str], preamble: Sequence[str] = ()) -> Signature | None:
    """Return the format that a table's column names and preamble show, or None."""
    plain = [header.strip().strip("\"'").lstrip("#%/ ").lower() for header in headers]
    text = "\n".join(preamble)
    return next((entry for entry in SIGNATURES if entry.matches(plain, text)), None)
