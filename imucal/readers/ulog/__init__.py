"""PX4 ULog files."""

from imucal.readers.ulog.ulog_log import describe, read
from imucal.readers.ulog.ulog_messages import MESSAGES

__all__ = ["MESSAGES", "describe", "read"]
