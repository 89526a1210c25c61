"""The downstream files of filters and simulators: a table of formats, each defined in a TOML file."""

import re
from collections.abc import Iterable
from pathlib import Path

from imucal.atomic import write_configs
from imucal.errors import ArgumentError, DataError, Fix
from imucal.grading import FORCE, refusal
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS, ExportOptions, advice_on_vague, vague_axes
from imucal.report.exports.target import Target, name_key, read_targets
from imucal.report.result import Report

__all__ = [
    "FAMILIES",
    "TARGETS",
    "ExportOptions",
    "export",
    "find_target",
    "refuse_unsound",
    "render",
]

#: Title of a family of formats -> its TOML files, in the order of the list that users see.
_FAMILIES = {
    "Odometry": ("visual", "gtsam"),
    "Lidar": ("lidar",),
    "Robots": ("ros", "autopilots", "simulators"),
    "GNSS, MATLAB": ("kf_gins", "matlab"),
    "Own program": ("own_program",),
}
#: Title of a family -> its formats.
FAMILIES: dict[str, tuple[Target, ...]] = {
    title: tuple(read_targets(files)) for title, files in _FAMILIES.items()
}
#: Name of a format -> the format.
TARGETS: dict[str, Target] = {target.name: target for family in FAMILIES.values() for target in family}

_NOTHING = "nothing was exported"
#: Names of other programs -> text of the error message.
_OTHERS = {
    "isaac": "Isaac ROS is isaac-ros, Isaac Sim is isaac-sim",
    "orbslam2": "ORB-SLAM2 uses no IMU",
    "okvis": "OKVIS2 is okvis2; the first OKVIS has the same keys under imu_params",
    "fastlivo": "FAST-LIVO2 is fast-livo2",
    "msckf": "MSCKF-VIO is msckf-vio, OpenVINS is openvins",
}


def find_target(name: str, *, others: Iterable[str] = ()) -> Target:
    """Return a format by its name or an alias.

    Raises ArgumentError with the nearest name. Its list of names includes `others`, which the caller accepts.
    """
    by_key = {
        name_key(each): target for target in TARGETS.values() for each in (target.name, *target.aliases)
    }
    found = by_key.get(name_key(name))
    if found is None:
        near = [target.name for key, target in by_key.items() if _is_slip(name_key(name), key)]
        meant = f"did you mean {near[0]}? " if near else ""
        text = f"{_OTHERS[name_key(name)]}; " if name_key(name) in _OTHERS else meant
        fix = Fix(f"{text}choose one of {', '.join([*TARGETS, *others])}", "target")
        raise ArgumentError(f"no downstream format {name!r}", fix=fix)
    return found


def render(report: Report, target: str, options: ExportOptions = DEFAULT_OPTIONS) -> str:
    """Return the text of a downstream file; options and errors as in `export`."""
    return find_target(target).render(report, options)


def refuse_unsound(report: Report, *, place: object) -> None:
    """Raise a DataError if a filter must not use a report.

    It is not noise at rest, or N of an axis is uncertain by more than a factor of 10.
    """
    if not report.verdict.usable:
        raise refusal(report.verdict, report.all_findings, place=place, consequence=_NOTHING)
    axes = vague_axes(report)
    if axes:
        problem = f"N of {', '.join(axes)} is uncertain by more than a factor of 10; {_NOTHING}"
        raise DataError(problem, place=place, fixes=(Fix(advice_on_vague(report)), FORCE), code="uncertain")


def export(
    report: Report, target: str, path: Path, options: ExportOptions = DEFAULT_OPTIONS
) -> tuple[Path, ...]:
    """Write the config file of a downstream consumer, with every conversion in a comment; return its files.

    `target` is a key of `TARGETS`, an alias, or ``all``. `path` is a file, or a folder (for ``all``), in
    which the file gets the format's usual name.

    Raises DataError, and writes nothing, if the report lacks a sensor or an axis that the format needs, or if
    a term was not detected and its bound is refused. Raises WriteError if a file can't be written, or if
    imucal did not write the existing one. Raises ValueError if the format or an option is unknown.
    """
    targets = tuple(TARGETS.values()) if target == "all" else (find_target(target),)
    texts = {each.file_name: each.render(report, options) for each in targets}
    return write_configs(texts, Path(path), folder=target == "all")


def _is_slip(typed: str, name: str) -> bool:
    """Return whether one letter is missing, extra or wrong, or two neighbours are swapped.

    Two wrong letters or another digit mean another program: LVI-SAM is not LIO-SAM.
    """
    if min(len(typed), len(name)) < 5 or re.sub(r"\D", "", typed) != re.sub(r"\D", "", name):
        return False
    start = 0
    while typed[start : start + 1] == name[start : start + 1] != "":
        start += 1
    rest, wanted = typed[start:], name[start:]
    swapped = rest[1::-1] + rest[2:]
    return wanted in {rest[1:], swapped} or rest == wanted[1:] or rest[1:] == wanted[1:]
