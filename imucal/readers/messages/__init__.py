"""Messages -> columns: a topic is a table of the numbers in its messages."""

from imucal.readers.messages.definitions import plain_type

__all__ = ["plain_type"]
