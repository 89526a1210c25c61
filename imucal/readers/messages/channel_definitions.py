"""The definition of a channel's message type: the log's own, one that is given, or the standard one."""

from dataclasses import dataclass

from imucal.readers.containers import Channel
from imucal.readers.messages.definition_files import definition_of, read_definitions
from imucal.readers.messages.definitions import (
    DefinitionError,
    Field,
    built_in,
    flatten,
    plain_type,
)
from imucal.readers.read_options import ReadOptions


@dataclass(frozen=True, slots=True)
class ChannelDefinition:
    """The definition of a channel's type, and whether it is `assumed` from the type's name.

    `more` are definitions of other types; None where the log's own definition is whole.
    """

    text: str
    assumed: bool
    more: dict[str, str] | None = None

    def fields(self, channel: Channel) -> tuple[Field, ...]:
        """Return the flat fields; a DefinitionError where they can't be told."""
        return flatten(channel.type, self.text, ros1=channel.encoding == "ros1", more=self.more)


def definition_of_channel(channel: Channel, options: ReadOptions) -> ChannelDefinition:
    """Return the definition of a channel's type: the log's own, one that is given, or the standard one.

    Raises
    ------
    DefinitionError
        If the type has no definition, or one that can't be read.
    """
    standard = built_in(channel.type, ros1=channel.encoding == "ros1")
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        own = ChannelDefinition(channel.definition, assumed=False)
        try:
            own.fields(channel)
        except DefinitionError:
            # A damaged definition of a well-known type loses nothing: messages must have its size.
            if standard is None:
                raise
            return ChannelDefinition(standard, assumed=True)
        return own
    given = read_definitions(options.message_definitions)
    text = definition_of(channel.type, given)
    if text is not None:
        return ChannelDefinition(text, assumed=True, more=given)
    if standard is None:
        kind = f" but of kind {channel.definition_kind!r}" if channel.definition_kind else ""
        others = ", ".join(sorted(name.strip("/") for name in given)[:8])
        names = f", those that are given are of {others}" if given else ""
        last = plain_type(channel.type).rpartition("/")[2]
        msg = f"the log holds no definition of {channel.type}{kind}{names}; give its .msg file, {last}.msg"
        raise DefinitionError(msg)
    return ChannelDefinition(standard, assumed=True)


def is_given(channel: Channel, options: ReadOptions) -> bool:
    """Return whether the user gives the definition of a channel's type."""
    return definition_of(channel.type, read_definitions(options.message_definitions)) is not None
