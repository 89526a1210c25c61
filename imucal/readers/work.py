"""What the reading of a log collects besides samples: decisions with their reasons, and findings."""

from dataclasses import dataclass, field, replace
from typing import Self

from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.recording import StampTrace


@dataclass(kw_only=True, eq=False)
class Work:
    """The decisions and findings of a log that is being read."""

    options: ReadOptions = field(default_factory=ReadOptions)
    decisions: list[tuple[str, str]] = field(default_factory=list)
    #: See `imucal.recording.Source`.
    values: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    stamps: list[StampTrace] = field(default_factory=list)

    def decide(self, what: str, how: str, *, value: str = "") -> None:
        """Add a decision with its reason, and its `value` if programs need it."""
        if value:
            self.values[what] = value
        if (what, how) not in self.decisions:
            self.decisions.append((what, how))

    def silent(self) -> Self:
        """Return a copy whose decisions and findings are discarded."""
        return replace(self, decisions=[], values={}, findings=[], stamps=[])
