"""Protobuf messages, by the schema in the log and the package `protobuf`, which is an extra."""

from collections.abc import Iterable, Iterator
from itertools import count
from typing import Any

from imucal.readers.containers import Channel
from imucal.readers.messages.definitions import DefinitionError, Field
from imucal.readers.messages.leaves import Leaf
from imucal.readers.messages.trees import Parse

#: A message that nests deeper than this refers to itself.
_DEEP = 8
#: Messages within messages that are looked into.
_MANY = 2000

#: Type of a number -> NumPy code, by the names of the package's constants.
_CODES = {"DOUBLE": "f8", "FLOAT": "f4", "INT32": "i4", "INT64": "i8", "UINT32": "u4", "UINT64": "u8",
          "SINT32": "i4", "SINT64": "i8", "FIXED32": "u4", "FIXED64": "u8", "SFIXED32": "i4",
          "SFIXED64": "i8"}  # fmt: skip


def parser_of(channel: Channel) -> Parse:
    """Return what parses the messages of a channel; a DefinitionError where its schema is damaged."""
    from google.protobuf.message_factory import GetMessageClass

    parse: Parse = GetMessageClass(_descriptor(channel)).FromString
    return parse


def leaves_of(channel: Channel) -> list[Leaf]:
    """Return the numbers that the messages of a channel hold."""
    return list(_leaves(_descriptor(channel), "", 0, count()))


def fields_of(channel: Channel) -> list[Field]:
    """Return the numbers as fields, to be recognised by their names; their layout is not a fixed one."""
    codes = {name.lower(): code for name, code in _CODES.items()}
    return [Field(leaf.path, "number", codes[leaf.type]) for leaf in leaves_of(channel) if leaf.type in codes]


def _descriptor(channel: Channel) -> Any:  # noqa: ANN401 - the package is an extra
    try:
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
    except ImportError as error:
        msg = "its messages are protobuf, which an extra reads; install imucal-noise[protobuf]"
        raise DefinitionError(msg) from error
    try:
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(channel.schema).file:
            pool.Add(file)
        return pool.FindMessageTypeByName(channel.type)
    except Exception as error:
        # The package has error classes of its own, and raises TypeError for what does not fit together.
        msg = f"its protobuf schema can't be read: {type(error).__name__} {error}"
        raise DefinitionError(msg) from error


def _leaves(descriptor: Any, prefix: str, depth: int, steps: Iterator[int]) -> Iterable[Leaf]:  # noqa: ANN401
    from google.protobuf.descriptor import FieldDescriptor as Kinds

    names = {getattr(Kinds, f"TYPE_{name}"): name.lower() for name in _CODES}
    for field in descriptor.fields:
        path = prefix + field.name
        if field.message_type is not None:
            if depth < _DEEP and next(steps) < _MANY:
                own = f"{path}[0]." if field.is_repeated else f"{path}."
                yield from _leaves(field.message_type, own, depth + 1, steps)
        elif field.type in names:
            yield Leaf(path, names[field.type] + ("[]" if field.is_repeated else ""))
