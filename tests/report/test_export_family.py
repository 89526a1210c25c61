"""Required parts of every export format; a sentence reports each missing part."""

import re
from dataclasses import replace

import pytest

from imucal.report.exports import TARGETS
from imucal.report.exports.target import Target
from tests.report.downstream import READERS


def forgotten(target: Target) -> list[str]:
    """Return a sentence for each part that a format lacks, with the place to add it."""
    others = [other for other in TARGETS.values() if other is not target]
    taken = {_key(each) for other in others for each in (other.name, *other.aliases)}
    again = sorted(each for each in (target.name, *target.aliases) if _key(each) in taken)
    words = {"title": target.title, "heading": target.heading, "formulas": " ".join(target.formulas)}
    lacks = {
        f"{' and '.join(again)} stands for another format already": bool(again),
        "no file_name: name the file that a folder gets": not target.file_name,
        f"{target.file_name} is another format's file": target.file_name in {o.file_name for o in others},
        **{f"no {name} in its table": not text.strip() for name, text in words.items()},
        "its kind does not say whether the numbers are continuous or discrete": (
            not re.search("continuous|discrete", target.kind)
        ),
        "its file has no `about` that says what the consumer does with the numbers": not target.about,
        "its source does not say what was read: source, documentation, or no program": (
            not re.match("(source|documentation|no program): ", target.source)
        ),
        "nothing reads it back: add the consumer's parser to READERS in tests/report/downstream.py": (
            target.name not in READERS
        ),
    }
    return [f"{target.name}: {sentence}" for sentence, missing in lacks.items() if missing]


def _key(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


@pytest.mark.parametrize("name", TARGETS)
def test_a_format_is_complete(name: str) -> None:
    """A format needs names, texts and a parser in the tests."""
    assert forgotten(TARGETS[name]) == []


def test_an_incomplete_new_format_is_reported() -> None:
    """The format has only a line in the table."""
    fake = Target(name="fake", title="", file_name="", heading="", source="", kind="", formulas=(), text="")
    assert forgotten(fake) == [
        "fake: no file_name: name the file that a folder gets",
        "fake: no title in its table",
        "fake: no heading in its table",
        "fake: no formulas in its table",
        "fake: its kind does not say whether the numbers are continuous or discrete",
        "fake: its file has no `about` that says what the consumer does with the numbers",
        "fake: its source does not say what was read: source, documentation, or no program",
        "fake: nothing reads it back: add the consumer's parser to READERS in tests/report/downstream.py",
    ]


def test_a_duplicate_name_or_file_is_reported() -> None:
    """The format is a copy of Kalibr's under a new name."""
    copy = replace(TARGETS["kalibr"], name="Kalibr 2", aliases=("open-vins",))
    assert forgotten(copy)[:2] == [
        "Kalibr 2: open-vins stands for another format already",
        "Kalibr 2: kalibr_imu.yaml is another format's file",
    ]
