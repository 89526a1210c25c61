"""What takes long of a fleet: made once, by whoever has the time, and kept in its store.

A question has all that its answer is made of, and a key of it: the same logs, labels and version give the
same key, so that what stands in the store under it is the answer. The workers of a run leave the answers
there; a report, a check or a comparison reads them, and makes only those that are missing, as after a label
was mended.
"""

import functools
import hashlib
import json
import math
import types
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from imucal._version import __version__
from imucal.errors import DataError, WriteError
from imucal.findings import Finding
from imucal.fitting.bins import unpack
from imucal.fleet.pooling import pool_bins
from imucal.fleet.population import Population, population
from imucal.fleet.store import FleetStore
from imucal.fleet.trend import Trend, trend
from imucal.fleet.values import LogValue
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
#: What a row of results says of a log, beside its unit; and which of that may be None.
_NUMBERS = tuple(field.name for field in fields(LogValue) if field.name != "unit")
_MAY_LACK = np.isin(_NUMBERS, ("value", "variance", "variance_sd", "correlation_time"))


class LogRows(Sequence[LogValue]):
    """Values of many logs, from their rows of results; made where somebody looks at one.

    `units`, shape (logs,), and `numbers`, shape (logs, fields of a `LogValue` but its unit), are as they
    stand in the store, which is all that the digest and the key of a question need.
    """

    def __init__(self, rows: "pl.DataFrame") -> None:
        self.units: list[str] = rows["unit"].to_list()
        # A term without a square has none that could grow.
        numbers = rows.select(_NUMBERS).with_columns(rows["variance_growth"].fill_null(0.0))
        self.numbers = np.ascontiguousarray(numbers.to_numpy())

    @property
    def digest(self) -> str:
        """Of the same values of the same units the same."""
        return hashlib.blake2b(self.numbers.tobytes() + json.dumps(self.units).encode()).hexdigest()

    @cached_property
    def _values(self) -> tuple[LogValue, ...]:
        told = self.numbers.astype(object)
        told[np.isnan(self.numbers) & _MAY_LACK] = None
        return tuple(
            LogValue(unit=unit, **dict(zip(_NUMBERS, row, strict=True)))
            for unit, row in zip(self.units, told.tolist(), strict=True)
        )

    def __len__(self) -> int:
        return len(self.units)

    def __getitem__(self, place: Any) -> Any:  # noqa: ANN401 - one by its number, several by a slice
        return self._values[place]


@dataclass(frozen=True, slots=True, kw_only=True)
class TermAnswer:
    """What the units are like in one term.

    Attributes
    ----------
    population
        Median, spreads and the tolerance bound.
    trend
        How it moves with temperature and time; None where labels do not tell, and `no_trend` says why.
    price
        Pairs of a number of units, and the bound that so many give over the quantile that it bounds.
    without_odd
        The tolerance bound of the other units; None where none is odd, or too few are left.
    """

    population: Population
    trend: Trend | None
    no_trend: str
    price: tuple[tuple[int, float], ...]
    without_odd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
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
        found = self._of(self.logs)
        moves, why = None, ""
        try:
            moves = trend(self.logs)
        except DataError as error:
            why = str(error)
        odd = {unit.unit for unit in found.units if unit.odd}
        others = [log for log in self.logs if log.unit not in odd] if odd else []
        return TermAnswer(
            population=found,
            trend=moves,
            no_trend=why,
            price=_prices(found),
            without_odd=self._of(others).tolerance if others else None,
        )

    def _of(self, logs: Sequence[LogValue]) -> Population:
        return population(logs, content=self.content, confidence=self.confidence)


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitAnswer:
    """The tests of a unit's axis, a term each; none where it can't be judged, and a finding that says so."""

    tests: tuple[UnitLogs, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
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
            what=f"{self.unit}: whether its logs agree in {where} is not known",
            code="not-checked",
            axis=where,
        )
        return UnitAnswer(tests=tests, findings=findings)

    def _tests(self) -> tuple[UnitLogs, ...]:
        every = [unpack(data) for data in self.packed]
        first = every[0].tau0
        rates = sorted({f"{1 / one.tau0:.6g} Hz" for one in every if abs(one.tau0 / first - 1) > _SAME_RATE})
        if rates:
            msg = f"found rates of {1 / first:.6g} Hz and {', '.join(rates)}, expected one"
            raise DataError(msg)
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


class Answers:
    """The answers of a store: those that it has, and others as they are made.

    Parameters
    ----------
    store
        Where they are kept; one that can't be written to is only read.
    ask
        Who makes others; by default this process, and others beside it.
    """

    def __init__(self, store: FleetStore, ask: Ask | None = None) -> None:
        self.store = store
        self._ask: Ask = ask or (lambda questions: side_by_side(answer_text, questions, workers=threads()))

    def to(
        self,
        questions: Sequence[Q],
        kind: type[A],
        fill: Callable[[list[Q]], Iterable[list[Q]]] = lambda every: [every],
    ) -> list[A]:
        """Return the answers to questions, in their order.

        Those that are not there are made in groups, as `fill` yields them with all that they need.
        """
        keys, read = (
            [question.key for question in questions],
            cast("Callable[[Any], A]", _record_reader(kind)),
        )
        known = self.store.derived(keys)
        missing = {key: one for key, one in zip(keys, questions, strict=True) if key not in known}
        for group in fill(list(missing.values())) if missing else ():
            texts = zip(group, self._ask(group), strict=True)
            made = {question.key: text or answer_text(question) for question, text in texts}
            known |= made
            with suppress(WriteError):
                self.store.keep_derived(made)
        return [read(json.loads(known[key])) for key in keys]


def unit_tests(
    answers: Answers, units: Mapping[str, tuple[str, str]], terms: Iterable[TermKey]
) -> tuple[dict[TermKey, list[UnitLogs]], tuple[Finding, ...]]:
    """Return for each of some terms the units with several logs, and what could not be judged.

    `units` has the model and the unit of each log that counts, by its key.
    """
    symbols: dict[tuple[str, str, str], set[str]] = {}
    for model, sensor, axis, term in terms:
        symbols.setdefault((model, sensor, axis), set()).add(symbol_of(term))
    logs: dict[tuple[str, str, str, str], list[str]] = {}
    for key, sensor, axis in answers.store.axes().iter_rows():
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
    every = answers.to(list(asked), UnitAnswer, partial(_with_bins, answers.store))
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
    for (group, _), frame in zip(groups, store.bins_in_turn(keys for _, keys in groups), strict=True):
        packed = {(key, sensor, axis): data for key, sensor, axis, data in frame.iter_rows()}
        yield [
            replace(one, packed=tuple(packed[key, one.sensor, one.axis] for key in one.logs)) for one in group
        ]


@functools.cache
def _reader(kind: Any) -> Callable[[Any], Any] | None:  # noqa: ANN401 - of any type
    """Return what makes a value of a type of what JSON says; None where JSON says the value itself.

    A type is a dataclass, a tuple of any length of one type, a pair of plain values, something or None, or
    plain. That is found out once: of a thousand units most fields are plain, and cost nothing.
    """
    if isinstance(kind, type) and is_dataclass(kind):
        return _record_reader(kind)
    first, *others = get_args(kind) or (None,)
    read = _reader(first) if others in ([types.NoneType], [...]) else None
    if get_origin(kind) is tuple:
        return lambda said: tuple(said if read is None else map(read, said))
    return read and (lambda said: None if said is None else read(said))


def _record_reader(kind: type) -> Callable[[Any], Any]:
    hints = get_type_hints(kind).items()
    deeper = {name: read for name, hint in hints if (read := _reader(hint)) is not None}
    return lambda said: kind(**said | {name: read(said[name]) for name, read in deeper.items()})


def symbol_of(term: str) -> str:
    """Return ``GM`` of ``GM2``."""
    return term.rstrip("0123456789")


def tolerance_excess(units: int, spread: float, *, content: float = 0.95, confidence: float = 0.95) -> float:
    """Return the median bound of `units` units over the quantile that it bounds: what more units would buy.

    Parameters
    ----------
    units
        At least 2.
    spread
        Standard deviation tau between units, in the logarithm.
    content, confidence
        Of the bound.

    Notes
    -----
    Where units are known well, the bound is k deviations above the mean in the logarithm, and the quantile z:
    exp(tau (k - z)) is the price of having tested so few units.

    Source: Krishnamoorthy & Mathew (2009), Statistical Tolerance Regions, eq. (2.2.3): k is a quantile of the
    noncentral t law.
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
