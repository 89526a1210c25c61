"""Read one log: open it, choose its tables once, and assemble them."""

from dataclasses import replace
from pathlib import Path

from imucal.readers.assemble import assemble
from imucal.readers.choose import choose
from imucal.readers.files import naming
from imucal.readers.formats import open_log
from imucal.readers.read_options import ReadOptions
from imucal.recording import ReadRange, Recording


def read_one(path: Path, options: ReadOptions) -> Recording:
    """Read a log; raises the errors of `imucal.readers.read`."""
    with open_log(path, options) as log, naming(path):
        recording = assemble(log, choose(log, options), options)
    if not options.is_part:
        return recording
    before = log.left_out_s
    if before:
        read = ReadRange.of(recording.series, from_s=before)
        recording = replace(recording, source=replace(recording.source, read=read))
    return recording.between(options.skip_s - before, options.end_s - before)
