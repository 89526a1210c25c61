"""Formats that imucal knows by name and does not read."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_CSV = "export it as CSV, with a row for each sample"
_CSV_WITH_RATE = "write it as CSV with a row for each sample, and give the sampling rate"
_UNPACK = "unpack it, and give the log in it"


class Foreign(NamedTuple):
    """A format that imucal does not read: the start of its files, its name, and what to do."""

    start: bytes
    name: str
    way: str = _CSV

    @property
    def advice(self) -> str:
        return f"it is {self.name}; {self.way}"


#: Binary formats; the first match is used.
BINARY = (
    Foreign(rb"PK\x03\x04.{26,60}(\[Content_Types\]\.xml|_rels/|docProps/|xl/)", "an Excel workbook"),
    Foreign(rb"PK\x03\x04.{26}mimetypeapplication/vnd\.oasis", "an OpenDocument spreadsheet"),
    Foreign(rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an old Excel workbook"),
    Foreign(
        rb"H Product:Blackbox flight data recorder",
        "a blackbox of Betaflight, INAV or Cleanflight",
        "decode it with blackbox_decode, which writes a CSV",
    ),
    Foreign(
        rb"\x80[\x02-\x05]",
        "a Python pickle, which may run any program when it is loaded",
        "if you trust it, save its arrays with numpy.savez",
    ),
    Foreign(rb"\x93NUMPY.{4}\{'descr': '\|O'", "an array of Python objects", "save it with numbers as dtype"),
    Foreign(rb"ARROW1", "an Arrow (Feather) file", "write it as Parquet or CSV"),
    Foreign(rb"TDSm", "a TDMS file of National Instruments"),
    Foreign(
        # Time in µs since 1970 (years 2001 to 2041), then the start of a packet.
        rb"\x00[\x03-\x07].{6}[\xfd\xfe]",
        "telemetry of MAVLink (.tlog)",
        "give the board's own log (DataFlash, .bin), which has all samples",
    ),
    Foreign(rb"\xfa\xff", "Xsens' binary messages", "open it in MT Manager and export it as ASCII"),
    Foreign(rb"ue[\x80-\xff]", "MicroStrain's binary packets", "export it as CSV from SensorConnect"),
    Foreign(
        rb"\xaa\x44[\x12\x13]", "NovAtel's binary messages", "convert them to ASCII with NovAtel Convert"
    ),
    Foreign(rb"....ftyp", "a video", "extract its telemetry as CSV with a program for your camera"),
    Foreign(rb"Rar!|7z\xbc\xaf\x27\x1c", "an archive", _UNPACK),
    Foreign(rb".{257}ustar", "an archive", _UNPACK),
)
_OF_A_REPORT = (
    "expected a log; to use the report run 'imucal export REPORT --to kalibr', or check, plan or drift"
)
#: Columns of deviations could be mistaken for a log.
CURVES = (
    Foreign(rb"\s*axis,tau,m,adev,", "a table of imucal adev", "give the log from which it was computed"),
    Foreign(
        rb'(?i)\s*"?(taus?|averaging[ _]time)\s*([\[(][^\n,;\t"]*)?"?\s*[,;\t]',
        "a table of Allan deviations",
        "give the log from which it was computed; in Python, imucal.fit takes an imucal.allan.AllanCurve",
    ),
)
#: Texts of loggers that imucal could mistake for a table.
LOGGERS = (
    Foreign(
        rb".{0,20000}?\bFMT, *\d+, *\d+, *IMU *,", "a text log of ArduPilot", "give the binary log (.bin)"
    ),
    Foreign(
        rb".{0,20000}?# *(Uncal)?Gyro *, *utcTimeMillis",
        "a log of GnssLogger",
        "write the rows of each sensor to a CSV of its own, and give both files",
    ),
    Foreign(
        # Two rows of three equal numbers: seconds since 1970 and the rate.
        rb"\s*(1\d{9}(?:\.0+)?)(?:, ?\1){2}\s*\n\s*(\d+(?:\.0+)?)(?:, ?\2){2}\s*\n",
        "a log of Empatica: row 1 contains the start time, row 2 the sampling rate in Hz",
        "replace both rows by a header such as ax,ay,az, and give the rate and the scale 0.1532 (1/64 g)",
    ),
    Foreign(rb"\s*\[\s*\[\s*[-+.\d]", "JSON with a list for each row"),
    Foreign(
        rb"[^\n]{0,99}[%#]RAWIMUS?X?A,",
        "a text log of NovAtel with counts of increments, accelerometer first, as z, -y, x",
        "write it as CSV, and give as scales the size of a count times the sampling rate",
    ),
    Foreign(
        rb"[^\n]{0,99}[%#]CORRIMUSA,",
        "a text log of NovAtel with increments of angle and of velocity without gravity",
        "write it as CSV, and give the units rad and m/s",
    ),
    Foreign(
        rb"[^\n]{0,40}\d\d:\d\d:\d\d\.\d+ -> ",
        "the text of a serial monitor, with a time before an arrow",
        "replace the arrow by a comma",
    ),
    Foreign(
        rb"\s*[A-Za-z_]\w*:[-+.\d]+(,\s*[A-Za-z_]\w*:[-+.\d]+)+\s*\n",
        "the text of a serial plotter, with a name before each number",
        _CSV_WITH_RATE,
    ),
    Foreign(
        rb"\s*Acceleration X: [^\n]*\n\s*(Rotation|Gyro) X: ",
        "the text of an example of Adafruit, with a line for each sensor",
        _CSV_WITH_RATE,
    ),
    Foreign(rb"[^\n]{0,99}\$VN(YMR|IMU),", "a log of VectorNav's messages", _CSV_WITH_RATE),
)
#: Use these only if reading fails: the texts may be partly readable.
TEXTS = (
    Foreign(
        rb"version https://git-lfs\.github\.com/",
        "a pointer of Git LFS, not the log",
        "type: git lfs pull, in the folder of its repository",
    ),
    Foreign(rb"\s*\{\s*\"schema\":\s*\"imucal/report/", "a report of imucal", _OF_A_REPORT),
    Foreign(rb"\s*\{\s*['\d]", "lines of Python dicts", "write each line as JSON, or all as CSV"),
    Foreign(
        rb"\s*\[\s*\{|\s*\{\s*\"", "JSON in one piece", "write an object in each line, or all rows as CSV"
    ),
)
#: File in a folder without logs -> description of the folder, and advice.
FOLDERS = {"report.json": f"a report of imucal; {_OF_A_REPORT}"}
#: Pattern of the files of results in the folder of a fleet.
FLEET_FILES = "run-*.fleet"
_A_FLEET = "it is a fleet of imucal; give a log, or run 'imucal fleet report'"
_OXTS = (
    "it is a folder of KITTI's oxts, with a file for each sample; join the files of data/ to one text with a "
    "row for each sample, and give the columns g=17:20,a=11:14, the units rad/s and m/s^2, and the rate"
)
#: These are found only while an NPZ file is read.
OBJECTS_IN_NPZ = Foreign(b"", "arrays of Python objects", "save them with numbers as dtype")


def advice_on_folder(path: Path) -> str:
    """Return the kind of a folder that imucal does not read and the advice, or an empty text."""
    if any(path.glob(FLEET_FILES)):
        return _A_FLEET
    return _OXTS if (path / "timestamps.txt").is_file() and (path / "data").is_dir() else ""


def advice_on(start: bytes, known: Sequence[Foreign] = BINARY) -> str:
    """Return the name of the format with this start and the advice, or an empty text."""
    found = next((one for one in known if re.match(one.start, start, re.DOTALL)), None)
    return found.advice if found else ""
