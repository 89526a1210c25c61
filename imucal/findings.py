"""A finding: something the user should know about a log or a result, as data."""

from dataclasses import KW_ONLY, dataclass
from functools import cache
from typing import Literal, NamedTuple, TypeAlias

Level: TypeAlias = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
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
        Start and end of the part worth keeping, in s from the start of the log; None for all of it. In what
        `imucal.screen` returns they count from the first sample of its recording.
    """

    level: Level
    code: str
    text: str
    advice: str = ""
    _: KW_ONLY
    axis: str | None = None
    keep_s: tuple[float, float] | None = None


def options_to_keep(keep_s: tuple[float, float]) -> str:
    """Return the options that keep a part of a log, such as ``--skip 145s --take 51.5s``."""
    start, end = keep_s
    skip = f"--skip {start:.10g}s " if start > 0 else ""
    return f"{skip}--take {round(end - start, 1):.10g}s"


class CodeText(NamedTuple):
    """What docs/messages.md and the verdict say of a code.

    `phrase` is for the sentence of the verdict, empty for the code itself. `found` and `advice` are a row of
    the page's table below `section`; codes without `found` share the row of the code above.
    """

    section: str
    phrase: str
    found: str
    advice: str


@cache
def code_texts() -> dict[str, CodeText]:
    """Return every code that a finding may have, in the order of docs/messages.md."""
    from importlib.resources import files

    texts, section = {}, ""
    for line in files("imucal").joinpath("finding_codes.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line.removeprefix("## ")
        elif line and not line.startswith("#"):
            code, phrase, found, advice = (cell.strip() for cell in f"{line}|||".split("|")[:4])
            texts[code] = CodeText(section=section, phrase=phrase, found=found, advice=advice)
    return texts


def phrase_of(code: str) -> str:
    """Return what the sentence of the verdict says of a code; old reports may have others."""
    text = code_texts().get(code)
    return text.phrase if text and text.phrase else code.replace("-", " ")
