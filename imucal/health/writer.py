"""The folder of a diagnosis: doctor.json, a page, and a picture of each row that failed or warned."""

import re
from collections.abc import Callable
from pathlib import Path

from imucal.errors import Fix
from imucal.health.diagnosis import Diagnosis
from imucal.health.document import SCHEMA, to_document
from imucal.report.out_folder import OutFolder
from imucal.report.typed_json import dumps

__all__ = ["FILE_NAME", "PAGE_NAME", "check_folder", "write_diagnosis"]

FILE_NAME = "doctor.json"
PAGE_NAME = "doctor.html"
_OWN = re.compile(r"doctor\.(json|html)|doctor-[a-z-]+\.png")


def check_folder(out: str | Path) -> None:
    """Raise a WriteError if `write_diagnosis` could not write to a folder."""
    _folder(out).check()


def _folder(out: str | Path) -> OutFolder:
    return OutFolder(path=Path(out), what="diagnosis", document=FILE_NAME, schema=SCHEMA, own=_OWN)


def write_diagnosis(
    diagnosis: Diagnosis, out: str | Path, *, option_of: Callable[[Fix], str] = lambda _: ""
) -> tuple[Path, ...]:
    """Write the folder `out`; return its files, doctor.json first.

    A diagnosis that is there is replaced, other files are kept. `option_of` returns the option that follows
    a fix, for the page. A WriteError is raised if the folder can't be written, or contains something other
    than a diagnosis.
    """
    from imucal.health.figure import picture
    from imucal.health.page import render_page

    folder = _folder(out)
    folder.refuse_foreign()
    pictures = {
        row.code: picture(diagnosis, row, row.evidence) for row in diagnosis.rows if row.evidence is not None
    }
    contents = {
        FILE_NAME: dumps(to_document(diagnosis)).encode(),
        PAGE_NAME: render_page(diagnosis, pictures, option_of).encode(),
        **{f"doctor-{code}.png": content for code, content in pictures.items()},
    }
    return folder.write(contents)
