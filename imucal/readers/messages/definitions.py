"""Message definitions: `.msg` text -> the flat list of fields in the order of their bytes."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

from imucal.errors import Fix
from imucal.readers.containers import Channel
from imucal.readers.files import refused, require_file

#: "other" covers structures and everything else without a fixed layout.
Kind: TypeAlias = Literal["number", "array", "string", "sequence", "other"]


class DefinitionError(Exception):
    """A message definition can't be read; the message contains the line."""

    def __init__(self, problem: str, fix: Fix | None = None) -> None:
        super().__init__(f"{problem}; {fix.text}" if fix else problem)
        self.problem = problem
        self.fixes = (fix,) if fix else ()


@dataclass(frozen=True)
class Field:
    """A field of a message, with its path such as ``header.stamp.sec``."""

    path: str
    kind: Kind
    #: NumPy code of a number without byte order, such as ``f8``.
    code: str = ""
    #: Numbers in a fixed array, or in one element of a sequence; otherwise 1.
    count: int = 1

    @property
    def size(self) -> int:
        return int(self.code[1:]) if self.code else 0


_NUMBERS = {
    **dict.fromkeys(("bool", "byte", "char"), "u1"),
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float32": "f4",
    "float64": "f8",
}
_TIMES = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
#: rosbags expects 80 characters between types, and no constants in lower case.
_SEPARATOR = re.compile(r"^=+\s*MSG:\s*", re.MULTILINE)
_CONSTANT = re.compile(r"^[ \t]*\w+(<=\d+)?[ \t]+\w+[ \t]*=.*$", re.MULTILINE)
#: Lines without a field: blank, or only a comment. rosbags takes a time that is quadratic in their number.
_EMPTY_LINE = re.compile(r"[ \t]*(#.*)?")
#: Deepest nesting of types.
_MAX_DEPTH = 16
#: Most fields, and most files of definitions.
_MAX_FIELDS = 20_000
#: Most lines visited to lay out a message, with repeats of nested types: a second.
_MAX_VISITS = 100_000
#: Longest definition, in bytes: rosbags parses 140 kB per second; those of PX4 and ROS have up to 60 kB.
_MAX_TEXT = 1 << 18
#: Longest line, in bytes: rosbags takes a time that is quadratic in the length of default values and names.
_MAX_LINE = 1 << 14


def plain_type(name: str) -> str:
    """Return ``package/Name`` of ``package/msg/Name``."""
    return name.replace("/msg/", "/")


def long_type(name: str) -> str:
    """Return ``package/msg/Name`` of ``package/Name``."""
    package, _, last = plain_type(name).rpartition("/")
    return f"{package}/msg/{last}"


@dataclass(frozen=True)
class Line:
    """One field of a definition; `kind` is a basic type or ``package/msg/Name``.

    `count` is the length of an array, None for a sequence.
    """

    kind: str
    name: str
    array: bool
    count: int | None

    @property
    def is_number(self) -> bool:
        return self.kind in _NUMBERS

    @property
    def is_text(self) -> bool:
        return self.kind in {"string", "wstring"}

    @property
    def is_time(self) -> bool:
        return self.kind in _TIMES


@dataclass(eq=False)
class Definition:
    """The definition of a message type, as parsed by rosbags.

    `given` contains texts of further types by ``package/Name``; if it is not None, standard types are known.
    """

    name: str
    types: dict[str, Any]
    ros1: bool
    given: Mapping[str, str] | None = None
    #: Lines and structures visited by `fields`.
    visits: int = 0

    def lines(self, name: str) -> list[Line]:
        if name not in self.types:
            text = definition_of(name, self.given or {})
            if text is not None:
                self.types |= _parsed(name, text)
            elif self.given is not None and name in (standard := standard_types(ros1=self.ros1)):
                self.types[name] = standard[name]
            else:
                fix = None
                if self.given is not None:
                    fix = _give_file(f"also give its .msg file, {name.rpartition('/')[2]}.msg")
                raise DefinitionError(f"type {plain_type(name)} is not defined", fix)
        return [_line(*member) for member in self.types[name][1]]

    def closure(self) -> dict[str, Any]:
        found, todo = dict[str, Any](), [self.name]
        while todo:
            name = todo.pop()
            lines = [] if name in found else self.lines(name)
            todo += [line.kind for line in lines if "/" in line.kind and not line.is_time]
            found[name] = self.types[name]
        return found

    def fields(self) -> tuple[Field, ...]:
        """Return the fields with nested ones in place; raises DefinitionError for unknown types.

        The last field is of kind "other" if its size is unknown.
        """
        self.visits = 0
        return tuple(_laid_out(self.name, self._fields(self.name)))

    def _fields(self, name: str, prefix: str = "", depth: int = 0) -> Iterator[Field]:
        lines = self.lines(name)
        # A structure without fields takes time too.
        self.visits += len(lines) + 1
        if depth > _MAX_DEPTH or self.visits > _MAX_VISITS:
            raise _too_large(name)
        if not lines and not self.ros1:
            # rosidl adds a member to a structure without members.
            yield Field(prefix + "structure_needs_at_least_one_member", "number", "u1")
        for line in lines:
            path = prefix + line.name
            if line.is_number:
                yield self._numbers(path, line)
            elif line.is_text:
                yield Field(path, "other" if line.array or line.kind == "wstring" else "string")
            elif line.is_time and line.array:
                yield Field(path, "other")
            elif line.is_time:
                yield Field(path + ".sec", "number", "u4" if self.ros1 else "i4")
                yield Field(path + ".nanosec", "number", "u4")
            else:
                yield from self._structures(line.kind, path, line, depth + 1)

    def _numbers(self, path: str, line: Line) -> Field:
        code = "i1" if self.ros1 and line.kind == "byte" else _NUMBERS[line.kind]
        if not line.array:
            return Field(path, "number", code)
        return Field(path, "sequence", code) if line.count is None else Field(path, "array", code, line.count)

    def _structures(self, nested: str, path: str, line: Line, depth: int) -> Iterator[Field]:
        if not line.array:
            yield from self._fields(nested, path + ".", depth)
        elif line.count is None:
            # Only structures with numbers of a single size have a layout.
            inner = _laid_out(nested, self._fields(nested, path + "[].", depth))
            if len({one.size for one in inner}) == 1 and {one.kind for one in inner} <= {"number", "array"}:
                yield Field(path, "sequence", inner[0].code, sum(one.count for one in inner))
            else:
                yield Field(path, "other")
        elif line.count > _MAX_FIELDS:
            raise DefinitionError(f"{path} has {line.count} elements")
        else:
            for i in range(line.count):
                yield from self._fields(nested, f"{path}[{i}].", depth)


def _laid_out(name: str, fields: Iterator[Field]) -> list[Field]:
    found = []
    for field in fields:
        found.append(field)
        if len(found) > _MAX_FIELDS:
            raise _too_large(name)
        if field.kind == "other":
            break
    return found


def _too_large(name: str) -> DefinitionError:
    return DefinitionError(f"{plain_type(name)} nests too deeply or has too many fields")


def _line(name: str, kind: Any) -> Line:  # noqa: ANN401 - rosbags nests tuples
    node, inner = kind[0].name, kind[1]
    array = node in {"ARRAY", "SEQUENCE"}
    element, base = inner[0] if array else kind
    base = base if element.name == "NAME" else base[0]
    base = "wstring" if base.endswith("/wstring") else base
    return Line(base, name, array, inner[1] if node == "ARRAY" else None)


@lru_cache(1000)
def _parsed(name: str, text: str) -> Mapping[str, Any]:
    from rosbags.typesys import get_types_from_msg

    if len(text) > _MAX_TEXT:
        raise DefinitionError(f"it has {len(text)} bytes; expected at most {_MAX_TEXT}")
    lines = [line for line in text.splitlines() if not _EMPTY_LINE.fullmatch(line)]
    longest = max(map(len, lines), default=0)
    if longest > _MAX_LINE:
        raise DefinitionError(f"a line has {longest} bytes; expected at most {_MAX_LINE}")
    text = _CONSTANT.sub("", "\n".join(lines).rstrip("= \n") + "\n")
    try:
        return get_types_from_msg(_SEPARATOR.sub("=" * 80 + "\nMSG: ", text), name)
    except Exception as error:
        # The fourth line of rosbags' error contains the text that it could not parse.
        rest = [*str(error).splitlines(), "", "", "", ""][3]
        raise DefinitionError(f"line {rest.strip()[:60]!r} is not a field") from error


def standard_types(*, ros1: bool) -> Mapping[str, Any]:
    """Return ROS's own types."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST).fielddefs


def defined(name: str, text: str, *, ros1: bool, given: Mapping[str, str] | None = None) -> Definition:
    """Return the definition of a type from its text; raises DefinitionError if it can't be read."""
    name = long_type(name)
    return Definition(name, dict(_parsed(name, text)), ros1, given)


def built_in(name: str, *, ros1: bool) -> Definition | None:
    """Return the definition of a standard ROS type; None for others."""
    name, types = long_type(name), standard_types(ros1=ros1)
    return Definition(name, dict(types), ros1) if name in types else None


def read_definitions(paths: Sequence[Path]) -> dict[str, str]:
    """Return the definitions in files and folders: ``package/Name`` -> text; raises ReadError.

    The package is the folder above ``msg/``.
    """
    found = {}
    for path in paths:
        files = sorted(path.rglob("*.msg"))[:_MAX_FIELDS] if path.is_dir() else [path]
        if not files:
            raise refused(path, "no .msg files in this folder; expected the definitions of message types")
        for file in files:
            require_file(file)
            size = file.stat().st_size
            if size > _MAX_TEXT:
                raise refused(
                    file, f"it has {size} bytes; expected a message definition of at most {_MAX_TEXT}"
                )
            try:
                text = file.read_text(encoding="utf-8-sig")
            except (OSError, UnicodeDecodeError) as error:
                raise refused(file, f"can't be read: {error}; expected a message definition") from error
            folder = file.resolve().parent
            package = folder.parent.name if folder.name == "msg" else ""
            name = re.split(r"[/.]|__", file.name.removesuffix(".msg"))[-1]
            found[f"{package}/{name}"] = text
    return found


def definition_of(kind: str, given: Mapping[str, str]) -> str | None:
    """Return the given definition of a type, with or without a package; otherwise None."""
    name = plain_type(kind)
    return given.get(name, given.get("/" + name.rpartition("/")[2]))


def definition_of_channel(channel: Channel, given: Mapping[str, str]) -> Definition:
    """Return the definition of a channel's type from the log, from `given`, or from the standard types.

    Raises DefinitionError if it is missing or unreadable.
    """
    ros1 = channel.encoding == "ros1"
    standard: Definition | None = None
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        try:
            own = defined(channel.type, channel.definition, ros1=ros1)
            own.fields()
        except DefinitionError:
            # The standard type replaces a damaged definition; messages must match its size.
            standard = built_in(channel.type, ros1=ros1)
            if standard is None:
                raise
        else:
            return own
    elif (text := definition_of(channel.type, given)) is not None:
        return defined(channel.type, text, ros1=ros1, given=given)
    standard = standard or built_in(channel.type, ros1=ros1)
    if standard is not None:
        return standard
    kind = f", except one of kind {channel.definition_kind!r}" if channel.definition_kind else ""
    others = ", ".join(sorted(name.strip("/") for name in given)[:8])
    names = f"; the given ones define {others}" if given else ""
    last = plain_type(channel.type).rpartition("/")[2]
    missing = f"the log has no definition of {channel.type}{kind}{names}"
    raise DefinitionError(missing, _give_file(f"give its .msg file, {last}.msg"))


def _give_file(text: str) -> Fix:
    return Fix(text, "message_definition", "FILE")
