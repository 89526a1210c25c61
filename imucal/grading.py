"""The verdict, in one sentence, on whether a recording is stationary noise.

The most severe finding determines it, by its level or by an entry in `OTHERWISE`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from imucal.errors import DataError, Fix
from imucal.findings import Finding, Level, options_to_keep, phrase_of

#: check: read the findings first; not-noise: the numbers are wrong.
Grade: TypeAlias = Literal["good", "check", "not-noise"]

#: Grade -> its words in a printed verdict. A calibration is not usable if a log would be not noise.
GRADE_TEXTS: Mapping[str, str] = {
    "good": "good",
    "check": "check first",
    "not-noise": "not noise",
    "not-usable": "not usable",
}

#: The most severe last.
GRADES: tuple[Grade, ...] = ("good", "check", "not-noise")

BY_LEVEL: Mapping[Level, Grade] = {"info": "good", "warning": "check", "error": "not-noise"}

#: These findings do not affect the noise.
OTHERWISE: Mapping[tuple[str, Level], Grade] = {
    ("unindexed", "warning"): "good",
    ("index", "warning"): "good",
    ("not-drawn", "warning"): "good",
}

#: About every axis if the finding is about the whole log.
OF_ALL_AXES = frozenset({"motion", "touch", "duplicate-axes", "swapped-sensors", "absurd-rate", "fast-rate"})

DISTURBED = frozenset({"motion", "touch"})

#: Doubts about a unit: the noise may still be stationary.
_OF_UNITS = frozenset({"unit-suspect", "unit-of-sensor", "unit-given", "unit-assumed"})
#: Of these, the ones that name a better unit.
_BETTER_UNIT = frozenset({"unit-suspect", "unit-of-sensor"})

#: Use the numbers in spite of the verdict.
FORCE = Fix("force it", "force")

#: Number of reasons in a sentence.
_NAMED = 3


@dataclass(frozen=True, kw_only=True)
class NoiseVerdict:
    """The verdict on a recording; `axes` are the axes whose numbers are not wrong."""

    grade: Grade
    sentence: str
    axes: tuple[str, ...]

    @property
    def usable(self) -> bool:
        """Whether a filter may use the numbers: the log is noise at rest."""
        return self.grade != "not-noise"


def grade_of(finding: Finding) -> Grade:
    """Return the grade of one finding."""
    return OTHERWISE.get((finding.code, finding.level), BY_LEVEL[finding.level])


def is_motion(finding: Finding) -> bool:
    """Return whether a finding reports so much motion that the log is not noise."""
    return finding.code in DISTURBED and finding.level == "error"


def refusal(
    verdict: NoiseVerdict,
    findings: Iterable[Finding],
    *,
    place: object,
    consequence: str,
    if_moved: Sequence[Fix] = (),
) -> DataError:
    """Return the error for a log that is not noise; `consequence` is such as ``nothing was exported``.

    The fixes `if_moved` are added if the IMU was moved.
    """
    sentence = verdict.sentence[0].lower() + verdict.sentence[1:]
    fixes = _fixes(findings, if_moved)
    return DataError(f"{sentence}; {consequence}", place=place, fixes=fixes, code="not-noise")


def _fixes(findings: Iterable[Finding], if_moved: Sequence[Fix]) -> tuple[Fix, ...]:
    moved = [finding for finding in findings if is_motion(finding)]
    if not moved:
        return Fix("record again at rest"), FORCE
    if any(finding.fix and finding.fix.argument == "rests" for finding in moved):
        return Fix("fit the rests", "rests"), *if_moved
    kept = next((finding.keep_s for finding in moved if finding.keep_s), None)
    if kept:
        return Fix(f"fit the quiet part with {options_to_keep(kept)}"), *if_moved
    return Fix("record again at rest"), *if_moved, FORCE


def unit_fix(findings: Iterable[Finding], reading: Mapping[str, object]) -> Fix | None:
    """Return the unit or scale to give if a unit looks wrong; None if it was given in `reading`."""
    for finding in findings:
        fix = finding.fix
        if finding.code not in _BETTER_UNIT or fix is None:
            continue
        given = reading.get(fix.argument)
        # X is any scale.
        if given != fix.value and not (given and fix.value == "X"):
            return fix
    return None


def judge_findings(
    findings: Iterable[Finding],
    axes: Sequence[str],
    *,
    errors: Mapping[str, float] | None = None,
    too_short: bool = False,
) -> NoiseVerdict:
    """Return the verdict on a recording, from all findings about the log and its axes.

    `axes` contains the names of all axes, with or without a result. `errors` contains the relative half-width
    of the interval of N by axis, if known. A record that is `too_short` can't show B and K.
    """
    grave = _grave(findings)
    grade: Grade = max(map(grade_of, grave), key=GRADES.index, default="good")
    decisive = [finding for finding in grave if grade_of(finding) == grade]
    reasons = _reasons(decisive, axes)
    sound = _untouched(_grave(grave, without=_OF_UNITS), axes)
    left = _untouched(decisive, axes)
    noise = _noise(sound, len(axes), errors or {})
    if grade == "good":
        good = "Good for N; too short for B and K" if too_short else "Good"
        sentence = f"{good}: {noise or 'no problem found'}"
    elif grade == "check":
        sentence = f"Check first: {reasons}{f'; {noise}' if sound else ''}"
    else:
        rest = f"look at {_listed(left, axes)} first" if left else "do not use these numbers"
        sentence = f"Not noise: {reasons}; {noise if sound else rest}"
    right = axes if grade != "not-noise" else left
    return NoiseVerdict(grade=grade, sentence=sentence, axes=tuple(right))


def _grave(findings: Iterable[Finding], without: frozenset[str] = frozenset()) -> list[Finding]:
    return [one for one in findings if grade_of(one) != "good" and one.code not in without]


def _untouched(grave: Sequence[Finding], axes: Sequence[str]) -> list[str]:
    return [
        name
        for name in axes
        if not any(f.code in OF_ALL_AXES if f.axis is None else _within(name, f.axis) for f in grave)
    ]


def _noise(sound: Sequence[str], count: int, errors: Mapping[str, float]) -> str:
    """Return ``6 of 6 axes are stationary noise, N to ±0.4 %``, with the widest interval."""
    if not count:
        return ""
    text = f"{len(sound)} of {count} {'axis is' if count == 1 else 'axes are'} stationary noise"
    known = [errors[name] for name in sound if name in errors]
    return f"{text}, N to ±{percent(max(known))}" if known else text


def percent(fraction: float) -> str:
    """Return a positive fraction with two digits, such as ``0.43 %`` or ``12 %``."""
    return f"{float(f'{100 * fraction:.2g}'):g} %"


def _reasons(findings: Sequence[Finding], axes: Sequence[str]) -> str:
    """Return the phrases of findings with their axes; the first ones and a count if there are many."""
    places: dict[str, list[str]] = {}
    for finding in findings:
        phrase = phrase_of(finding.code)
        places.setdefault(phrase, []).append(finding.axis or "")
    phrases = [_placed(phrase, names, axes) for phrase, names in places.items()]
    more = len(phrases) - _NAMED
    return ", ".join(phrases[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _placed(phrase: str, names: Sequence[str], axes: Sequence[str]) -> str:
    given = [name for name in dict.fromkeys(names) if name]
    about = [axis for axis in axes if any(_within(axis, name) for name in given)]
    about += [name for name in given if not any(_within(axis, name) for axis in axes)]
    return f"{phrase} on {_listed(about, axes)}" if about else phrase


def _listed(about: Sequence[str], axes: Sequence[str]) -> str:
    """Return ``gyro, accel_x and accel_y``: a sensor's name for all of its axes."""
    *first, last = dict.fromkeys(_shortest(name, about, axes) for name in about)
    return f"{', '.join(first)} and {last}" if first else last


def _shortest(name: str, about: Sequence[str], axes: Sequence[str]) -> str:
    """Return the sensor of an axis if all its axes are in `about`, otherwise the axis."""
    sensor = name.partition("_")[0]
    family = {axis for axis in axes if _within(axis, sensor)}
    return sensor if len(family) > 1 and family <= set(about) else name


def _within(axis: str, name: str) -> bool:
    return axis == name or axis.startswith(f"{name}_")
