"""What takes long of a fleet: made once, by whoever has the time, and kept in its store.

A question has all that its answer is made of, and a key of it: the same logs, labels and version give the
same key, so that what stands in the store under it is the answer. The workers of a run leave the answers
there; a report, a check or a comparison reads them, and makes only those that are missing, as after a label
was mended.
"""

import hashlib
import json
import math
import types
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

from imucal._version import __version__
from imucal.errors import DataError, WriteError
from imucal.findings import Finding
from imucal.fitting.bins import unpack
from imucal.fitting.homogeneity import symbol_of
from imucal.fleet.pooling import pool_bins
from imucal.fleet.population import Population, population
from imucal.fleet.store import FleetStore
from imucal.fleet.values import LogValue
from imucal.frozen import frozen
from imucal.noise.terms import TERMS
from imucal.processes import side_by_side, try_side_work
from imucal.recording import Sensor
from imucal.resources import threads

if TYPE_CHECKING:
    import polars as pl

#: Model, sensor, axis and term.
TermKey: TypeAlias = tuple[str, str, str, str]
#: Relative difference of two sampling rates that is none.
_SAME_RATE = 1e-3
_LEVEL = 0.95
#: So many logs' bins are held at once, 18 kB each.
_AT_ONCE = 5000
#: The bound that is near enough, and the most units that are thought of.
NEAR = 1.1
_MOST = 10_000
#: What a row of results says of a log.
_OF_LOG = tuple(field.name for field in fields(LogValue))


class LogRows(Sequence[LogValue]):
    """Values of many logs, from their `rows` of results; made where somebody looks at one.

    The digest and the key of a question need only the rows, a `LogValue` each.
    """

    def __init__(self, rows: "pl.DataFrame") -> None:
        # A term without a square has none that could grow.
        self.rows = rows.select(_OF_LOG).with_columns(rows["variance_growth"].fill_null(0.0))

    @property
    def digest(self) -> str:
        """Of the same values of the same units the same."""
        numbers, units = self.rows.drop("unit").to_numpy(), self.rows["unit"].to_list()
        return hashlib.blake2b(numbers.tobytes() + json.dumps(units).encode()).hexdigest()

    @cached_property
    def _values(self) -> tuple[LogValue, ...]:
        return tuple(LogValue(**row) for row in self.rows.iter_rows(named=True))

    def __len__(self) -> int:
        return self.rows.height

    def __getitem__(self, place: Any) -> Any:  # noqa: ANN401 - one by its number, several by a slice
        return self._values[place]


@frozen
class TermAnswer:
    """What the units are like in one term: their `population`, with the tolerance bound.

    `price` has pairs of a number of units, and the bound that so many give over the quantile that it
    bounds. `without_odd` is the bound of the other units; None where none is odd, or too few are left.
    """

    population: Population
    price: tuple[tuple[int, float], ...]
    without_odd: float | None


@frozen
class TermQuestion:
    """The question what the units of one term are like."""

    logs: LogRows
    content: float
    confidence: float

    @property
    def key(self) -> str:
        """Of the same question the same."""
        return _key(TermAnswer, self.logs.digest, self.content, self.confidence)

    def answer(self) -> TermAnswer:
        """Find it out."""
        of = partial(population, content=self.content, confidence=self.confidence)
        found = of(self.logs)
        odd = {unit.unit for unit in found.units if unit.odd}
        others = [log for log in self.logs if log.unit not in odd] if odd else []
        return TermAnswer(
            population=found,
            price=_prices(found),
            without_odd=of(others).tolerance if others else None,
        )


@frozen
class UnitLogs:
    """Several logs of one unit, of one term: whether they have one coefficient.

    `p_value` is of this test alone, `differs` is judged over all units and terms of the fleet (Benjamini &
    Hochberg 1995). `value`, `low` and `high` are those of the joint fit, widened where the logs differ; None
    where the term is only bounded. `spread` is the relative deviation between logs beyond chance, 0 where
    they agree.
    """

    unit: str
    term: str
    logs: int
    p_value: float
    differs: bool
    spread: float
    value: float | None
    low: float
    high: float


@frozen
class UnitAnswer:
    """The tests of a unit's axis, a term each; none where it can't be judged, and a finding that says so."""

    tests: tuple[UnitLogs, ...]
    findings: tuple[Finding, ...]


@frozen
class UnitQuestion:
    """The question whether the logs of one axis of a unit have one coefficient of each term.

    `logs` are their keys; `packed`, their bins, are needed where the answer is not there yet.
    """

    unit: str
    sensor: str
    axis: str
    symbols: tuple[str, ...]
    logs: tuple[str, ...]
    packed: tuple[bytes, ...] = ()

    @property
    def key(self) -> str:
        """Of the same question the same."""
        return _key(UnitAnswer, self.unit, self.sensor, self.axis, self.symbols, self.logs)

    def answer(self) -> UnitAnswer:
        """Find it out, from the bins."""
        where = f"{Sensor(self.sensor).short}_{self.axis}"
        tests, findings = try_side_work(
            self._tests,
            (),
            what=f"{self.unit}: it is unknown whether its logs agree in {where}",
            code="not-checked",
            axis=where,
        )
        return UnitAnswer(tests=tests, findings=findings)

    def _tests(self) -> tuple[UnitLogs, ...]:
        every = [unpack(data) for data in self.packed]
        first = every[0].tau0
        rates = sorted({f"{1 / one.tau0:.6g} Hz" for one in every if abs(one.tau0 / first - 1) > _SAME_RATE})
        if rates:
            raise DataError(f"found rates of {1 / first:.6g} Hz and {', '.join(rates)}, expected one")
        pooled = pool_bins(every, self.symbols, sensor=Sensor(self.sensor), rate_hz=1 / first, level=_LEVEL)
        return tuple(
            UnitLogs(
                unit=self.unit,
                term=test.key,
                logs=pooled.records,
                **{name: getattr(test, name) for name in ("p_value", "differs", "spread")},
                **{name: getattr(pooled[test.key], name) for name in ("value", "low", "high")},
            )
            for test in pooled.homogeneity
        )


Question: TypeAlias = TermQuestion | UnitQuestion
#: Who makes answers: questions -> their texts, None for one that was not to be had.
Ask: TypeAlias = Callable[[Sequence[Question]], Iterable[str | None]]
Q = TypeVar("Q", TermQuestion, UnitQuestion)
A = TypeVar("A", TermAnswer, UnitAnswer)


def answer_text(question: Question) -> str:
    """Return the answer to a question as it is kept."""
    return json.dumps(asdict(question.answer()))


def answer_texts(questions: Sequence[Question]) -> list[str]:
    """Return the answers to some questions as they are kept; a worker may be asked for them."""
    return [answer_text(question) for question in questions]


def _key(kind: type, *said: object) -> str:
    """Return a key of what an answer is made of, and of what it has."""
    text = json.dumps([kind.__name__, [field.name for field in fields(kind)], *said, __version__])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def here(questions: Sequence[Question]) -> Iterable[str]:
    """Return the answers of this process, and of others beside it."""
    return side_by_side(answer_text, questions, workers=threads())


def answers_to(
    questions: Sequence[Q],
    kind: type[A],
    store: FleetStore,
    ask: Ask,
    fill: Callable[[list[Q]], Iterable[list[Q]]] = lambda every: [every],
) -> list[A]:
    """Return the answers to questions, in their order: those that a store has, and others as they are made.

    Those that are not there are made in groups, as `fill` yields them with all that they need. They are kept;
    a store that can't be written to is only read.
    """
    keys, read = [question.key for question in questions], _reader(kind)
    known = store.derived(keys)
    missing = {key: one for key, one in zip(keys, questions, strict=True) if key not in known}
    for group in fill(list(missing.values())) if missing else ():
        texts = zip(group, ask(group), strict=True)
        made = {question.key: text or answer_text(question) for question, text in texts}
        known |= made
        with suppress(WriteError):
            store.keep_derived(made)
    return [read(json.loads(known[key])) for key in keys]


def unit_tests(
    store: FleetStore, ask: Ask, units: Mapping[str, tuple[str, str]], terms: Iterable[TermKey]
) -> tuple[dict[TermKey, list[UnitLogs]], tuple[Finding, ...]]:
    """Return for each of some terms the units with several logs, and what could not be judged.

    `units` has the model and the unit of each log that counts, by its key.
    """
    symbols: dict[tuple[str, str, str], set[str]] = {}
    for model, sensor, axis, term in terms:
        symbols.setdefault((model, sensor, axis), set()).add(symbol_of(term))
    logs: dict[tuple[str, str, str, str], list[str]] = {}
    for key, sensor, axis in store.axes().iter_rows():
        if key in units and (units[key][0], sensor, axis) in symbols:
            logs.setdefault((*units[key], sensor, axis), []).append(key)
    # By question, the model.
    asked = {
        UnitQuestion(
            unit=unit,
            sensor=sensor,
            axis=axis,
            symbols=tuple(symbol for symbol in TERMS if symbol in symbols[model, sensor, axis]),
            logs=tuple(sorted(own)),
        ): model
        for (model, unit, sensor, axis), own in sorted(logs.items())
        if len(own) > 1
    }
    found: dict[TermKey, list[UnitLogs]] = {}
    findings: list[Finding] = []
    every = answers_to(list(asked), UnitAnswer, store, ask, partial(_with_bins, store))
    for (question, model), answer in zip(asked.items(), every, strict=True):
        findings += answer.findings
        for test in answer.tests:
            found.setdefault((model, question.sensor, question.axis, test.term), []).append(test)
    return found, tuple(findings)


def _with_bins(store: FleetStore, questions: list[UnitQuestion]) -> Iterator[list[UnitQuestion]]:
    """Yield questions with the bins of their logs, as many at a time as memory is meant to hold."""
    groups: list[tuple[list[UnitQuestion], set[str]]] = []
    # The axes of a unit have the same logs, which are read once.
    for question in sorted(questions, key=lambda one: one.logs):
        if not groups or len(groups[-1][1]) >= _AT_ONCE:
            groups.append(([], set()))
        groups[-1][0].append(question)
        groups[-1][1].update(question.logs)
    for group, keys in groups:
        packed = {(key, sensor, axis): data for key, sensor, axis, data in store.bins(keys).iter_rows()}
        yield [
            replace(one, packed=tuple(packed[key, one.sensor, one.axis] for key in one.logs)) for one in group
        ]


def _reader(kind: Any) -> Any:  # noqa: ANN401 - of any type
    """Return what makes a value of a type of what JSON says; None where JSON says the value itself.

    A type is a dataclass, a tuple of any length of one type, a pair of plain values, something or None, or
    plain. That is found out once: of a thousand units most fields are plain, and cost nothing.
    """
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind).items()
        deeper = {name: read for name, hint in hints if (read := _reader(hint))}
        return lambda said: kind(**said | {name: read(said[name]) for name, read in deeper.items()})
    first, *others = get_args(kind) or (None,)
    read = _reader(first) if others in ([types.NoneType], [...]) else None
    if get_origin(kind) is tuple:
        return lambda said: tuple(map(read, said) if read else said)
    return read and (lambda said: None if said is None else read(said))


def tolerance_excess(units: int, spread: float, *, content: float = 0.95, confidence: float = 0.95) -> float:
    """Return the median bound of two units or more over the quantile that it bounds: what more would buy.

    Where units are known well, the bound is k deviations above the mean in the logarithm, and the quantile z:
    of a `spread` tau between units, in the logarithm, exp(tau (k - z)) is the price of having tested so few.
    `content` and `confidence` are those of the bound. Source: Krishnamoorthy & Mathew (2009), Statistical
    Tolerance Regions, eq. (2.2.3): k is a quantile of the noncentral t law.
    """
    from scipy.special import nctdtrit, ndtri

    z = float(ndtri(content))
    root = math.sqrt(units)
    factor = float(nctdtrit(units - 1, z * root, confidence)) / root
    return math.exp(spread * (factor - z))


def _prices(found: Population) -> tuple[tuple[int, float], ...]:
    """Return numbers of units with what they cost: these, twice as many, and those that come near enough.

    Empty where the spread between units is not known.
    """
    if found.spread is None:
        return ()
    n = len(found.units)
    excess = partial(
        tolerance_excess, spread=found.spread.value, content=found.content, confidence=found.confidence
    )
    wanted = {n, 2 * n}
    if excess(n) > NEAR >= excess(_MOST):
        every = range(n, _MOST)
        wanted.add(n + bisect_left(every, -NEAR, key=lambda units: -excess(units)))
    return tuple((units, excess(units)) for units in sorted(wanted))
