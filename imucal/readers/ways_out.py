"""What to do with files of formats that are known and not read: a way to one that is, in a sentence.

A program that runs here is written out to be typed; of a device's own format its maker's program is named.
"""

import re
import shlex
from typing import NamedTuple

_SHEET = "save the sheet with the samples as CSV (File, Save As, CSV)"
_TRUSTED = "where you trust it"
_LOADED = 'python -c "import numpy, sys; log = numpy.load(sys.argv[1], allow_pickle=True); '
_UNPACK = "unpack it, and name the log that was in it"


class _Foreign(NamedTuple):
    """A format that is not read: the start of its files, its name, and what to do."""

    start: bytes
    name: str
    way: str

    def said(self, path: str) -> str:
        """Return what the file is and what to do with it."""
        return f"it is {self.name}; {self.way.replace('LOG', shlex.quote(path))}"


#: In the order in which they are tried; `LOG` is the file.
_BINARY = (
    _Foreign(rb"PK\x03\x04.{26,60}(\[Content_Types\]\.xml|_rels/|docProps/|xl/)", "an Excel workbook", _SHEET),
    _Foreign(rb"PK\x03\x04.{26}mimetypeapplication/vnd\.oasis", "an OpenDocument spreadsheet", _SHEET),
    _Foreign(rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an old Excel workbook", _SHEET),
    _Foreign(
        rb"H Product:Blackbox flight data recorder",
        "a blackbox of Betaflight, INAV or Cleanflight",
        "decode it with blackbox_decode LOG, which writes a CSV beside it (LOG without its ending, .01.csv)",
    ),
    _Foreign(
        rb"\x80[\x02-\x05]",
        "a Python pickle, which may run any program when it is loaded",
        f"{_TRUSTED} and it is a dict of arrays or a data frame, type: python -c "
        "\"import pickle, numpy, sys; numpy.savez('log.npz', **pickle.load(open(sys.argv[1], 'rb')))\" LOG",
    ),
    _Foreign(
        rb"\x93NUMPY.{4}\{'descr': '\|O', 'fortran_order': \w+, 'shape': \(\)",
        "a Python object",
        f"{_TRUSTED} and it is a dict of arrays, type: {_LOADED}numpy.savez('log.npz', **log.item())\" LOG",
    ),
    _Foreign(
        rb"\x93NUMPY.{4}\{'descr': '\|O'",
        "an array of Python objects",
        f"{_TRUSTED} and they are numbers, type: {_LOADED}numpy.save('log.npy', log.astype(float))\" LOG",
    ),
    _Foreign(
        rb"ARROW1",
        "an Arrow (Feather) file",
        'type: python -c "import polars, sys; '
        "polars.read_ipc(sys.argv[1]).write_parquet('log.parquet')\" LOG",
    ),
    _Foreign(rb"TDSm", "a TDMS file of National Instruments", "export it as CSV from LabVIEW, DIAdem or Excel"),
    _Foreign(rb"\xfa\xff", "Xsens' binary messages", "open it in MT Manager and export it as ASCII"),
    _Foreign(rb"ue[\x80-\xff]", "MicroStrain's binary packets", "export it as CSV from SensorConnect"),
    _Foreign(rb"\xaa\x44[\x12\x13]", "NovAtel's binary messages", "convert them to ASCII with NovAtel Convert"),
    _Foreign(rb"....ftyp", "a video", "extract its telemetry as CSV with a program for your camera"),
    _Foreign(rb"Rar!|7z\xbc\xaf\x27\x1c", "an archive", _UNPACK),
    _Foreign(rb".{257}ustar", "an archive", _UNPACK),
)
_TEXT = (
    _Foreign(
        rb"\s*\{\s*['\d]",
        "lines of Python dicts",
        'type: python -c "import ast, json, sys; [print(json.dumps(ast.literal_eval(line))) '
        'for line in sys.stdin]" < LOG > log.jsonl',
    ),
    _Foreign(
        rb"\s*\[\s*\{",
        "JSON in one piece",
        "write it with an object in each line: python -c "
        '"import json, sys; [print(json.dumps(row)) for row in json.load(open(sys.argv[1]))]" LOG > log.jsonl',
    ),
    _Foreign(
        rb"\s*\{\s*\"",
        "JSON in one piece",
        "where it holds a list for each column, type: python -c "
        "\"import json, numpy, sys; numpy.savez('log.npz', **json.load(open(sys.argv[1])))\" LOG",
    ),
)


#: What is in an NPZ file is seen only when it is read.
OBJECTS_IN_NPZ = _Foreign(
    b"",
    "arrays of Python objects",
    f"{_TRUSTED} and they are numbers, type: {_LOADED}"
    "numpy.savez('log.npz', **{name: numpy.array(log[name].tolist()) for name in log})\" LOG",
)


def way_out(path: str, start: bytes, *, text: bool = False) -> str:
    """Return what a file is and what to do with it; empty where its first bytes are none of a foreign format.

    What may be one of `text` is asked where a text could not be read, as some of it can.
    """
    known = _TEXT if text else _BINARY
    found = next((one for one in known if re.match(one.start, start, re.DOTALL)), None)
    return found.said(path) if found else ""
