"""The tables of a log that may contain samples: their sensors by name, and their columns, chosen once."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import PurePath

import numpy as np

from imucal.arrays import never_changes
from imucal.errors import ChoiceError, Fix
from imucal.readers.clocks import LOG_TIME
from imucal.readers.fixes import COLUMNS
from imucal.readers.messages.definitions import plain_type
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import STAMPS, Head, Table, cells_of
from imucal.readers.tables.columns import ColumnsError, NamedTable, parse_columns_text
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.plan import SensorPlan, TablePlan, find_bare_triads, find_triads, make_plan
from imucal.readers.tables.stamps import TimeChoice
from imucal.recording import Sensor

#: Times of messages that are not columns.
_CLOCKS = (None, "header", "log")
#: Packages of general vectors, read only if the user names the topic.
_GENERAL = ("geometry_msgs/", "nav_msgs/")
#: Names of commanded values, which are no measurements.
_COMMAND = re.compile(r"(^|[/_])(cmd|command|setpoint|desired|target)s?([/_]|$)")


class Candidate:
    """A table that may contain samples.

    `wanted` is the sensor for which the user named the table.
    """

    def __init__(self, table: Table, options: ReadOptions, *, wanted: Sensor | None = None) -> None:
        self.table = table
        self.wanted = wanted
        self._options = options
        #: Why it can't be read; otherwise empty.
        self.reason = table.reason
        self.fixes: tuple[Fix, ...] = table.fixes
        #: Whether it is read only if the user names it.
        self.weak = table.weak
        self._named: tuple[Sensor, ...] = ()
        if table.is_topic and not table.reason:
            self._named = self._sensors_by_name()

    @property
    def is_empty(self) -> bool:
        return self.table.count == 0

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of a topic by its names, or those of a file whose columns can be chosen."""
        if self.table.is_topic:
            return self._named
        if self.table.reason or self.is_empty:
            return ()
        try:
            return tuple(sensor.triad.sensor for sensor in self.plan.sensors)
        except ChoiceError:
            return ()

    def _sensors_by_name(self) -> tuple[Sensor, ...]:
        """Return the sensors that a topic's names contain, without reading messages."""
        table, options = self.table, self._options
        names = [column.name for column in table.columns]
        named = NamedTable.of(table.place, names, lambda _: (), units=_units(table))
        if options.columns is not None:
            try:
                triads, _, _ = parse_columns_text(options.columns, named)
            except ColumnsError as error:
                self.reason = error.wrong
                return ()
            return tuple(triad.sensor for triad in triads)
        return self._recognised(named)

    def _recognised(self, named: NamedTable) -> tuple[Sensor, ...]:
        """Return the sensors in the names of columns; a topic of general vectors becomes weak."""
        table, options = self.table, self._options
        last = plain_type(table.kind).rpartition("/")[2]
        if is_command(table.name) and "imu" not in last.lower() and table.name not in options.topics:
            return ()
        try:
            triads = find_triads(named, units_given=tuple(Sensor))
            found = {triad.sensor for triad in triads}
            bare = set() if found else set(find_bare_triads(named, self.word)[0])
        except ChoiceError:
            return ()
        if len(found) == 1 and all(len("".join(triad.columns[0].words)) == 1 for triad in triads):
            # ax, ay, az alone may be the acceleration of a position.
            return ()
        if table.log_time is not None:
            vague = bool(bare) and parse_column(f"{last}.x", 0).sensor is None
            self.weak = vague or plain_type(table.kind).startswith(_GENERAL)
        return tuple(sensor for sensor in Sensor if sensor in found | bare)

    @property
    def word(self) -> str:
        """The sensor that the user wants or that the topic or its type names; otherwise empty."""
        last = plain_type(self.table.kind).rpartition("/")[2]
        named = (parse_column(f"{name}.x", 0).sensor for name in (self.table.name, last))
        return str(next(filter(None, (self.wanted, *named)), ""))

    @cached_property
    def head(self) -> Sequence[Head]:
        return self.table.head()

    @cached_property
    def plan(self) -> TablePlan:
        """The columns to read; raises ChoiceError if they are ambiguous."""
        table, options = self.table, self._options
        named = self._named_table()
        if table.unnamed and options.columns is None:
            raise named.ask(table.unnamed)
        is_message = table.log_time is not None
        if is_message and options.time in _CLOCKS:
            options = replace(options, time=None)
        name = (self.word or table.name) if table.is_topic else PurePath(table.name).name
        plan = make_plan(named, options, name=name, shape=table.shapes)
        if table.is_topic and plan.dialect is not None:
            # The message type says it all.
            plan = replace(plan, decisions=())
        sensors = self._with_log_time(plan.sensors) if is_message else plan.sensors
        return replace(plan, sensors=tuple(self._with_stamps(sensor) for sensor in sensors))

    def _named_table(self) -> NamedTable:
        """Return the names and first cells of the columns, with the dialect of the log."""
        table = self.table
        named = NamedTable.of(
            table.place,
            [column.name for column in table.columns],
            lambda index: cells_of(self.head[index]),
            units=_units(table),
            preamble=table.preamble,
        )
        dialect = table.dialect or named.dialect
        if dialect is not None and table.log_time is not None:
            dialect = replace(dialect, unit_source="from the message type", may_be_g=False)
        return replace(named, dialect=dialect)

    def _with_log_time(self, sensors: Sequence[SensorPlan]) -> tuple[SensorPlan, ...]:
        """Use the first sensor's time for all sensors in messages, or log time."""
        log = TimeChoice(kind="ns", indices=(self.table.log_time or 0,), name=LOG_TIME)
        first = sensors[0]
        rows = first.triad.rows
        other_rows = any(sensor.triad.rows != rows for sensor in sensors)
        if other_rows or (rows is not None and (rows[0] < 0 or not is_number(rows[1]))):
            text = "messages are selected by one number for both sensors, such as @id:1"
            raise ChoiceError(text, place=self.table.place, fix=COLUMNS)
        # Log time is better than a count of samples.
        own = first.time is not None and first.time.kind != "counter" and self._options.time != "log"
        time = first.time if own else log
        return tuple(replace(sensor, time=time, log_time=log) for sensor in sensors)

    def _with_stamps(self, sensor: SensorPlan) -> SensorPlan:
        """Mark the time of a topic as complete stamps if its type says so."""
        time, columns = sensor.time, self.table.columns
        if time is None or not time.indices or time.indices[0] >= len(columns):
            return sensor
        if not self.table.is_topic or columns[time.indices[0]].unit != STAMPS:
            return sensor
        return replace(sensor, time=replace(time, kind="ns"))

    @cached_property
    def alive(self) -> frozenset[Sensor]:
        """The sensors whose first samples change; all if the columns are ambiguous."""
        try:
            sensors = self.plan.sensors
        except ChoiceError:
            return frozenset(self.sensors)
        return frozenset(one.triad.sensor for one in sensors if self._changes(one.triad.indices))

    def _changes(self, indices: Sequence[int]) -> bool:
        # Columns in files may be text.
        heads = [self.head[index] for index in indices]
        rows = [head for head in heads if isinstance(head, np.ndarray) and head.dtype.kind in "biuf"]
        return not rows or rows[0].size < 2 or not all(never_changes(row) for row in rows)


def _units(table: Table) -> list[str | None]:
    return [column.unit for column in table.columns]


def is_command(topic: str) -> bool:
    """Return whether a topic's name indicates commands instead of measurements."""
    return _COMMAND.search(topic.lower()) is not None
