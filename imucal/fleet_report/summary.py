"""Fleet: what many logs say of each sensor model, as values; renderers are functions of it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.fleet.population import Population, UnitValue
from imucal.fleet.trend import Trend
from imucal.fleet.values import LogValue
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetLog:
    """One log of a fleet.

    Attributes
    ----------
    path, model, unit, temperature_c, started
        Its labels; `model` is empty and `unit` None where there is none.
    status, reason
        ``ok``, or how it failed and the sentence that says why.
    verdict, findings
        good, look, not-noise or empty; the codes of what was found.
    seconds, rate_hz
        Length and rate of the record; None where it was not read.
    report
        Folder of its own report, relative to the fleet's; empty where there is none.
    left_out
        Why its numbers do not count; empty where they do.
    """

    path: str
    model: str
    unit: str | None
    temperature_c: float | None
    started: str | None
    status: str
    reason: str
    verdict: str
    findings: tuple[str, ...]
    seconds: float | None
    rate_hz: float | None
    report: str
    left_out: str


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitLogs:
    """Several logs of one unit, of one term: whether they have one coefficient.

    `p_value` is of this test alone, `differs` is judged over all units and terms of the fleet (Benjamini &
    Hochberg 1995). `value`, `low` and `high` are those of the joint fit, widened where the logs differ; None
    where the term is only bounded. `spread` is the relative deviation between logs beyond chance, 0 where
    they agree.
    """

    unit: str
    logs: int
    p_value: float
    differs: bool
    spread: float
    value: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetTerm:
    """One noise term of one axis of a sensor model.

    Attributes
    ----------
    sensor, axis, term
        Such as the gyroscope's x and ``N``; the coefficient is in the SI `unit`.
    logs
        What each log says.
    population
        What the units are like.
    trend
        How it moves with temperature and time; None where labels do not tell, and `no_trend` says why.
    unit_logs
        The units with several logs.
    price
        Pairs of a number of units, and the bound that so many give over the quantile that it bounds.
    """

    sensor: Sensor
    axis: Axis
    term: str
    logs: tuple[LogValue, ...]
    population: Population
    trend: Trend | None
    no_trend: str
    unit_logs: tuple[UnitLogs, ...]
    price: tuple[tuple[int, float], ...]

    @property
    def symbol(self) -> str:
        """``GM`` for ``GM2``."""
        return self.term.rstrip("0123456789")

    @property
    def unit(self) -> str:
        """SI unit of the coefficient."""
        return TERMS[self.symbol].unit(self.sensor)

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return f"{self.sensor.short}_{self.axis}"

    @property
    def odd(self) -> tuple[UnitValue, ...]:
        """The units that are not like the others."""
        return tuple(unit for unit in self.population.units if unit.odd)

    @property
    def drifting(self) -> tuple[str, ...]:
        """The units that do not move with time or temperature as the others do."""
        slopes = self.trend.slopes if self.trend else ()
        return tuple(dict.fromkeys(slope.unit for slope in slopes if slope.odd))

    @property
    def differing(self) -> tuple[str, ...]:
        """The units whose logs differ from one another."""
        return tuple(unit.unit for unit in self.unit_logs if unit.differs)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorModel:
    """The units of one sensor model; `name` is empty where no label says which.

    `rate_hz` is the median rate of its logs; `terms` are sorted by sensor, term and axis.
    """

    name: str
    units: tuple[str, ...]
    logs: tuple[FleetLog, ...]
    rate_hz: float
    terms: tuple[FleetTerm, ...]

    @property
    def title(self) -> str:
        """What people call it."""
        return self.name or "Sensor"

    def __getitem__(self, key: tuple[str, str]) -> FleetTerm:
        """Return a term by axis and key, such as ``("gyro_x", "N")``."""
        for term in self.terms:
            if (term.name, term.term) == key:
                return term
        msg = f"{key}; {self.title} has {', '.join(f'{t.name} {t.term}' for t in self.terms)}"
        raise KeyError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class LooseLog:
    """A log without a unit's label: its own values, by axis and term."""

    log: FleetLog
    values: Mapping[tuple[str, str], LogValue]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """What the logs of a fleet say.

    Attributes
    ----------
    folder
        The store.
    models
        Sensor models, by name.
    logs
        Every log that was done, sorted by path; `asked` is how many there were to do.
    loose
        Logs without a unit's label, which are in no population.
    labels
        The text of labels to give for them; empty where every log has a unit.
    findings
        What should be known of all of it.
    version
        imucal's version.
    """

    folder: Path
    models: tuple[SensorModel, ...]
    logs: tuple[FleetLog, ...]
    asked: int
    loose: tuple[LooseLog, ...]
    labels: str
    findings: tuple[Finding, ...]
    version: str

    @property
    def failures(self) -> dict[tuple[str, str], tuple[FleetLog, ...]]:
        """Logs that do not count, by status and reason; the most frequent first.

        Reasons that differ in numbers alone, such as a place in the file, are one: that of the first log.
        """
        groups: dict[tuple[str, str], list[FleetLog]] = {}
        for log in self.logs:
            if log.left_out:
                kind = log.status if log.status != "ok" else log.verdict
                groups.setdefault((kind, re.sub(r"\d+", "#", log.left_out)), []).append(log)
        ordered = sorted(groups.items(), key=lambda group: (-len(group[1]), group[0]))
        return {(kind, logs[0].left_out): tuple(logs) for (kind, _), logs in ordered}

    def model(self, name: str | None = None) -> SensorModel:
        """Return a sensor model by its name; without one the only model.

        Raises
        ------
        ChoiceError
            If there is no such model, or several and no name.
        """
        found = [model for model in self.models if name is None or model.name == name]
        if len(found) == 1:
            return found[0]
        names = ", ".join(repr(model.name) for model in self.models) or "none: no log has a unit's label"
        asked = "no model's name" if name is None else repr(name)
        msg = f"{self.folder}: found {asked}, expected one of the sensor models: {names}"
        raise ChoiceError(msg)
