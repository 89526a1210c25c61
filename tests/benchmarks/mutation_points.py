"""Where a line can be broken, and how: one operator, sign, word or number replaced at its exact place.

Left alone, because no test could or should notice:

- annotations, decorators, type aliases, ``__all__`` and what stands under ``if TYPE_CHECKING``;
- error texts: what stands in a ``raise``, an ``assert``, an f-string, or is assigned to ``msg``;
- numbers that tune speed: constants of a module named ``_BLOCK``, ``_PIECE``, ``_CHUNK`` and the like,
  and the arguments in `_TUNING`;
- how thick or large a picture draws something: the arguments in `_LOOKS`;
- guards against a division by zero: numbers below 1e-100 or above 1e100;
- what compiles to the same bytecode.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType

_COMPARED: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: (r"is\s+not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: (r"not\s+in", ("in",)),
}
_COMPUTED: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
}
#: Arguments that change how long something takes, or only guard against a mistake of the program.
_TUNING = frozenset(
    {"maxsize", "copy", "strict", "stacklevel", "timeout", "flush", "buffering", "maxiter", "xtol", "ftol"}
    | {"gtol", "xatol", "fatol", "compression_level", "pickle", "check_finite", "overwrite_x"}
)
#: Arguments of the drawing that a reader may notice and no test could judge.
_LOOKS = frozenset(
    {
        "linewidth",
        "linewidths",
        "markersize",
        "zorder",
        "alpha",
        "dashes",
        "fontsize",
        "labelpad",
        "pad",
        "dpi",
    }
)
_SPEED = re.compile(r"^_?(\w+_)?(BLOCK|PIECE|CHUNK|CACHE|BUFFER)(_\w+)?$")
_TEXTS = frozenset({"msg", "message", "__all__"})
_SKIPPED = (ast.Raise, ast.Assert, ast.Import, ast.ImportFrom, ast.JoinedStr, ast.pattern)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutation:
    """One change: bytes `start` to `stop` become `new`; the statement runs from line `first` to `line`."""

    start: int
    stop: int
    new: str
    first: int
    line: int


def mutated(source: bytes, mutation: Mutation) -> bytes:
    """Return the source with the change made."""
    return source[: mutation.start] + mutation.new.encode() + source[mutation.stop :]


def changes_nothing(source: bytes, mutation: Mutation) -> bool:
    """Whether the change compiles to what was there before, or does not compile."""
    try:
        changed = compile(mutated(source, mutation), "changed", "exec")
    except SyntaxError:
        return True
    return _meaning(changed) == _meaning(compile(source, "changed", "exec"))


def _meaning(code: CodeType) -> tuple[object, ...]:
    constants = [_meaning(c) if isinstance(c, CodeType) else (type(c), repr(c)) for c in code.co_consts]
    return (code.co_code, code.co_names, *constants)


def mutations(source: bytes) -> list[Mutation]:
    """Return every change of a module, in the order of their places."""
    found = _Points(source).inside(ast.parse(source), first=1)
    return sorted(found, key=lambda mutation: (mutation.start, mutation.new))


class _Points:
    """The changes of one file."""

    def __init__(self, source: bytes) -> None:
        self._source = source
        self._starts = [0]
        for line in source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def inside(self, node: ast.AST, *, first: int) -> Iterator[Mutation]:
        """Go through a node and what it holds; `first` is the line its statement begins at."""
        if isinstance(node, _SKIPPED) or _is_left_alone(node):
            return
        if isinstance(node, ast.stmt):
            first = node.lineno
        for start, stop, new in self._changes(node):
            line = self._source[:start].count(b"\n") + 1
            yield Mutation(start=start, stop=stop, new=new, first=first, line=line)
        for name, value in ast.iter_fields(node):
            if name not in {"annotation", "returns", "decorator_list", "type_comment"}:
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from self.inside(child, first=first)

    def _changes(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Compare():
                sides = [node.left, *node.comparators]
                for left, operator, right in zip(sides, node.ops, sides[1:], strict=False):
                    text, others = _COMPARED[type(operator)]
                    for new in others:
                        yield from self._between(left, right, text, new)
            case ast.BinOp() if type(node.op) in _COMPUTED:
                text, new = _COMPUTED[type(node.op)]
                yield from self._between(node.left, node.right, re.escape(text), new)
            case ast.BoolOp():
                text, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
                for left, right in zip(node.values, node.values[1:], strict=False):
                    yield from self._between(left, right, rf"\b{text}\b", new)
            case ast.UnaryOp(op=ast.USub() | ast.Not()):
                word = "-" if isinstance(node.op, ast.USub) else "not"
                yield self._start(node), self._start(node) + len(word), ""
            case ast.If() | ast.While() | ast.IfExp():
                start, stop = self._start(node.test), self._stop(node.test)
                yield start, stop, f"(not ({self._source[start:stop].decode()}))"
            case ast.Constant(value=bool() | int() | float() as value):
                yield self._start(node), self._stop(node), _other(value)

    def _between(
        self, left: ast.expr, right: ast.expr, text: str, new: str
    ) -> Iterator[tuple[int, int, str]]:
        """Replace the operator between two operands, around which there may be brackets."""
        start, stop = self._stop(left), self._start(right)
        found = re.search(text, self._source[start:stop].decode())
        if found and b"#" not in self._source[start:stop]:
            # Operators and what stands around them are ASCII: characters are bytes.
            yield start + found.start(), start + found.end(), new

    def _start(self, node: ast.expr) -> int:
        return self._starts[node.lineno - 1] + node.col_offset

    def _stop(self, node: ast.expr) -> int:
        return self._starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)


def _is_left_alone(node: ast.AST) -> bool:
    match node:
        case ast.If(test=ast.Name(id="TYPE_CHECKING") | ast.Attribute(attr="TYPE_CHECKING")):
            return True
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            return name in _TEXTS or _SPEED.match(name) is not None or _is_type_alias(node)
        case ast.keyword(arg=str(name)):
            return name in _TUNING | _LOOKS
        case ast.Constant(value=float() as value):
            return value != 0 and not 1e-100 < abs(value) < 1e100
    return False


def _is_type_alias(node: ast.AST) -> bool:
    """Whether a value is made of names and ``|`` alone."""
    value = getattr(node, "value", None)
    return isinstance(value, ast.BinOp) and not any(
        isinstance(part, (ast.Constant, ast.Call))
        or (isinstance(part, ast.operator) and not isinstance(part, ast.BitOr))
        for part in ast.walk(value)
    )


def _other(value: float) -> str:
    """Return another number: a truth turned round, the next whole number, twice a fraction."""
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    return repr(value * 2 if value else 1.0)
