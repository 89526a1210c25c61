"""ROS 1 bags of version 2.0: chunks uncompressed, or in lz4 or bz2."""

from pathlib import Path

from imucal.readers.assemble import describe_logs, read_logs
from imucal.readers.containers.ros1_file import BagFile
from imucal.readers.contents import LogContents
from imucal.readers.read_options import ReadOptions
from imucal.recording import Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU topic of a bag.

    Raises
    ------
    ReadError
        If the bag can't be read; `ChoiceError` if several topics fit or none does.
    """
    return read_logs([BagFile(path)], path, options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the topics of a bag, by its index."""
    return describe_logs([BagFile(path)], path, options)
