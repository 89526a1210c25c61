"""Possible mutations of a line: one operator, sign, word or number is replaced at its exact place.

Excluded, because no test can or should detect them:

- annotations, decorators, type aliases, ``__all__`` and code under ``if TYPE_CHECKING``;
- error texts: in a ``raise``, an ``assert``, an f-string, or assigned to ``msg``;
- numbers that only affect speed: module constants named ``_BLOCK``, ``_PIECE``, ``_CHUNK`` and similar,
  the arguments in `_TUNING`, and the constants in `_PATH`, each with its reason;
- sizes and line widths of pictures: the arguments in `_LOOKS` and the constants in `_LAYOUT`, because
  pictures are inspected by eye;
- whether a limit such as 0.3 is inclusive: binary floats cannot represent it, so equality is an accident.
  Integers, halves and quarters are mutated, because counts can equal them;
- the -1 of a `reshape`: every negative number means the remaining dimension;
- guards against a division by zero: numbers below 1e-100 or above 1e100;
- changes that compile to the same bytecode.
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
#: Arguments that only affect durations, or guard against programming errors.
_TUNING = frozenset(
    {"maxsize", "copy", "strict", "stacklevel", "timeout", "flush", "buffering", "maxiter", "xtol", "ftol"}
    | {"gtol", "xatol", "fatol", "compression_level", "pickle", "check_finite", "overwrite_x"}
    # Number of iterations and tolerance of a search.
    | {"iterations", "tolerance"}
)
#: Arguments of the drawing that readers may notice but tests cannot judge.
_LOOKS = frozenset(
    {"linewidth", "linewidths", "markersize", "zorder", "alpha", "dashes", "fontsize", "labelpad", "pad"}
    | {"dpi", "figsize", "columnspacing", "handlelength", "labelsize", "shrinkA", "shrinkB"}
)
_UNSEEN = _TUNING | _LOOKS
#: Constants of the drawing that only set sizes and positions: module -> names.
_LAYOUT = {
    "figure": {"WIDTH", "_PLOT_HEIGHT", "_HEAD", "_AXIS_ROOM", "_ROW", "_LEFT", "_RIGHT"},
    "figure_parts": {"TITLE_SIZE", "LABEL_SIZE", "LEGEND_SIZE", "SMALL_SIZE"},
    "figure_allan": {"_DEEPEST"},
    "labels": {"_DISTANCES", "_ANGLES", "_PAD"},
    "log_ticks": {"_SIZE", "_MINOR"},
}
#: Constants that affect time, memory or path of a calculation, but not its result.
_PATH = {
    "maximum._STEP": "bounds a step of the search; its end is where the gradient vanishes",
    "maximum._GRID": "places from which a search starts that is refined later",
    "maximum._FIRST_ROUNDS": "rounds of a start that is refined later",
    "maximum._MORE_ROUNDS": "rounds of a start that is refined later",
    "maximum._ROWS": "rows at a time: cache and threads",
    "missing._STEPS": "most steps of a solver that ends when it is close enough",
    "missing._CLOSE": "how close is close enough for that solver",
    "missing._SEED": "one seed is as good as another",
    "intervals._ROUNDS": "most rounds of a search for a limit that ends when it is close enough",
    "intervals._CLOSE": "how close is close enough for that search",
    "intervals._STRIDE": "how fast a search for a limit goes on before it has passed it",
    "filter_response.CORNERS": "corners of which the best starts a search",
    "av_search._PER_DECADE": "how fine a grid is from which a search is refined",
    "av_search._STARTS": "places of that grid that are refined",
    "av_select._STEPS": "most rounds of a weight that settles after three",
    "generic._ROUNDS": "most rounds of a solver that ends when it is close enough",
    "generic._RIDGE": "far below any error; keeps a matrix from being singular",
    "likelihood._RIDGE": "far below any error; keeps a matrix from being singular",
    "variance._SMALL": "which of two ways sums a factor, both exact",
    "variance._ROW": "keeps a sum of squares out of the threads of the linear algebra library",
    "text._TAIL": "bytes in which the last line is looked for before the whole block is",
    "sqlite._PART": "bytes of one task",
    "sqlite._ROWS": "fewest rows of one task",
    "sqlite._FETCH": "rows fetched at once",
    "mcap_scan._PART": "bytes of messages loaded at once",
    "mcap_scan._WINDOW": "bytes read at once",
    "column_store._FLUSH": "bytes written before pages are given back",
    "column_store._FIRST": "first size of a column that grows",
    "loader._MAX_THREADS": "threads: the messages come out in the same order",
    "loader._LARGE": "messages that are worth preparing the allocator",
}
_SPEED = re.compile(r"^_?(\w+_)?(BLOCK|PIECE|CHUNK|CACHE|BUFFER)(_\w+)?$")
_TEXTS = frozenset({"msg", "message", "__all__"})
_SKIPPED = (ast.Raise, ast.Assert, ast.Import, ast.ImportFrom, ast.JoinedStr, ast.pattern)


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """One change: bytes `start` to `stop` become `new`; the statement covers lines `first` to `line`."""

    start: int
    stop: int
    new: str
    first: int
    line: int


def mutated(source: bytes, mutation: Mutation) -> bytes:
    """Return the source with the change applied."""
    return source[: mutation.start] + mutation.new.encode() + source[mutation.stop :]


def changes_nothing(source: bytes, mutation: Mutation) -> bool:
    """Whether the change compiles to the same code, or does not compile."""
    try:
        changed = compile(mutated(source, mutation), "changed", "exec")
    except SyntaxError:
        return True
    return _meaning(changed) == _meaning(compile(source, "changed", "exec"))


def _meaning(code: CodeType) -> tuple[object, ...]:
    constants = [_meaning(c) if isinstance(c, CodeType) else (type(c), repr(c)) for c in code.co_consts]
    return (code.co_code, code.co_names, *constants)


def mutations(source: bytes, module: str = "") -> list[Mutation]:
    """Return every change of a module, in order; `module` is its last name."""
    found = _Points(source, module).inside(ast.parse(source), first=1)
    return sorted(found, key=lambda mutation: (mutation.start, mutation.new))


class _Points:
    """The changes of one file."""

    def __init__(self, source: bytes, module: str) -> None:
        self._source = source
        self._fixed = _LAYOUT.get(module, set()) | {
            name.partition(".")[2] for name in _PATH if name.startswith(f"{module}.")
        }
        self._inexact = {
            target.id
            for statement in ast.parse(source).body
            if isinstance(statement, ast.Assign) and _is_inexact(statement.value)
            for target in statement.targets
            if isinstance(target, ast.Name)
        }
        self._starts = [0]
        for line in source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def inside(self, node: ast.AST, *, first: int) -> Iterator[Mutation]:
        """Yield the changes in a node and its children; `first` is the first line of its statement."""
        if isinstance(node, _SKIPPED) or _is_left_alone(node) or self._is_fixed(node):
            return
        if isinstance(node, ast.stmt):
            first = node.lineno
        for start, stop, new in self._changes(node):
            line = self._source[:start].count(b"\n") + 1
            yield Mutation(start=start, stop=stop, new=new, first=first, line=line)
        for child in _children(node):
            yield from self.inside(child, first=first)

    def _is_fixed(self, node: ast.AST) -> bool:
        """Whether a statement only assigns excluded constants."""
        if not (self._fixed and isinstance(node, ast.Assign)):
            return False
        names = {
            part.id for target in node.targets for part in ast.walk(target) if isinstance(part, ast.Name)
        }
        return names <= self._fixed

    def _changes(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Compare():
                yield from self._comparisons(node)
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

    def _comparisons(self, node: ast.Compare) -> Iterator[tuple[int, int, str]]:
        sides = [node.left, *node.comparators]
        for left, operator, right in zip(sides, node.ops, sides[1:], strict=False):
            text, others = _COMPARED[type(operator)]
            by_chance = self._is_real(left) or self._is_real(right)
            for new in others:
                if not (by_chance and new in {f"{text}=", text.removesuffix("=")}):
                    yield from self._between(left, right, text, new)

    def _is_real(self, node: ast.expr) -> bool:
        """Whether a side of a comparison is an inexact binary number, or computed with one."""
        match node:
            case ast.Name(id=name):
                return name in self._inexact
            case ast.BinOp():
                return self._is_real(node.left) or self._is_real(node.right)
            case ast.UnaryOp():
                return self._is_real(node.operand)
        return _is_inexact(node)

    def _between(
        self, left: ast.expr, right: ast.expr, text: str, new: str
    ) -> Iterator[tuple[int, int, str]]:
        """Replace the operator between two operands, which may be in brackets."""
        start, stop = self._stop(left), self._start(right)
        found = re.search(text, self._source[start:stop].decode())
        if found and b"#" not in self._source[start:stop]:
            # Operators and the text around them are ASCII, so characters are bytes.
            yield start + found.start(), start + found.end(), new

    def _start(self, node: ast.expr) -> int:
        return self._starts[node.lineno - 1] + node.col_offset

    def _stop(self, node: ast.expr) -> int:
        return self._starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)


def _is_inexact(node: ast.expr) -> bool:
    """Whether it is a fraction that a few binary digits cannot represent: 0.3, but not 0.5 or 1.25."""
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, float)
        and not (node.value * 64).is_integer()
    )


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Return the children of a node, except types and values that only affect speed or looks."""
    match node:
        case ast.Dict():
            keys = [getattr(key, "value", None) for key in node.keys]
            yield from (value for key, value in zip(keys, node.values, strict=True) if key not in _UNSEEN)
        case ast.Call(func=ast.Attribute(attr="reshape")):
            yield from (part for part in (node.func, *node.args) if ast.unparse(part) != "-1")
        case ast.arguments():
            names = [argument.arg for argument in (*node.posonlyargs, *node.args, *node.kwonlyargs)]
            values = [*node.defaults, *node.kw_defaults]
            for name, default in zip(names[len(names) - len(values) :], values, strict=True):
                if default is not None and name not in _UNSEEN:
                    yield default
        case _:
            for name, value in ast.iter_fields(node):
                if name not in {"annotation", "returns", "decorator_list", "type_comment"}:
                    held = value if isinstance(value, list) else [value]
                    yield from (child for child in held if isinstance(child, ast.AST))


def _is_left_alone(node: ast.AST) -> bool:
    match node:
        case ast.If(test=ast.Name(id="TYPE_CHECKING") | ast.Attribute(attr="TYPE_CHECKING")):
            return True
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            return name in _TEXTS or _SPEED.match(name) is not None or _is_type_alias(node)
        case ast.keyword(arg=str(name)):
            return name in _UNSEEN
        case ast.Constant(value=float() as value):
            return value != 0 and not 1e-100 < abs(value) < 1e100
    return False


def _is_type_alias(node: ast.AST) -> bool:
    """Whether a value only consists of names and ``|``."""
    value = getattr(node, "value", None)
    return isinstance(value, ast.BinOp) and not any(
        isinstance(part, (ast.Constant, ast.Call))
        or (isinstance(part, ast.operator) and not isinstance(part, ast.BitOr))
        for part in ast.walk(value)
    )


def _other(value: float) -> str:
    """Return another number: a negated truth value, the next integer, or twice a fraction."""
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    return repr(value * 2 if value else 1.0)
