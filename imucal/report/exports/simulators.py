"""Simulators that draw an IMU's noise: Gazebo, AirSim, CARLA, Isaac Sim (through Pegasus).

AirSim and Pegasus take densities and make them discrete themselves; CARLA adds a normal deviate to
each message and knows no walk. AirSim's bias is a walk of density ``stability / sqrt(tau)``, whatever
its names say, and its velocity random walk is in mg/sqrt(Hz). Isaac Sim's own IMU has no noise.

In Gazebo's SDF ``stddev`` is discrete; ``dynamic_bias_stddev`` is, despite its name, the density of the
noise that drives the bias: its steady state is ``dynamic_bias_stddev * sqrt(T / 2)``. ``precision``
belongs to the quantized model alone and isn't written. Both sensors are sampled at ``update_rate``, so
that ``stddev`` belongs to it for both.
"""

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as ET

from imucal.noise.terms import TERMS
from imucal.report.exports.config_numbers import NOMINAL_TIME_S, Number, Numbers, WithBias
from imucal.report.exports.target import (
    ACCEL,
    GYRO,
    SAMPLE,
    Body,
    Entry,
    Formula,
    Key,
    Target,
    beside_json,
    entries,
    json_object,
    json_origins,
    lines,
    plain,
    real,
)
from imucal.units import G0

#: Time over which AirSim's bias is said to be stable, in s; any will do, K = stability / sqrt(tau).
_AIRSIM_TAU_S = 100.0
_DEG_PER_SQRT_HOUR = TERMS["N"].datasheet_unit(GYRO).factor
_DEG_PER_HOUR = TERMS["B"].datasheet_unit(GYRO).factor

_AIRSIM = (
    Key("AngularRandomWalk", GYRO, "N", Formula(lambda c, f: c * _DEG_PER_SQRT_HOUR, "deg/sqrt(h)")),  # noqa: ARG005
    Key(
        "GyroBiasStability",
        GYRO,
        "K",
        Formula(lambda c, f: c * math.sqrt(_AIRSIM_TAU_S) * _DEG_PER_HOUR, "deg/h"),  # noqa: ARG005
    ),
    Key("VelocityRandomWalk", ACCEL, "N", Formula(lambda c, f: c / G0 * 1e3, "mg/sqrt(Hz)")),  # noqa: ARG005
    Key(
        "AccelBiasStability",
        ACCEL,
        "K",
        Formula(lambda c, f: c * math.sqrt(_AIRSIM_TAU_S) / G0 * 1e6, "ug"),  # noqa: ARG005
    ),
)
_CARLA = (
    Key("noise_accel_stddev_{axis}", ACCEL, "N", SAMPLE),
    Key("noise_gyro_stddev_{axis}", GYRO, "N", SAMPLE),
)


def _said(found: Iterable[Entry]) -> list[str]:
    return json_origins(f"{entry.name}: {entry.remark}" for entry in found)


def _airsim(numbers: Numbers) -> Body:
    found = entries(numbers, _AIRSIM)
    values = [("SensorType", "2"), ("Enabled", "true"), *((e.name, real(e.value)) for e in found)]
    taus = {GYRO: "GyroBiasStabilityTau", ACCEL: "AccelBiasStabilityTau"}
    values += [(taus[sensor], real(_AIRSIM_TAU_S)) for sensor in numbers.sensors]
    inside = ['  "DefaultSensors": {', *json_object("Imu", values, "    "), "  }"]
    return [entry.number for entry in found], [*_said(found), *inside]


def _carla(numbers: Numbers) -> Body:
    found = entries(numbers, _CARLA)
    values = [("sensor_tick", real(1 / numbers.stream_hz)), *((e.name, real(e.value)) for e in found)]
    text = [*_said(found), *json_object("sensor.other.imu", values)]
    return [entry.number for entry in found], text


def _pegasus(numbers: Numbers) -> Body:
    text, used = ["", "imu_config = {", f'    "update_rate": {real(numbers.stream_hz)},'], list[Number]()
    for sensor in numbers.sensors:
        keys = (Key("noise_density", sensor, "N"), Key("random_walk", sensor, "K"))
        found = entries(numbers, keys)
        used += [entry.number for entry in found]
        text += [
            f'    "{sensor}": {{',
            *lines(found, '        "{name}": {value},  # {remark}'),
            f'        "bias_correlation_time": {real(NOMINAL_TIME_S)},  # s, nominal',
            "    },",
        ]
    return used, [*text, "}"]


_ELEMENTS = {GYRO: "angular_velocity", ACCEL: "linear_acceleration"}


def _gazebo(numbers: Numbers) -> Body:
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
            (noise,) = numbers.with_bias([axis])
            used += noise.used
            _axis_noise(ET.SubElement(element, axis.axis), numbers.stream_hz, noise)
    ET.indent(root)
    return used, [ET.tostring(root, encoding="unicode")]


def _sdf(head: Sequence[str], body: Sequence[str]) -> str:
    said = "\n".join(f"  {_xml_safe(plain(line))}" for line in head)
    return "\n".join(['<?xml version="1.0"?>', "<!--", said, "-->", *body]) + "\n"


def _axis_noise(parent: ET.Element, rate_hz: float, axis: WithBias) -> None:
    parent.append(ET.Comment(_xml_safe(f" {axis.note} ")))
    noise = ET.SubElement(parent, "noise", type="gaussian")
    values = {
        "mean": 0.0,
        "stddev": axis.white * math.sqrt(rate_hz),
        "bias_mean": 0.0,
        "bias_stddev": 0.0,
        "dynamic_bias_stddev": axis.driving,
        "dynamic_bias_correlation_time": axis.correlation_time,
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
            "dynamic_bias_stddev = density of what drives the bias, K where it walks",
            "dynamic_bias_correlation_time = T of the bias, long where none that was measured is better",
        ),
        body=_gazebo,
        notes=("bias_mean, bias_stddev: the turn-on bias needs many starts, not one log; set yours",),
        layout=_sdf,
        carries="N K GM",
        per_axis=True,
        aliases=("sdf", "gz", "ignition"),
    ),
    Target(
        name="airsim",
        title="AirSim settings.json (Imu sensor)",
        file_name="airsim_imu.json",
        source="source: AirLib/include/sensors/imu/ImuSimpleParams.hpp, ImuSimple.hpp",
        kind="continuous-time densities, in the units of AirSim's settings; AirSim makes them discrete",
        formulas=(
            "AngularRandomWalk = N in deg/sqrt(h), VelocityRandomWalk = N in mg/sqrt(Hz)",
            "BiasStability = K * sqrt(BiasStabilityTau), in deg/h and micro-g: AirSim's bias is a walk",
        ),
        body=_airsim,
        layout=beside_json,
        aliases=("cosysairsim",),
    ),
    Target(
        name="carla",
        title="CARLA attributes of sensor.other.imu",
        file_name="carla_imu.json",
        source="source: CarlaUE4 Carla/Sensor/InertialMeasurementUnit.cpp",
        kind="discrete standard deviations per message, SI, right for sensor_tick only",
        formulas=("noise_*_stddev = N * sqrt(f) of each axis, sensor_tick = 1 / f",),
        body=_carla,
        carries="N",
        per_axis=True,
        notes=(
            "for name, value in attributes.items(): blueprint.set_attribute(name, str(value))",
            "CARLA's axes are left-handed (y to the right); its constant noise_gyro_bias is yours to set",
        ),
        layout=beside_json,
    ),
    Target(
        name="isaac-sim",
        title="Isaac Sim: IMU of Pegasus Simulator (Python)",
        file_name="isaac_sim_imu.py",
        heading="Isaac Sim: IMU of Pegasus Simulator",
        source="source: pegasus/simulator/logic/sensors/imu.py; documentation: Isaac Sim, IMU sensor",
        kind="continuous-time densities, SI; Pegasus makes them discrete with its own steps",
        formulas=("noise_density = N, random_walk = K with a nominal correlation time of 3600 s",),
        body=_pegasus,
        notes=(
            "Isaac Sim's own IMU sensor has no noise; use IMU(imu_config) of Pegasus in its place",
            "Pegasus as it was read moves the bias but does not add it to the rate: look at your version",
        ),
        aliases=("pegasus", "pegasussimulator"),
    ),
)
