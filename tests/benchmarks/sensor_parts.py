"""Make `imucal/sensors/parts.toml` from the collection of data-sheet figures.

    IMUCAL_REAL_DATA=… python -m tests.benchmarks.sensor_parts

The collection is ``parts/parts.toml`` in the folder of `IMUCAL_REAL_DATA`. A figure without a source is left
out. Texts that only help the people who collected it (places of copies, damaged text) are replaced here.
"""

import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.units import find_unit

__all__ = ["SHIPPED", "shipped_text"]

#: The file that the package contains.
SHIPPED = Path(__file__).parents[2] / "imucal" / "sensors" / "parts.toml"

#: A table of the collection.
Table: TypeAlias = Mapping[str, Any]

_HEAD = """\
# Noise figures from the data sheets of IMUs. Made by tests/benchmarks/sensor_parts.py; do not edit.
# 'printed' is the figure as printed; 'si' is the same in SI (the worst axis), 'si_xyz' where the axes differ.
# N, B and K are the figures to compute with, in SI. 'from' names the printed figure. B is the bias
# instability divided by 0.664. 'maximum' is a printed maximum. A missing figure is not printed in the source.
"""
#: Printed figures that are shipped, in the order of the file.
_FIGURES = (
    *("angle_random_walk", "velocity_random_walk", "noise_density", "bias_instability"),
    *("rate_random_walk", "acceleration_random_walk", "rms_noise", "low_frequency_rms_noise"),
    *("full_scale", "sensitivity", "bandwidth", "output_data_rate", "bias_tempco", "bias_over_temperature"),
)
#: Keys of a printed figure, in the order of the file.
_KEYS = ("printed", "si", "si_xyz", "kind", "condition", "definition", "source")
#: (part, sensor, figure) -> the printed maximum, with its unit; the figure's text must contain the number.
_MAXIMA = {
    ("BNO055", "accel", "noise_density"): ("190", "ug/sqrt(Hz)"),
    ("MPU-6886", "gyro", "noise_density"): ("0.01", "deg/s/sqrt(Hz)"),
    ("MPU-6886", "accel", "noise_density"): ("170", "ug/sqrt(Hz)"),
    ("VN-100", "gyro", "bias_instability"): ("10", "deg/h"),
    ("VN-200", "gyro", "bias_instability"): ("10", "deg/h"),
}
#: Part -> its note in place of the collection's; the others have none.
_NOTES = {
    "BMI088": "The data sheet prints no bias instability.",
    "MPU-6050": "MPU-6000 and MPU-6050 share one specification. GY-521 is a board with an MPU-6050. The "
    "gyroscope's density at 10 Hz misses low frequencies: the same table prints 0.033 deg/s rms from 1 to 10 "
    "Hz, which is 0.011 deg/s/sqrt(Hz) if the spectrum is flat there. Two records of one unit have 0.0093 "
    "and 0.011. imucal compares with 0.011.",
    "MTi-630": "Values of the MTi 600 series.",
    "MS-IMU3025": "14.8 mdps/sqrt(Hz) looks too large for a sensor with 2.6 deg/h. Look it up in the "
    "manufacturer's data sheet before you use it.",
    "STIM300": "STIM318 and STIM320 are other parts.",
    "ZED 2i": "The chip inside is not named in the source.",
    "BMI160": "Another source quotes 150 ug/sqrt(Hz) for the accelerometer.",
    "ISM330DHCX": "Another source quotes 6.5 mdps/sqrt(Hz) for the gyroscope.",
    "LSM6DS3TR-C": "Another source quotes 5 mdps/sqrt(Hz) for the gyroscope.",
    "ICM-45686": "The accelerometer's density is 70, 80 or 110 ug/sqrt(Hz), depending on the range; the "
    "source does not name the ranges.",
    "LSM6DSOX": "Another source quotes 110 ug/sqrt(Hz) for the accelerometer at 16 g.",
    "MPU-9250": "300 ug/sqrt(Hz) over 94 Hz is 2.9 mg, but the same table prints 8 mg rms.",
    "BMI270": "The gyroscope's 0.007 deg/s/sqrt(Hz) is for the performance mode. In normal mode it is 0.010.",
    "OpenIMU300ZA": "Parameters of the manufacturer's firmware, not of a data sheet.",
}
#: Definition of a bias instability in the collection -> in the file.
_DEFINITIONS = {
    "1 sigma; the table does not name the estimator, the data sheet plots Allan deviation": "in-run bias "
    "stability, 1 sigma; the data sheet plots Allan deviations",
    "stated as in-run bias stability; estimator not stated in the text read": "in-run bias stability; "
    "estimator not stated",
    "stated as in-run bias stability on the first page": "in-run bias stability; estimator not stated",
    "in-run bias stability of the data sheet, by the name in NaveGo": "in-run bias stability; estimator not "
    "stated",
}
#: Source -> its document, if the collection's text is a remark on where it was found.
_DOCUMENTS = {
    "adis16460": "Analog Devices ADIS16460 Data Sheet, Rev. B, 2017; Table 1",
    "lsm6dsv16x": "ST LSM6DSV16X datasheet; Table 3 mechanical characteristics",
    "bmi160b": "A report that copies the table of sensitivities of the Bosch BMI160 Datasheet",
    "icm45686": "A note that quotes TDK DS-000577 ICM-45686",
    "bmi323": "A parts catalogue that quotes Bosch BST-BMI323-DS000-13, revision 1.7; tables of both sensors",
}
#: Key of a source in the collection -> in the file.
_SOURCES = {"csdn": "blog"}
#: Devices of the collection with a source that users can look up -> the source; others are left out.
_DEVICES = {
    "RealSense D435i": "librealsense, doc/d435i.md",
    "RealSense D455": "librealsense, src/ds/ds-calib-parsers.cpp; newer ones may contain a BMI085",
    "RealSense L515": "librealsense, src/ds/ds-calib-parsers.cpp",
    "OAK-D (RVC2)": "Luxonis documentation, IMU page",
    "OAK (RVC4)": "Luxonis documentation, IMU page",
    "Livox Mid-360": "Livox specification page (ICM40609, without the last letter)",
    "Livox Avia": "Livox Avia user manual, quoted in issue 19 of Coco-LIC",
    "Ouster OS1": "README of the MCD data set, with the Ouster rev7 data sheet",
    "VI-Sensor": "README of imu_utils",
    "TUM-VI rig": "issue 176 of kalibr",
    "Oculus CV1": "comment in a program that tracks it",
    "Radiolink PIX6": "ArduPilot documentation, page of the Radiolink PIX6",
    "M5 StampFly": "README of the StampFly recordings",
}
#: Words of the collection that users can't look up.
_INTERNAL = re.compile(
    r"\bindex\b|file id|README\.txt|shared/|find_string|read_file|text layer|text conversion|csdn|\[devices\]"
    r"|the text read|https?://",
    re.IGNORECASE,
)
#: Sign in a printed figure -> the usual sign.
_SIGNS = str.maketrans({"º": "°", "μ": "µ", "−": "-", "–": "-"})
#: A remark of the collection in a printed figure.
_REMARK = re.compile(r" \((?:which belongs|rows (?:read|quoted)|only the range)[^)]*\)")
#: Short name of a sensor -> the sensor.
_SENSORS = {sensor.short: sensor for sensor in Sensor}


def shipped_text(collection: Table) -> str:
    """Return the text of the file; raises ValueError if a text is not for users."""
    lines = [_HEAD]
    for name, part in collection["parts"].items():
        lines += _part(name, part)
    for name, source in _DEVICES.items():
        lines += [f"[devices.{_key(name)}]", f"parts = {_value(collection['devices'][name]['parts'])}"]
        lines += [f"source = {_value(source)}", ""]
    lines.append("[sources]")
    for source in collection["sources"]:
        key = _SOURCES.get(source, source)
        if any(f'source = "{key}"' in line for line in lines):
            document = _DOCUMENTS.get(source, collection["sources"][source]["document"])
            lines.append(f"{key} = {_value(document)}")
    text = "\n".join([*lines, ""])
    if found := _INTERNAL.search(text):
        line = text[: found.start()].count("\n") + 1
        raise ValueError(f"line {line}: {found[0]!r} is for those who made the collection; replace the text")
    return text


def _part(name: str, part: Table) -> Iterator[str]:
    yield f"[parts.{_key(name)}]"
    head = {"manufacturer": part["manufacturer"].replace("not named in the source", "unknown")}
    head |= {"kind": part["kind"], "confidence": part["confidence"], "aliases": part.get("aliases", [])}
    head |= {"note": _NOTES.get(name, "")}
    yield from (f"{key} = {_value(value)}" for key, value in head.items() if value)
    for sensor in _SENSORS:
        yield from _sensor(name, sensor, part)
    yield ""


def _sensor(name: str, sensor: str, part: Table) -> Iterator[str]:
    figures = {key: part[sensor][key] for key in _FIGURES if part[sensor].get(key, {}).get("source")}
    if not figures:
        return
    yield f"[parts.{_key(name)}.{sensor}]"
    for symbol, level in _levels(name, sensor, part["typical"], figures).items():
        yield f"{symbol} = {_value(level)}"
    scale = {"gyro": "deg_s", "accel": "g"}[sensor]
    if ranges := figures.get("full_scale", {}).get(scale):
        yield f"full_scale_{scale} = {_value(ranges)}"
    if counts := figures.get("sensitivity", {}).get(f"lsb_per_{scale}"):
        yield f"lsb_per_{scale} = {_value(counts)}"
    yield f"[parts.{_key(name)}.{sensor}.printed]"
    for key, figure in figures.items():
        yield f"{key} = {_value(_figure(figure))}"


def _levels(name: str, sensor: str, typical: Table, figures: Table) -> dict[str, dict[str, object]]:
    """Return N, B and K of a sensor with their origin."""
    found: dict[str, dict[str, object]] = {}
    if (white := typical.get(f"{sensor}_N")) is not None:
        found["N"] = _level(name, sensor, figures, typical[f"{sensor}_N_from"], white)
        if (other := typical.get(f"{sensor}_N_alt")) is not None:
            found["N"] |= {"alternative": other, "alternative_from": "low_frequency_rms_noise"}
    if (flicker := typical.get(f"{sensor}_B")) is not None:
        found["B"] = _level(name, sensor, figures, "bias_instability", flicker)
    if (walk := typical.get(f"{sensor}_K")) is not None:
        key = "rate_random_walk" if sensor == "gyro" else "acceleration_random_walk"
        found["K"] = _level(name, sensor, figures, key, walk)
    return found


def _level(name: str, sensor: str, figures: Table, key: str, value: float) -> dict[str, object]:
    figure = figures[key]
    level: dict[str, object] = {"value": value, "from": key}
    if figure.get("kind", "typical") != "typical":
        return level | {"kind": "maximum"}
    if (printed := _MAXIMA.get((name, sensor, key))) is not None:
        number, unit = printed
        if number not in figure["printed"]:
            raise ValueError(f"{name} {sensor} {key}: {number} is not in {figure['printed']!r}")
        symbol = "B" if key == "bias_instability" else "N"
        units = TERMS[symbol].coefficient_units(_SENSORS[sensor])
        factor = (find_unit(unit, units) or ("", 0.0))[1]
        maximum = float(number) * factor / (0.664 if symbol == "B" else 1.0)
        level["maximum"] = float(f"{maximum:.5g}")
    return level


def _figure(figure: Table) -> dict[str, object]:
    made = {key: figure[key] for key in _KEYS if key in figure}
    made["source"] = _SOURCES.get(made["source"], made["source"])
    if made.get("kind") == "typical":
        del made["kind"]
    if "definition" in made:
        made["definition"] = _DEFINITIONS.get(made["definition"], made["definition"])
    made["printed"] = _REMARK.sub("", made["printed"]).translate(_SIGNS)
    if _INTERNAL.search(made.get("condition", "")):
        del made["condition"]
    return {key: made[key] for key in _KEYS if key in made}


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: object) -> str:
    """Return a value as TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def main() -> None:
    """Write the file."""
    source = Path(os.environ["IMUCAL_REAL_DATA"]) / "parts" / "parts.toml"
    SHIPPED.write_text(shipped_text(tomllib.loads(source.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
