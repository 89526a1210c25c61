"""What is to be done of a fleet: one log each, and what holds for all of them."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from imucal._version import __version__

#: Model and level of a fleet that says nothing else.
MODEL, LEVEL = "N + B + K", 0.95
#: Which logs get a report of their own.
REPORTS = ("none", "failed", "all")
#: Bytes that the packages take which read and fit a log, and a short log.
LEAST_MEMORY = 300 << 20
#: Seconds that a log may take, and more for each megabyte; usual ones take 0.06 s for each.
PATIENCE, PATIENCE_PER_MB = 300.0, 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LogTask:
    """One log to do.

    Attributes
    ----------
    path
        Of the log, as it was given; relative to `FleetSettings.folder`.
    size
        Bytes; 0 where it is not known.
    labels
        Columns of the manifest: model, unit, temperature_c, started.
    reading
        How to read it: arguments of `imucal.read`, ``skip_s`` and ``take_s``; JSON values.
    url
        Where it is, if that is more than the path may show: a URL with its query, which is never stored.
    """

    path: str
    url: str = field(default="", repr=False)
    size: int = 0
    labels: Mapping[str, str | float | None] = field(default_factory=dict)
    reading: Mapping[str, object] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Where it is: a path, or a URL with its secrets."""
        return self.url or self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """What holds for every log of a fleet.

    Attributes
    ----------
    store
        The store's folder, absolute.
    folder
        Where relative paths begin, absolute.
    model, level
        Terms and confidence level of every fit: one structure for all, as one chosen by the log would
        make the logs differ where the units do not.
    memory
        Bytes that a log may take.
    timeout
        Seconds that a log may take; None for a time by its size.
    reports
        One of `REPORTS`.
    shard
        Stands in the names of the parts.
    """

    store: str
    folder: str
    model: str = MODEL
    level: float = LEVEL
    memory: int
    timeout: float | None = None
    reports: str = "failed"
    shard: str = "0"

    def key(self, content: str, reading: Mapping[str, object]) -> str:
        """Return the key of a result: it changes with the content, the settings and the version."""
        said = json.dumps([content, self.model, self.level, reading, __version__], sort_keys=True)
        return hashlib.blake2b(said.encode(), digest_size=16).hexdigest()

    def patience(self, task: LogTask) -> float:
        """Return how many seconds a log may take."""
        if self.timeout is not None:
            return self.timeout
        return PATIENCE + PATIENCE_PER_MB * task.size / 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class LogDone:
    """How a log ended, for those who count.

    Attributes
    ----------
    path, size
        Of the log; in bytes.
    status, reason, verdict
        As in the store.
    """

    path: str
    size: int
    status: str
    reason: str = ""
    verdict: str = ""

    @property
    def failed(self) -> bool:
        """Whether it gave no numbers that may be used."""
        return has_failed(self.status, self.verdict)


def has_failed(status: str | None, verdict: str | None) -> bool:
    """Return whether a log gave no numbers that may be used: it could not be analysed, or is not noise."""
    return status != "ok" or verdict == "not-noise"
