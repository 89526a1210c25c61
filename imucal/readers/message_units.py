"""The axes and the unit of samples in messages: from the type, as given, or as a table's columns have it."""

from imucal.clock import Clock
from imucal.errors import ChoiceError
from imucal.readers.builder import RecordingBuilder
from imucal.readers.column_store import Columns
from imucal.readers.messages import Topic
from imucal.readers.read_options import ReadOptions
from imucal.recording import AXES, Axis, Sensor
from imucal.units import SAMPLE_UNITS


def inferred_scales(
    work: RecordingBuilder, topic: Topic, columns: Columns, clock: Clock, options: ReadOptions
) -> dict[Sensor, tuple[float, str]]:
    """Return what turns samples of fields that a user named into SI: as a table's columns have it.

    Raises
    ------
    ChoiceError
        If a unit is open.
    """
    # Few logs of messages need what reads tables, and it takes longer to load than such a log to read.
    from imucal.readers.tables.columns import Triad
    from imucal.readers.tables.scales import Unscaled, Work, find_scales

    vectors = {vector.sensor: vector for vector in (topic.imu.vectors if topic.imu else ())}
    table = Work(path=f"{work.path}: topic {topic.name}", options=options, dialect=None, rate_hz=None)
    timed = [
        Unscaled(
            triad=Triad(
                sensor=sensor,
                indices=tuple(range(len(vectors[sensor].axes))),
                headers=vectors[sensor].axes,
                unit=vectors[sensor].unit,
                axes=vectors[sensor].axes,
            ),
            axes=list(rows),
            temperature=None,
            clock=clock,
        )
        for sensor, rows in columns.vectors.items()
    ]
    factors = find_scales(table, timed)
    work.findings += table.findings
    reasons = dict(table.decisions)
    return {sensor: (factor, reasons[f"{sensor} unit"]) for sensor, factor in factors.items()}


def si_factor(sensor: Sensor, topic: Topic, options: ReadOptions) -> tuple[float, str]:
    """Return what turns samples into SI, and why."""
    unit, scale = options.unit_of(sensor), options.scale_of(sensor)
    if scale is not None:
        return scale, f"{scale:g} {sensor.unit} per count, given"
    if unit is not None:
        if unit not in SAMPLE_UNITS[sensor]:
            known = ", ".join(SAMPLE_UNITS[sensor])
            msg = f"the unit {unit!r} of the {sensor} is not known; expected one of {known}"
            raise ChoiceError(msg)
        return SAMPLE_UNITS[sensor][unit], f"{unit}, given"
    standard = topic.imu is not None and topic.imu.standard
    how = "from the message type" if standard else "assumed for this message type"
    return 1.0, f"{sensor.unit}, {how}"


def axes_of(topic: Topic, sensor: Sensor) -> tuple[Axis, ...]:
    """Return the axes of a sensor that the messages hold."""
    vectors = topic.imu.vectors if topic.imu is not None else ()
    return next((vector.axes for vector in vectors if vector.sensor is sensor), AXES)
