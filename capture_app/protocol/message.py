"""The base of all messages of a stream."""

from msgspec import Struct


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message is told from others by its tag; what this version does not know is an error."""
