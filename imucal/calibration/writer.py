"""The folder of a calibration: calibration.json, pictures, a page, and the noise report it was made with."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path

from imucal.atomic import alone, replacing, sync_folder
from imucal.calibration.document import FILE_NAME, to_document
from imucal.calibration.result import Calibration
from imucal.errors import WriteError
from imucal.report import json_file
from imucal.report.result import Report
from imucal.report.writer import held_by, home_of

__all__ = ["NOISE_NAME", "PAGE_NAME", "check_folder", "is_calibration", "write_calibration"]

#: Copy of the noise report; exports write its numbers next to the intrinsics.
NOISE_NAME = "noise.json"
PAGE_NAME, PICTURES = "calibration.html", ("rests.png", "attitudes.png", "turns.png")


def is_calibration(path: Path) -> bool:
    """Return whether a path is a calibration.json or its folder."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        document = json.loads(file.read_bytes()) if file.suffix == ".json" else None
    except (OSError, ValueError):
        return False
    schema = document.get("schema") if isinstance(document, Mapping) else None
    return isinstance(schema, str) and schema.startswith("imucal/calibration/")


def check_folder(out: Path) -> None:
    """Raise a WriteError if a folder can't take a calibration.

    It must be missing, empty or a calibration, and writable.
    """
    if (held := held_by(out)) and not is_calibration(out):
        msg = f"{out}: contains {held} but no calibration; nothing was changed; choose another folder"
        raise WriteError(msg)
    home = home_of(out)
    if not home.is_dir() or not os.access(home, os.W_OK | os.X_OK):
        reason = os.strerror(errno.EACCES if home.is_dir() else errno.ENOTDIR)
        raise WriteError(f"{out}: can't be written: {reason}; choose another folder")


def write_calibration(
    found: Calibration,
    out: str | Path,
    *,
    noise: Report | None = None,
    html: bool = True,
) -> tuple[Path, ...]:
    """Write the folder `out`; return its files, calibration.json first.

    Parameters
    ----------
    found
        The calibration.
    out
        The folder; a calibration that is there is replaced, other files are kept.
    noise
        The report that the calibration used; a copy is kept for exports.
    html
        Whether to write calibration.html and the three pictures.

    Raises
    ------
    WriteError
        If the folder can't be written, or contains something other than a calibration.
    """
    out = Path(out)
    check_folder(out)
    contents: dict[str, bytes] = {}
    if html:
        from imucal.calibration.figures import picture
        from imucal.calibration.page import render_page

        contents = {name: picture(found, Path(name).stem) for name in PICTURES}
        drawn = {Path(name).stem: content for name, content in contents.items()}
        contents[PAGE_NAME] = render_page(found, drawn).encode()
    if noise is not None:
        contents[NOISE_NAME] = json_file.dumps(json_file.to_document(noise)).encode()
    # The document comes last: with it the folder is complete.
    contents[FILE_NAME] = json_file.dumps(to_document(found)).encode()
    try:
        out.mkdir(parents=True, exist_ok=True)
        with alone(out):
            if noise is None:
                (out / NOISE_NAME).unlink(missing_ok=True)
            for name in () if html else (PAGE_NAME, *PICTURES):
                (out / name).unlink(missing_ok=True)
            for name, content in contents.items():
                with replacing(out / name) as scratch:
                    scratch.write_bytes(content)
        sync_folder(out)
    except OSError as error:
        raise WriteError(f"{out}: can't be written: {error.strerror}; choose another folder") from error
    return tuple(out / name for name in (FILE_NAME, *(name for name in contents if name != FILE_NAME)))
