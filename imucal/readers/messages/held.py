"""Topics whose columns are in memory, of logs that another package reads whole."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from imucal.errors import ChoiceError
from imucal.readers.containers import Channel
from imucal.readers.messages.topics import HELD_ROWS, Column, Topic, plan_of, wanted_from
from imucal.readers.messages.trees import TIME, Leaf
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import ColumnsError

__all__ = ["HELD_ROWS", "held_topic"]


def held_topic(
    name: str,
    kind: str,
    columns: Mapping[Column, NDArray[Any]],
    options: ReadOptions,
    **more: Any,  # noqa: ANN401 - fields of `Topic`
) -> Topic:
    """Return a topic with its sensors; its first column of stamps, in ns, gives its duration."""
    arrays = tuple(columns.values())
    stamps = next((values for column, values in columns.items() if column.type == TIME), arrays[0][:0])
    first, last = (int(stamps[0]), int(stamps[-1])) if stamps.size else (None, None)
    channel = Channel(
        key=0, topic=name, type=kind, encoding="", count=arrays[0].size, first_ns=first, last_ns=last
    )
    topic = Topic(
        name=name,
        type=kind,
        channels=((0, channel),),
        leaves=tuple(Leaf(column.name, column.type) for column in columns),
        columns=tuple(columns),
        held=arrays,
        wanted=wanted_from(name, options),
        **more,
    )
    try:
        plan, _ = plan_of((), topic, options)
    except ColumnsError as error:
        # The choice of columns lists those of a file.
        return topic if topic.file or options.columns is None else replace(topic, reason=error.problem)
    except ChoiceError:
        return topic
    return replace(topic, sensors=tuple(sensor.triad.sensor for sensor in plan.sensors))
