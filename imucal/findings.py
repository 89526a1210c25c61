"""A finding: something the user should know about a log or a result, as data."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

Level: TypeAlias = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One observation, in a plain sentence.

    Attributes
    ----------
    level
        "info", "warning" (look before you use the numbers) or "error" (the numbers are wrong).
    code
        A short, stable, lower-case name with hyphens, such as ``gaps``; scripts match on it.
    text
        What was seen, with its figure, as one sentence.
    advice
        What to do about it, as one sentence; empty where nothing needs doing.
    axis
        The axis it is about, such as ``gyro_x``; a sensor, such as ``gyro``; or None for the log.
    keep_s
        Start and end, in s from the start of the log, of the part worth keeping; None for all of it.
    """

    level: Level
    code: str
    text: str
    advice: str = ""
    axis: str | None = None
    keep_s: tuple[float, float] | None = None
