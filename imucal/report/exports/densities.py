"""What formats are made of: N and K of each sensor, the slow part of an axis, the topic."""

import math
from dataclasses import dataclass

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.result import AxisReport

#: Correlation time where none was measured, in s: long against the record, so that a walk stays one.
NOMINAL_TIME_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Densities:
    """N and K of both sensors, continuous, by the user's axis policy."""

    accel_n: Number
    accel_k: Number
    gyro_n: Number
    gyro_k: Number

    @property
    def all(self) -> tuple[Number, ...]:
        """The four numbers."""
        return self.accel_n, self.accel_k, self.gyro_n, self.gyro_k


def densities(numbers: Numbers) -> Densities:
    """Return N and K of both sensors."""
    return Densities(
        accel_n=numbers.one(Sensor.ACCELEROMETER, "N"),
        accel_k=numbers.one(Sensor.ACCELEROMETER, "K"),
        gyro_n=numbers.one(Sensor.GYROSCOPE, "N"),
        gyro_k=numbers.one(Sensor.GYROSCOPE, "K"),
    )


def topic(numbers: Numbers) -> tuple[str, str]:
    """Return the IMU topic to write, and a remark on where it comes from."""
    if numbers.choices.topic is not None:
        return numbers.choices.topic, "as given"
    source = numbers.report.source
    if not source.message_types:
        return "/imu0", "the log names no topic; set yours"
    # An IMU of a message that holds several is chosen as /topic:part; only the topic is ROS's.
    topic = source.topics[0].partition(":")[0]
    if len(source.topics) > 1:
        return topic, f"one of {', '.join(source.topics)}; set the topic that holds both sensors"
    return topic, "the log's topic"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowNoise:
    """A first-order Gauss-Markov process dx/dt = -x/T + driving * w(t).

    Attributes
    ----------
    driving
        Density of the driving noise, in U/sqrt(s); sigma = driving * sqrt(T/2).
    correlation_time
        T, in s.
    number
        The K it stands for; None where it is a Gauss-Markov term of the fit.
    note
        Where it comes from.
    """

    driving: float
    correlation_time: float
    number: Number | None
    note: str

    @property
    def sigma(self) -> float:
        """Steady-state standard deviation, in U."""
        return self.driving * math.sqrt(self.correlation_time / 2)


def slow_noise(numbers: Numbers, axis: AxisReport) -> SlowNoise:
    """Return the process that best stands for what is slower than white noise.

    A random walk that was found wins, with a nominal T: it goes on at the longest times, and a
    short T would stop it. Else the slowest Gauss-Markov term, with its own T. Else the bound on K.
    """
    term = numbers.gauss_markov(axis)
    if term is not None and axis.fit["K"].value is None:
        sigma, time = term
        return SlowNoise(
            driving=sigma * math.sqrt(2 / time),
            correlation_time=time,
            number=None,
            note=f"Gauss-Markov term of {axis.name}: sigma {sigma:.4g}, T {time:.4g} s",
        )
    walk = numbers.of(axis, "K")
    note = f"{walk.note}; T is nominal"
    return SlowNoise(driving=walk.value, correlation_time=NOMINAL_TIME_S, number=walk, note=note)
