"""Which numbers of a log are the samples of its IMU: the columns of each sensor, and their unit."""

from collections.abc import Sequence
from dataclasses import dataclass

from imucal.calibration.applying import unit_factor
from imucal.errors import DataError
from imucal.readers.choose import Choice
from imucal.readers.table import Table
from imucal.readers.tables.layout import Rows
from imucal.readers.tables.stamps import TimeChoice
from imucal.recording import AXES, RAW_COUNTS, Recording, Sensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """The columns of the x, y and z axis of a sensor in a table.

    A number of the log times `factor` is in SI units, or a count; a corrected one is divided by `result`,
    which is 1 for counts: there is no count for a corrected value.
    """

    sensor: Sensor
    table: Table
    indices: tuple[int, ...]
    factor: float
    result: float
    time: TimeChoice | None
    rows: Rows


def targets_of(choices: Sequence[Choice], recording: Recording) -> list[Target]:
    """Return the samples of a log; raises DataError if a sensor lacks an axis."""
    found = []
    for choice in choices:
        for plan in choice.plan.sensors:
            triad = plan.triad
            sensor = triad.sensor
            if tuple(triad.axes) != AXES:
                problem = f"the {sensor} has only the axes {', '.join(triad.axes)}, expected x, y and z"
                raise DataError(problem, place=recording.source.path)
            factor = unit_factor(recording, sensor)
            counts = recording.source.values.get(f"{sensor} unit") == RAW_COUNTS
            found.append(
                Target(
                    sensor=sensor,
                    table=choice.table,
                    indices=triad.indices,
                    factor=factor,
                    result=1.0 if counts else factor,
                    time=plan.time,
                    rows=triad.rows,
                )
            )
    return found
