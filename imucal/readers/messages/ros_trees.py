"""ROS messages as trees, by rosbags: the way to fields that stand in or behind lists of structures."""

from collections.abc import Iterator
from itertools import count
from typing import Any

from imucal.readers.messages.definitions import ChannelDefinition, DefinitionError, Definitions
from imucal.readers.messages.leaves import Leaf
from imucal.readers.messages.trees import Parse

#: A type that nests deeper than this is not shown further, nor one of more lines than this.
_DEEP, _MANY = 8, 4000


def leaves_of(given: ChannelDefinition) -> list[Leaf]:
    """Return the numbers in messages of a type; a DefinitionError where its definition can't be read."""
    known = Definitions(given.channel.type, given.text, ros1=given.ros1, more=given.more)
    return list(_leaves(known, known.name, "", 0, count()))


def _leaves(known: Definitions, name: str, prefix: str, depth: int, steps: Iterator[int]) -> Iterator[Leaf]:
    """Yield the numbers of a type at a prefix; `steps` counts the lines that were looked at."""
    for line in known.lines(name):
        if next(steps) >= _MANY:
            return
        path = prefix + line.name
        own = f"{path}[0]" if line.array else path
        if line.is_number:
            brackets = f"[{'' if line.count is None else line.count}]" if line.array else ""
            yield Leaf(path, line.kind + brackets)
        elif line.is_time:
            yield Leaf(f"{own}.sec", "int32")
            yield Leaf(f"{own}.nanosec", "uint32")
        elif not line.is_text and depth < _DEEP:
            yield from _leaves(known, known.resolve(name, line.kind), f"{own}.", depth + 1, steps)


def parser_of(given: ChannelDefinition) -> Parse:
    """Return what parses messages of a type; a DefinitionError where its definition can't be read."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = _long(given.channel.type)
    try:
        own: dict[str, Any] = {}
        package = name.partition("/")[0]
        for other, body in (given.more or {}).items():
            own |= get_types_from_msg(body, _long(other if other[0] != "/" else package + other))
        own |= get_types_from_msg(given.text, name)
        standard = get_typestore(Stores.ROS1_NOETIC if given.ros1 else Stores.LATEST).fielddefs
        store = get_typestore(Stores.EMPTY)
        store.register({**{kind: fields for kind, fields in standard.items() if kind not in own}, **own})
    except Exception as error:
        # rosbags has error classes of its own.
        why = " ".join(str(error).split())[:80]
        msg = f"its definition can't be read: {type(error).__name__} {why}"
        raise DefinitionError(msg) from error

    def parse(data: bytes) -> Any:  # noqa: ANN401 - rosbags makes the types
        return store.deserialize_ros1(data, name) if given.ros1 else store.deserialize_cdr(data, name)

    return parse


def _long(name: str) -> str:
    package, _, last = name.partition("/")
    return name if "/msg/" in name else f"{package}/msg/{last}"
