"""Tables of Allan deviations, from another tool or from `imucal adev`."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.frozen import frozen_alone
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, pretty

#: Heading of the table that `imucal adev` prints: the curves of several axes, one after the other, in SI.
COLUMNS = ("axis", "tau", "m", "adev", "low", "high", "edf")

_TAU = re.compile(r"(tau|taus|time|t|averaging[ _]?time|cluster[ _]?time)\b", re.IGNORECASE)
_VARIANCE = re.compile(r"avar|variance", re.IGNORECASE)
_OTHER = re.compile(
    r"(m|n|edf|samples|low|high|lower|upper|err\w*|model\w*|ci\w*)\b|.*_(low|high|edf)\b", re.IGNORECASE
)
_SENSORS = (
    (Sensor.GYROSCOPE, re.compile(r"gyr|angular|rate|omega|^w_?[xyz]\b", re.IGNORECASE)),
    (Sensor.ACCELEROMETER, re.compile(r"acc|specific|^a_?[xyz]\b", re.IGNORECASE)),
)
_UNIT = re.compile(r"[\[(]([^\])]+)[\])]\s*$")
#: Averaging times are treated as multiples of the shortest if they are within this fraction.
_MULTIPLE = 0.02
#: For other averaging times the grid step is the shortest one divided by this.
_FINE = 1000


@frozen_alone
class NamedCurve:
    """One column of deviations: its heading without the unit, or ``column 2`` … if there are no headings.

    `sensor` is taken from the heading or the unit, None if neither names it. `unit` is the unit of `curve`:
    SI, or an empty string if the table gives no known unit. `findings` lists the assumptions made.
    """

    name: str
    sensor: Sensor | None
    unit: str
    curve: AllanCurve
    findings: tuple[Finding, ...] = ()


def read_curve(path: str | Path, *, rate_hz: float | None = None) -> tuple[NamedCurve, ...]:
    """Read a table whose first column is tau in s and whose other columns are Allan deviations.

    Columns are separated by commas, semicolons, tabs or spaces. Lines that start with ``#`` or ``%`` are
    skipped. The first line may contain headings for the averaging time (``tau``), deviations, or variances
    (``avar``); a unit may follow in brackets, such as ``gyro_x [deg/s]``. Columns of counts, degrees of
    freedom and limits are ignored.

    `rate_hz` is the sampling rate of the samples. Without it, the shortest averaging time is the sampling
    period if the others are its multiples. A file that cannot be read, is not such a table, or contains an
    unknown unit is a ReadError.
    """
    path = Path(path)
    headings, rows = _parse(path)
    first = next((i for i, heading in enumerate(headings) if _TAU.match(heading.strip())), 0)
    rows = rows[np.argsort(rows[:, first], kind="stable")]
    tau = rows[:, first]
    _require_times(path, tau)
    m, findings = _factors(tau, rate_hz)
    curves = []
    for heading, values in zip(headings, rows.T, strict=True):
        name = _UNIT.sub("", heading).strip()
        if heading is headings[first] or _OTHER.fullmatch(name):
            continue
        good = np.isfinite(values) & (values > 0)
        if not good.any():
            raise ReadError(f"{path}: column {heading!r} has no positive number; expected Allan deviations")
        sensor, factor = _meaning(path, heading, name)
        avar = values[good] ** (1 if _VARIANCE.search(heading) else 2) * (factor or 1.0) ** 2
        edf = np.full(avar.size, np.nan)
        curve = AllanCurve(tau=tau[good], m=m[good], avar=avar, edf=edf, n=0, computed="given")
        known = sensor.unit if sensor and factor else ""
        curves.append(NamedCurve(name=name, sensor=sensor, unit=known, curve=curve, findings=findings))
    if not curves:
        msg = f"{path}: no column of deviations next to {headings[first]!r}; found {', '.join(headings)}"
        raise ReadError(msg)
    return tuple(curves)


def _parse(path: Path) -> tuple[list[str], FloatArray]:
    """Return the headings and the numbers, shape (rows, columns); missing numbers are NaN."""
    fields = _fields(path)
    if all(len(cells) > 1 and not cells[-1] for _, cells in fields):
        # Every line ends with a separator: drop the empty last column.
        fields = [(i, cells[:-1]) for i, cells in fields]
    headings = fields.pop(0)[1] if _number(fields[0][1][0]) is None else []
    width = len(fields[0][1]) if fields else 0
    if len(fields) < 2 or width < 2:
        msg = (
            f"{path}: has {len(fields)} rows of {width} columns; expected at least 2 rows of tau and "
            "one or more deviations"
        )
        raise ReadError(msg)
    headings = headings or ["tau", *(f"column {i}" for i in range(2, width + 1))]
    rows = [_numbers(f"{path}:{line}", headings, cells) for line, cells in fields]
    return headings, np.array(rows, dtype=np.float64)


def _fields(path: Path) -> list[tuple[int, list[str]]]:
    """Return the number and the cells of each line that is not a comment."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ReadError(f"{path}: can't be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        msg = f"{path}: is not a text table (byte {error.start} is not UTF-8); expected tau and deviations"
        raise ReadError(msg) from error
    fields = []
    for i, line in enumerate(map(str.strip, text.splitlines()), start=1):
        if line and line[0] not in "#%":
            separator = next((mark for mark in ",;\t" if mark in line), None)
            cells = line.split(separator)
            fields.append((i, [cell.strip().strip('"') for cell in cells] if separator else cells))
    if not fields:
        raise ReadError(f"{path}: is empty; expected a table of tau and deviations")
    return fields


def _numbers(where: str, headings: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of a line."""
    if len(cells) != len(headings):
        msg = f"{where}: has {len(cells)} columns, other lines have {len(headings)}; expected the same number"
        raise ReadError(msg)
    numbers = []
    for heading, cell in zip(headings, cells, strict=True):
        number = np.nan if cell.lower() in {"", "na", "n/a", "null"} else _number(cell)
        if number is None:
            raise ReadError(f"{where}: column {heading!r} is {cell!r}, expected a number")
        numbers.append(number)
    return numbers


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _require_times(path: Path, tau: FloatArray) -> None:
    if not np.all(np.isfinite(tau)) or tau[0] <= 0:
        msg = f"{path}: averaging times must be positive numbers in s, got {tau[0]:g} to {tau[-1]:g}"
        raise ReadError(msg)
    equal = np.flatnonzero(np.diff(tau) == 0)
    if equal.size:
        raise ReadError(f"{path}: averaging time {tau[equal[0]]:g} s is duplicated; expected each once")


def _factors(tau: FloatArray, rate_hz: float | None) -> tuple[IntArray, tuple[Finding, ...]]:
    """Return the averaging factors, and a finding if the sampling period was assumed."""
    tau0 = 1 / rate_hz if rate_hz else float(tau[0])
    ratio = tau / tau0
    factors = np.maximum(np.round(ratio), 1.0)
    multiples = bool(np.all(np.abs(ratio - factors) <= _MULTIPLE * factors))
    if multiples and rate_hz:
        return factors.astype(np.int64), ()
    if multiples:
        text, advice = f"The sampling period is assumed to be the shortest averaging time, {tau0:.6g} s.", ""
    else:
        factors, advice = np.round(tau / tau[0] * _FINE), "Give the sampling rate."
        text = (
            f"Averaging times are not multiples of {tau0:.6g} s, so the sampling period is unknown. The fit "
            "assumes continuous noise."
        )
    note = Finding("info", "sampling-period", text, advice)
    return factors.astype(np.int64), (note,)


def _meaning(path: Path, heading: str, name: str) -> tuple[Sensor | None, float | None]:
    """Return the sensor and the factor to SI; None if unknown."""
    unit = _UNIT.search(heading)
    if unit is None:
        return next((sensor for sensor, pattern in _SENSORS if pattern.search(name)), None), None
    known = {name: (sensor, factor) for sensor, of in SAMPLE_UNITS.items() for name, factor in of.items()}
    for spelled, meaning in known.items():
        if unit[1].replace(" ", "") in {spelled, pretty(spelled)}:
            return meaning
    raise ReadError(
        f"{path}: column {heading!r} is in {unit[1].strip()!r}; expected one of {', '.join(known)}"
    )


def is_adev_table(path: Path) -> bool:
    """Return whether a file starts with the heading of the table that `imucal adev` prints."""
    with path.open("rb") as stream:
        return stream.readline(200).decode("utf-8-sig", "replace").strip() == ",".join(COLUMNS)


def read_adev_table(path: Path) -> tuple[NamedCurve, ...]:
    """Return the curve of each axis, with its averaging factors and degrees of freedom.

    A line that does not match the format of `imucal adev` is a ReadError.
    """
    rows: dict[str, list[list[float]]] = {}
    with path.open(encoding="utf-8-sig", newline="") as stream:
        for cells in list(csv.reader(stream))[1:]:
            try:
                axis, tau, m, adev, _, _, edf = cells
                rows.setdefault(axis, []).append([float(tau), float(m), float(adev), float(edf or "nan")])
            except ValueError as error:
                msg = f"{path}: a line is {','.join(cells)!r}; expected values of {', '.join(COLUMNS)}"
                raise ReadError(msg) from error
    curves = []
    for axis, values in rows.items():
        tau, m, adev, edf = np.array(values).T
        try:
            curve = AllanCurve(tau=tau, m=m.astype(np.int64), avar=adev**2, edf=edf, n=0, computed="given")
        except ValueError as error:
            msg = f"{path}: axis {axis}: {error}; expected each averaging time once, in increasing order"
            raise ReadError(msg) from error
        sensor = next((sensor for sensor in Sensor if axis.startswith(sensor.short)), None)
        curves.append(NamedCurve(name=axis, sensor=sensor, unit=sensor.unit if sensor else "", curve=curve))
    if not curves:
        raise ReadError(f"{path}: has no rows below its heading")
    return tuple(curves)
