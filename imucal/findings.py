"""Findings: observations about a log or a result for the user."""

from dataclasses import KW_ONLY, dataclass
from functools import cache
from typing import Literal, NamedTuple, TypeAlias

from imucal.errors import Fix

Level: TypeAlias = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One observation, in a plain sentence.

    Attributes
    ----------
    level
        "info", "warning" (look before you use the numbers) or "error" (the numbers are wrong).
    code
        A stable, lower-case name with hyphens for scripts, such as ``gaps``.
    text
        The observation, as one sentence.
    advice
        What to do, as one sentence; empty if nothing.
    axis
        An axis, such as ``gyro_x``; a sensor, such as ``gyro``; or None for the log.
    keep_s
        Start and end of the good part, in s from the start of the log (for `imucal.pipeline.screen`: of its
        recording); None for all of it.
    fix
        The argument of a function, and its value, that follows the advice; None if there is none.
    """

    level: Level
    code: str
    text: str
    advice: str = ""
    _: KW_ONLY
    axis: str | None = None
    keep_s: tuple[float, float] | None = None
    fix: Fix | None = None


def as_sentence(text: str) -> str:
    """Return the text of an error as a sentence: with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def options_to_keep(keep_s: tuple[float, float]) -> str:
    """Return the options that keep a part of a log, such as ``--skip 145s --take 51.5s``."""
    start, end = keep_s
    skip = f"--skip {start:.10g}s " if start > 0 else ""
    return f"{skip}--take {round(end - start, 1):.10g}s"


class CodeText(NamedTuple):
    """Texts about a code in docs/messages.md and in the verdict.

    `phrase` is for the sentence of the verdict, empty for the code itself. `found` and `advice` are a row of
    the page's table below `section`; codes without `found` share the row of the code above.
    """

    section: str
    phrase: str
    found: str
    advice: str


@cache
def code_texts() -> dict[str, CodeText]:
    """Return all codes of findings, in the order of docs/messages.md."""
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
    """Return the phrase of a code for the verdict; an unknown code is its own phrase."""
    text = code_texts().get(code)
    return text.phrase if text and text.phrase else code.replace("-", " ")
