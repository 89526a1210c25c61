"""Schemas of messages parsed into trees: list their numbers, and create parsers.

rosbags parses ROS messages with lists of structures; Protobuf messages need the package `protobuf`, an extra.
"""

from collections.abc import Iterable, Iterator
from itertools import count
from typing import Any

from imucal.readers.containers import Channel
from imucal.readers.messages.definitions import Definition, DefinitionError, standard_types
from imucal.readers.messages.trees import TIME, Leaf, Parse, is_time

#: Deepest nesting; types may refer to themselves.
_MAX_DEPTH = 8
#: Most lines of a definition visited, with repeats of nested types.
_MAX_LINES = 4000
#: Most nested messages of a Protobuf type visited, with repeats.
_MAX_MESSAGES = 2000
#: Most fields of a Protobuf message visited, with repeats of nested types: 0.2 s.
_MAX_FIELDS = 20_000
#: Largest set of Protobuf descriptors, in bytes: those of Foxglove's messages have at most 20 kB.
_MAX_DESCRIPTORS = 1 << 20
_NUMBERS = ("DOUBLE", "FLOAT", "INT32", "INT64", "UINT32", "UINT64", "SINT32", "SINT64", "FIXED32", "FIXED64",
            "SFIXED32", "SFIXED64")  # fmt: skip


def ros_leaves(known: Definition) -> list[Leaf]:
    """Return the numbers in a message type; raises DefinitionError."""
    return list(_ros_leaves(known, known.name, "", 0, count()))


def _ros_leaves(
    known: Definition, name: str, prefix: str, depth: int, steps: Iterator[int]
) -> Iterator[Leaf]:
    for line in known.lines(name):
        if next(steps) >= _MAX_LINES:
            return
        path = prefix + line.name
        own = f"{path}[0]" if line.array else path
        if line.is_number:
            brackets = f"[{'' if line.count is None else line.count}]" if line.array else ""
            yield Leaf(path, line.kind + brackets)
        elif line.is_time:
            yield Leaf(own, TIME)
        elif not line.is_text and depth < _MAX_DEPTH:
            yield from _ros_leaves(known, line.kind, f"{own}.", depth + 1, steps)


def ros_parser(known: Definition) -> Parse:
    """Return the parser for a message type; raises DefinitionError."""
    from rosbags.typesys import Stores, get_typestore

    try:
        store = get_typestore(Stores.EMPTY)
        store.register({**standard_types(ros1=known.ros1), **known.closure()})
    except DefinitionError:
        raise
    except Exception as error:
        # rosbags has its own error classes.
        why = " ".join(str(error).split())[:80]
        raise DefinitionError(f"its definition can't be read: {type(error).__name__} {why}") from error
    read = store.deserialize_ros1 if known.ros1 else store.deserialize_cdr
    return lambda data: read(data, known.name)


def protobuf_parser(channel: Channel) -> Parse:
    """Return the parser for a channel's messages; raises DefinitionError."""
    from google.protobuf.message_factory import GetMessageClass

    parse: Parse = GetMessageClass(_descriptor(channel)).FromString
    return parse


def protobuf_leaves(channel: Channel) -> list[Leaf]:
    """Return the numbers in a channel's messages."""
    return list(_protobuf_leaves(_descriptor(channel), "", 0, count(), count()))


def _descriptor(channel: Channel) -> Any:  # noqa: ANN401 - the package is an extra
    try:
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
    except ImportError as error:
        msg = "its messages are protobuf, which an extra reads; install imucal-noise[protobuf]"
        raise DefinitionError(msg) from error
    size = len(channel.schema)
    if size > _MAX_DESCRIPTORS:
        raise DefinitionError(f"its protobuf schema has {size} bytes; expected at most {_MAX_DESCRIPTORS}")
    try:
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(channel.schema).file:
            pool.Add(file)
        return pool.FindMessageTypeByName(channel.type)
    except Exception as error:
        # The package raises its own errors, and TypeError.
        raise DefinitionError(f"its protobuf schema can't be read: {type(error).__name__} {error}") from error


def _protobuf_leaves(
    descriptor: Any,  # noqa: ANN401 - of the extra
    prefix: str,
    depth: int,
    messages: Iterator[int],
    fields: Iterator[int],
) -> Iterable[Leaf]:
    from google.protobuf.descriptor import FieldDescriptor as Kinds

    names = {getattr(Kinds, f"TYPE_{name}"): name.lower() for name in _NUMBERS}
    for field in descriptor.fields:
        if next(fields) >= _MAX_FIELDS:
            return
        path = prefix + field.name
        nested = field.message_type
        # Listing the names of many fields for each use of a type is slow; a time has two.
        if nested is not None and len(nested.fields) == 2 and is_time([part.name for part in nested.fields]):
            yield Leaf(f"{path}[0]" if field.is_repeated else path, TIME)
        elif nested is not None:
            if depth < _MAX_DEPTH and next(messages) < _MAX_MESSAGES:
                own = f"{path}[0]." if field.is_repeated else f"{path}."
                yield from _protobuf_leaves(nested, own, depth + 1, messages, fields)
        elif field.type in names:
            yield Leaf(path, names[field.type] + ("[]" if field.is_repeated else ""))
