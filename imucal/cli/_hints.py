"""Which options answer a question that the library asks in its own words, without names of options."""

import re

#: What a message asks for -> the option that says it.
_OPTIONS = (
    (r"one of these topics|topics are named|two topics|one for each sensor|no message '|name of a topic",
     "--topic NAME"),
    (r"columns text|give the columns|give columns", "--columns TEXT"),
    (r"sampling rate|and the rate\b", "--rate HZ"),
    (r"(no )?unit of the gyroscope|'[^']*' of the gyroscope", "--gyro-unit UNIT"),
    (r"(no )?unit of the accelerometer|'[^']*' of the accelerometer", "--accel-unit UNIT"),
    (r"counts in rad/s", "--gyro-scale X"),
    (r"counts in m/s\^2", "--accel-scale X"),
    (r"expected header or log|another time column|column to take as time|no time column '", "--time CLOCK"),
    (r"\.msg file", "--msg FILE"),
)  # fmt: skip


def options_for(message: str) -> str:
    """Return the options that answer a message, such as ``--rate HZ``; empty where none does."""
    return " or ".join(option for pattern, option in _OPTIONS if re.search(pattern, message))
