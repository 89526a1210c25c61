"""Messages -> columns: a topic is a table of the numbers in its messages."""

from imucal.readers.messages.choice import Choice, choose
from imucal.readers.messages.loader import decode
from imucal.readers.messages.topics import Column, Topic, find_topics, plan_of

__all__ = ["Choice", "Column", "Topic", "choose", "decode", "find_topics", "plan_of"]
