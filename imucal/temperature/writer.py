"""The folder of a temperature ramp: thermal.json, a page, and a picture of each sensor."""

import re
from pathlib import Path

from imucal.recording import Sensor
from imucal.report.out_folder import OutFolder, has_schema
from imucal.report.typed_json import dumps
from imucal.temperature.document import FILE_NAME, SCHEMA, to_document
from imucal.temperature.result import Thermal

__all__ = ["PAGE_NAME", "check_folder", "is_thermal", "write_thermal"]

PAGE_NAME = "thermal.html"
#: Sensor -> its picture.
PICTURES = {sensor: f"thermal-{sensor.short}.png" for sensor in Sensor}
_OWN = re.compile("|".join(map(re.escape, (FILE_NAME, PAGE_NAME, *PICTURES.values()))))


def is_thermal(path: Path) -> bool:
    """Whether a path is a thermal.json or its folder."""
    file = path / FILE_NAME if path.is_dir() else path
    return file.suffix == ".json" and has_schema(file, SCHEMA)


def check_folder(out: str | Path) -> None:
    """Raise a WriteError if `write_thermal` could not write to a folder."""
    _folder(out).check()


def _folder(out: str | Path) -> OutFolder:
    return OutFolder(path=Path(out), what="temperature ramp", document=FILE_NAME, schema=SCHEMA, own=_OWN)


def write_thermal(found: Thermal, out: str | Path, *, html: bool = True) -> tuple[Path, ...]:
    """Write the folder `out`; return its files, thermal.json first.

    A result that is there is replaced, other files are kept. If `html`, a page and pictures are written too.
    A WriteError is raised if the folder can't be written, or contains something other than a result.
    """
    folder = _folder(out)
    folder.refuse_foreign()
    contents = {FILE_NAME: dumps(to_document(found)).encode()}
    if html:
        from imucal.temperature.figures import picture
        from imucal.temperature.page import render_page

        drawn = {sensor: picture(found, sensor) for sensor in found.sensors}
        contents |= {PICTURES[sensor]: content for sensor, content in drawn.items()}
        contents[PAGE_NAME] = render_page(found, drawn).encode()
    return folder.write(contents)
