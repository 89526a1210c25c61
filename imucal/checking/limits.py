"""What a limits file asks, as values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from imucal.recording import Axis, Sensor

Undecided: TypeAlias = Literal["pass", "fail"]

#: Levels of findings, the gravest last.
GRAVE = ("info", "warning", "error")

#: Every code that a finding may have, so that a limits file can't forbid one that doesn't exist;
#: described in ``docs/findings.md``.
FINDING_CODES = frozenset(
    [
        "absurd-rate",
        "axis-missing",
        "bad-rows",
        "bursts",
        "clock-jump",
        "clocks-differ",
        "coarse-lsb",
        "coarse-stamps",
        "compression",
        "counter-unused",
        "crc",
        "cut-line",
        "cycle",
        "damaged",
        "definition",
        "delay",
        "dropouts",
        "duplicate-axes",
        "duplicate-stamps",
        "encapsulation",
        "extra-samples",
        "few-units",
        "fast-rate",
        "file-missing",
        "gaps",
        "gaps-in-curve",
        "gaps-in-fit",
        "held-samples",
        "index",
        "joined",
        "line",
        "log-out-of-order",
        "log-time-used",
        "model-choice",
        "model-misfit",
        "motion",
        "no-data",
        "no-gravity",
        "no-result",
        "nonstationary",
        "not-checked",
        "not-drawn",
        "not-finite",
        "other-vectors",
        "output-filter",
        "poor-fit",
        "rate-differs",
        "rate-given",
        "record-length",
        "record-length-unknown",
        "records-differ",
        "roll-off",
        "rounding",
        "sampling-period",
        "saturated",
        "second-opinion",
        "sensor-missing",
        "short-times",
        "spectral-ambiguity",
        "spikes",
        "stamps-out-of-order",
        "step",
        "stuck",
        "swapped-sensors",
        "telegraph",
        "temperature",
        "time-unused",
        "tone",
        "touch",
        "truncated",
        "two-maxima",
        "unindexed",
        "unit-assumed",
        "unit-suspect",
        "verified",
        "wal-ignored",
        "warm-up",
        "warm-up-fitted",
        "weak-term",
        "wrapped",
        "zero-stamps",
    ]
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """One side of what is allowed.

    Attributes
    ----------
    where
        ``log``, a sensor such as ``gyroscope``, or an axis such as ``gyro_x``.
    quantity
        A term's symbol, or a name in `imucal.checking.limit_units`.
    side
        ``min`` or ``max``.
    value
        The limit, in `unit`.
    unit
        As the file has it.
    factor
        ``value * factor`` is the limit in SI.
    """

    where: str
    quantity: str
    side: Literal["min", "max"]
    value: float
    unit: str
    factor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingRules:
    """Which findings fail the check: those of `level` or graver, and `forbid`, but never `allow`."""

    level: str = "error"
    forbid: frozenset[str] = frozenset()
    allow: frozenset[str] = frozenset()

    def forbids(self, level: str, code: str) -> bool:
        """Return whether a finding of this level and code fails the check."""
        if code in self.allow:
            return False
        return code in self.forbid or (self.level != "none" and GRAVE.index(level) >= GRAVE.index(self.level))


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """How far a report may be from an older one.

    Attributes
    ----------
    report
        The older report; None where the caller gives it.
    terms
        Symbols that are compared.
    max_increase, max_decrease
        Largest relative change, such as 0.2; None where any is allowed.
    """

    report: Path | None = None
    terms: tuple[str, ...] = ("N", "B", "K")
    max_increase: float | None = 0.2
    max_decrease: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a limits file asks."""

    limits: tuple[Limit, ...] = ()
    required: Mapping[Sensor, tuple[Axis, ...]] = field(default_factory=dict)
    findings: FindingRules = field(default_factory=FindingRules)
    baseline: Baseline | None = None
    undecided: Undecided = "pass"
