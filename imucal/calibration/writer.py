"""The folder of a calibration: calibration.json, pictures, a page, and the noise report."""

import re
from pathlib import Path

from imucal.calibration.document import FILE_NAME, SCHEMA, to_document
from imucal.calibration.result import Calibration
from imucal.report import json_file
from imucal.report.out_folder import OutFolder, has_schema
from imucal.report.result import Report
from imucal.report.typed_json import dumps

__all__ = ["NOISE_NAME", "PAGE_NAME", "check_folder", "is_calibration", "write_calibration"]

#: Copy of the noise report for exports.
NOISE_NAME = "noise.json"
PAGE_NAME, PICTURES = "calibration.html", ("rests.png", "attitudes.png", "turns.png")
_OWN = re.compile("|".join(map(re.escape, (FILE_NAME, NOISE_NAME, PAGE_NAME, *PICTURES))))


def is_calibration(path: Path) -> bool:
    """Whether a path is a calibration.json or its folder."""
    file = path / FILE_NAME if path.is_dir() else path
    return file.suffix == ".json" and has_schema(file, SCHEMA)


def check_folder(out: str | Path) -> None:
    """Raise a WriteError if `write_calibration` could not write to a folder."""
    _folder(out).check()


def _folder(out: str | Path) -> OutFolder:
    return OutFolder(path=Path(out), what="calibration", document=FILE_NAME, schema=SCHEMA, own=_OWN)


def write_calibration(
    found: Calibration,
    out: str | Path,
    *,
    noise: Report | None = None,
    html: bool = True,
) -> tuple[Path, ...]:
    """Write the folder `out`; return its files, calibration.json first.

    A calibration that is there is replaced, other files are kept. If `html`, a page and pictures are written
    too. A WriteError is raised if the folder can't be written, or contains something other than a
    calibration.
    """
    folder = _folder(out)
    folder.refuse_foreign()
    contents = {FILE_NAME: dumps(to_document(found)).encode()}
    if html:
        from imucal.calibration.figures import picture
        from imucal.calibration.page import render_page

        drawn = {Path(name).stem: picture(found, Path(name).stem) for name in PICTURES}
        contents |= {name: drawn[Path(name).stem] for name in PICTURES}
        contents[PAGE_NAME] = render_page(found, drawn).encode()
    if noise is not None:
        contents[NOISE_NAME] = dumps(json_file.to_document(noise)).encode()
    return folder.write(contents)
