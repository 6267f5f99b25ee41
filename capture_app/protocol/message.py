"""Base class of all messages of a stream."""

from msgspec import Struct


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Message identified by its tag; unknown fields are an error."""
