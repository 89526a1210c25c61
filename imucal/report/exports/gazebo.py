"""Gazebo / SDF: an ``<sensor type="imu">`` with the noise of each axis.

``stddev`` is discrete; ``dynamic_bias_stddev`` is, despite its name, the density of the noise that
drives the bias: its steady state is ``dynamic_bias_stddev * sqrt(T / 2)``. ``precision`` belongs to
the quantized model alone and isn't written.
Both sensors are sampled at ``update_rate``, so that ``stddev`` belongs to it for both.
"""

import math
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers, SlowNoise
from imucal.report.exports.target import Body, Target, plain, real

_ELEMENTS = {Sensor.GYROSCOPE: "angular_velocity", Sensor.ACCELEROMETER: "linear_acceleration"}


def _body(numbers: Numbers) -> Body:
    root = ET.Element("sdf", version="1.7")
    link = ET.SubElement(ET.SubElement(root, "model", name="imu"), "link", name="imu_link")
    sensor_element = ET.SubElement(link, "sensor", name="imu", type="imu")
    ET.SubElement(sensor_element, "always_on").text = "true"
    ET.SubElement(sensor_element, "update_rate").text = real(numbers.stream_hz)
    imu = ET.SubElement(sensor_element, "imu")
    used: list[Number] = []
    for sensor in numbers.sensors:
        element = ET.SubElement(imu, _ELEMENTS[sensor])
        for axis in numbers.triad(sensor):
            white, slow = numbers.of(axis, "N"), numbers.slow(axis)
            used += [white] if slow.number is None else [white, slow.number]
            _noise(ET.SubElement(element, axis.axis), numbers.stream_hz, white, slow)
    ET.indent(root)
    return used, [ET.tostring(root, encoding="unicode")]


def _layout(head: Sequence[str], body: Sequence[str]) -> str:
    said = "\n".join(f"  {_xml_safe(plain(line))}" for line in head)
    return "\n".join(['<?xml version="1.0"?>', "<!--", said, "-->", *body]) + "\n"


def _noise(parent: ET.Element, rate_hz: float, white: Number, slow: SlowNoise) -> None:
    notes = f" {white.note} | {slow.note} "
    parent.append(ET.Comment(_xml_safe(notes)))
    noise = ET.SubElement(parent, "noise", type="gaussian")
    values = {
        "mean": 0.0,
        "stddev": white.value * math.sqrt(rate_hz),
        "bias_mean": 0.0,
        "bias_stddev": 0.0,
        "dynamic_bias_stddev": slow.driving,
        "dynamic_bias_correlation_time": slow.correlation_time,
    }
    for name, value in values.items():
        ET.SubElement(noise, name).text = real(value)


def _xml_safe(text: str) -> str:
    """Two hyphens would end an XML comment."""
    return text.replace("--", "- -")


TARGETS = (
    Target(
        name="gazebo",
        title="Gazebo / SDF imu sensor",
        file_name="gazebo_imu.sdf",
        source="source: gz-sensors src/GaussianNoiseModel.cc; SDFormat noise.sdf",
        kind="stddev is discrete, right for update_rate only; dynamic_bias_stddev is a continuous density",
        formulas=(
            "stddev = N * sqrt(f)",
            "dynamic_bias_stddev = K, with a nominal correlation time of 3600 s",
            "on an axis with a Gauss-Markov term (sigma, T) and no random walk: sigma * sqrt(2 / T), and T",
        ),
        body=_body,
        notes=("bias_mean, bias_stddev: the turn-on bias needs many starts, not one log; set yours",),
        layout=_layout,
        carries="N K GM",
        per_axis=True,
        aliases=("sdf", "gz", "ignition"),
    ),
)
