"""``imucal export`` of the folder of a calibration."""

from pathlib import Path
from typing import Any

import click

from imucal.atomic import write_configs
from imucal.calibration.document import Intrinsics, load_intrinsics
from imucal.calibration.exports import (
    CALIBRATION_TARGETS,
    CalibrationTarget,
    find_calibration_target,
    render_calibration,
)
from imucal.calibration.writer import NOISE_NAME
from imucal.cli._declared import misuse
from imucal.cli._printing import echo, say
from imucal.errors import DataError
from imucal.report.exports import find_target
from imucal.report.json_file import load
from imucal.report.result import Report

__all__ = ["export_calibration", "require_noise_targets"]


def require_noise_targets(names: tuple[str, ...], source: str) -> None:
    """Raise a usage error for a format that only a calibration can fill."""
    for name in names:
        try:
            if name != "all":
                find_target(name)
        except ValueError:
            misuse(
                f"{name} is for a calibration, and {source} is not one; run 'imucal calibrate' on a log",
                "--to",
            )


def _texts(
    found: Intrinsics, noise: Report | None, names: tuple[str, ...], options: dict[str, Any]
) -> dict[CalibrationTarget, str]:
    every = "all" in names
    try:
        targets = [find_calibration_target(name) for name in (CALIBRATION_TARGETS if every else names)]
    except ValueError as error:
        misuse(error, "--to")
    texts = {}
    for target in targets:
        try:
            texts[target] = render_calibration(found, target.name, noise, **options)
        except DataError as error:
            if not every:
                raise
            say(f"{target.name} is not written: {error}")
    return texts


def export_calibration(path: Path, names: tuple[str, ...], out: Path | None, options: dict[str, Any]) -> None:
    """Write the files of a calibration; with ``all`` a program that it can't serve is named."""
    folder = path if path.is_dir() else path.parent
    noise = load(folder / NOISE_NAME) if (folder / NOISE_NAME).exists() else None
    texts = _texts(load_intrinsics(path), noise, names, options)
    several = "all" in names or len(texts) > 1
    if out == Path("-"):
        if several:
            misuse("standard output takes one format; name a folder", "-o")
        click.echo(next(iter(texts.values())), nl=False)
        return
    place = (out or Path("imucal-exports")) if several else out or Path()
    for file in write_configs({each.file_name: text for each, text in texts.items()}, place, folder=several):
        echo(str(file))
    if noise is None and any(target.noise for target in texts):
        say("The files have no noise numbers: run imucal calibrate with --noise REPORT")
