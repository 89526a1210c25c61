"""MCAP: ROS 2, ROS 1 and JSON messages, chunks uncompressed or in lz4 or zstd.

An intact file is read by the index at its end; a cut, unindexed or damaged one by scanning its records.
"""

from pathlib import Path

from imucal.readers.assemble import describe_logs, read_logs
from imucal.readers.containers.mcap_file import McapFile
from imucal.readers.contents import LogContents
from imucal.readers.read_options import ReadOptions
from imucal.recording import Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU topic of an MCAP file.

    Raises
    ------
    ReadError
        If the file can't be read; `ChoiceError` if several topics fit or none does.
    """
    return read_logs([McapFile(path)], path, options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the topics of an MCAP file, by its index."""
    return describe_logs([McapFile(path)], path, options)
