"""What an operator is told as it happens."""

from msgspec import Struct

from capture_app.node.wire.status import RigStatus
from capture_app.node.wire.views import NewsLine, Preview


class LinkLost(Struct, frozen=True):
    """The connection to the leader is lost, or was never there, and is being tried again."""

    reason: str
    """One sentence, with what to do about it."""


Update = RigStatus | NewsLine | Preview | LinkLost
