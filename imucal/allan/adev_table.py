"""The table that `imucal adev` prints: curves of several axes below one another, in SI."""

import csv
from pathlib import Path

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.deviation_table import NamedCurve
from imucal.errors import ReadError
from imucal.recording import Sensor

COLUMNS = ("axis", "tau", "m", "adev", "low", "high", "edf")


def is_adev_table(path: Path) -> bool:
    """Say whether a file starts with the heading of such a table."""
    with path.open("rb") as stream:
        return stream.readline(200).decode("utf-8-sig", "replace").strip() == ",".join(COLUMNS)


def read_adev_table(path: Path) -> tuple[NamedCurve, ...]:
    """Return the curve of each axis, with its averaging factors and degrees of freedom.

    Raises
    ------
    ReadError
        If a line is not as `imucal adev` writes it.
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
            msg = f"{path}: axis {axis}: {error}; expected each averaging time once, rising"
            raise ReadError(msg) from error
        sensor = next((sensor for sensor in Sensor if axis.startswith(sensor.short)), None)
        curves.append(NamedCurve(name=axis, sensor=sensor, unit=sensor.unit if sensor else "", curve=curve))
    if not curves:
        msg = f"{path}: has no rows below its heading"
        raise ReadError(msg)
    return tuple(curves)
