"""The slow statistics of a fleet: computed once and kept in its store.

A question contains all data of its answer, and a key: equal logs, labels and versions give equal keys. A
report, a check or a comparison computes only the missing answers.
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
from imucal.fleet.tolerance import tolerance_factor
from imucal.fleet.values import LogValue
from imucal.frozen import frozen
from imucal.noise.terms import TERMS
from imucal.processes import side_by_side, try_side_work
from imucal.recording import Sensor
from imucal.resources import threads

if TYPE_CHECKING:
    import polars as pl

TermKey: TypeAlias = tuple[str, str, str, str]
#: Largest relative difference of equal sampling rates.
_SAME_RATE = 1e-3
_LEVEL = 0.95
#: Logs whose bins are in memory at a time, 18 kB each.
_LOGS_IN_MEMORY = 5000
#: Price at which more units are not worth it.
NEAR = 1.1
_LARGEST_FLEET = 10_000
_OF_LOG = tuple(field.name for field in fields(LogValue))


class LogRows(Sequence[LogValue]):
    """Values of many logs, created when one is needed."""

    def __init__(self, rows: "pl.DataFrame") -> None:
        # A term without a square has no growth either.
        self.rows = rows.select(_OF_LOG).with_columns(rows["variance_growth"].fill_null(0.0))

    @property
    def digest(self) -> str:
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
    """The statistics of the units in one term.

    `price` contains pairs: a number of units, and the ratio of their bound to the true quantile.
    `without_odd` is the bound without the odd units; None if no unit is odd, or too few are left.
    """

    population: Population
    price: tuple[tuple[int, float], ...]
    without_odd: float | None


@frozen
class TermQuestion:
    """The question for the statistics of one term."""

    logs: LogRows
    content: float
    confidence: float

    @property
    def key(self) -> str:
        return _key(TermAnswer, self.logs.digest, self.content, self.confidence)

    def answer(self) -> TermAnswer:
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
    """The test whether several logs of one unit have one coefficient of a term.

    `p_value` belongs to this test alone; `differs` is adjusted for all units and terms of the fleet. `value`,
    `low` and `high` are from the joint fit; value is None if the term is only bounded. `spread` is the
    relative deviation between logs beyond chance, 0 if they agree.
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
    """The tests of a unit's axis, one per term, or a finding with the reason why there are none."""

    tests: tuple[UnitLogs, ...]
    findings: tuple[Finding, ...]


@frozen
class UnitQuestion:
    """The question whether the logs of one axis of a unit have one coefficient of each term.

    `logs` are their keys; the answer needs `packed`, their bins.
    """

    unit: str
    sensor: str
    axis: str
    symbols: tuple[str, ...]
    logs: tuple[str, ...]
    packed: tuple[bytes, ...] = ()

    @property
    def key(self) -> str:
        return _key(UnitAnswer, self.unit, self.sensor, self.axis, self.symbols, self.logs)

    def answer(self) -> UnitAnswer:
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
#: Questions -> their answers, None for a missing one.
Ask: TypeAlias = Callable[[Sequence[Question]], Iterable[str | None]]
Q = TypeVar("Q", TermQuestion, UnitQuestion)
A = TypeVar("A", TermAnswer, UnitAnswer)


def answer_text(question: Question) -> str:
    """Return the answer as JSON."""
    return json.dumps(asdict(question.answer()))


def answer_texts(questions: Sequence[Question]) -> list[str]:
    """Return the answers as JSON; runs in a worker, too."""
    return [answer_text(question) for question in questions]


def _key(kind: type, *parts: object) -> str:
    text = json.dumps([kind.__name__, [field.name for field in fields(kind)], *parts, __version__])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def here(questions: Sequence[Question]) -> Iterable[str]:
    """Return answers computed by this process and its children."""
    return side_by_side(answer_text, questions, workers=threads())


def answers_to(
    questions: Sequence[Q],
    kind: type[A],
    store: FleetStore,
    ask: Ask,
    fill: Callable[[list[Q]], Iterable[list[Q]]] = lambda every: [every],
) -> list[A]:
    """Return the answers to questions, in their order, from the store or computed and stored.

    `fill` completes groups of questions with data.
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
    """Return the tests of units with several logs for each term, and findings on failed tests.

    `units` has the model and the unit of each log that counts, by its key.
    """
    symbols: dict[tuple[str, str, str], set[str]] = {}
    for model, sensor, axis, term in terms:
        symbols.setdefault((model, sensor, axis), set()).add(symbol_of(term))
    logs: dict[tuple[str, str, str, str], list[str]] = {}
    for key, sensor, axis in store.axes().iter_rows():
        if key in units and (units[key][0], sensor, axis) in symbols:
            logs.setdefault((*units[key], sensor, axis), []).append(key)
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
    """Yield groups of questions with the bins of a limited number of logs."""
    groups: list[tuple[list[UnitQuestion], set[str]]] = []
    # The axes of a unit have the same logs.
    for question in sorted(questions, key=lambda one: one.logs):
        if not groups or len(groups[-1][1]) >= _LOGS_IN_MEMORY:
            groups.append(([], set()))
        groups[-1][0].append(question)
        groups[-1][1].update(question.logs)
    for group, keys in groups:
        packed = {(key, sensor, axis): data for key, sensor, axis, data in store.bins(keys).iter_rows()}
        yield [
            replace(one, packed=tuple(packed[key, one.sensor, one.axis] for key in one.logs)) for one in group
        ]


def _reader(kind: Any) -> Any:  # noqa: ANN401 - of any type
    """Return the function that converts JSON to a type; None for a type that JSON contains itself."""
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind).items()
        deeper = {name: read for name, hint in hints if (read := _reader(hint))}
        return lambda value: kind(**value | {name: read(value[name]) for name, read in deeper.items()})
    first, *others = get_args(kind) or (None,)
    read = _reader(first) if others in ([types.NoneType], [...]) else None
    if get_origin(kind) is tuple:
        return lambda value: tuple(map(read, value) if read else value)
    return read and (lambda value: None if value is None else read(value))


def tolerance_excess(units: int, spread: float, *, content: float = 0.95, confidence: float = 0.95) -> float:
    """Return the median ratio of the bound of two or more units to the quantile that it bounds.

    For units without error and a `spread` in the logarithm, it is exp(spread (k - z)).
    """
    from scipy.special import ndtri

    factor = tolerance_factor(units, units - 1, content, confidence)
    return math.exp(spread * (factor - float(ndtri(content))))


def _prices(found: Population) -> tuple[tuple[int, float], ...]:
    """Return prices for the tested units, twice as many, and a number at which more are not worth it."""
    if found.spread is None:
        return ()
    n = len(found.units)
    excess = partial(
        tolerance_excess, spread=found.spread.value, content=found.content, confidence=found.confidence
    )
    wanted = {n, 2 * n}
    if excess(n) > NEAR >= excess(_LARGEST_FLEET):
        every = range(n, _LARGEST_FLEET)
        wanted.add(n + bisect_left(every, -NEAR, key=lambda units: -excess(units)))
    return tuple((units, excess(units)) for units in sorted(wanted))
