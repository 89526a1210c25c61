"""The four densities that most formats hold: N and K of each sensor."""

from dataclasses import dataclass

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers


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
