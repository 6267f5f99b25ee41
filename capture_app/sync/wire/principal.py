"""Who speaks in a sealed datagram."""

from dataclasses import dataclass

from capture_app.sync.wire.messages import Hello


@dataclass(frozen=True, slots=True)
class Principal:
    """A node by the key that it was given, for one run of it under one name."""

    name: str
    instance: int
    pin: str = ""
    """That of its machine's certificate."""
    is_relay: bool = False
    """Whether it may bring in others."""

    def may_introduce(self, hello: Hello) -> bool:
        """Whether a hello is its own, or, of a relay, that of a node below it."""
        if hello.via is not None:
            return self.is_relay
        return (hello.name, hello.instance) == (self.name, self.instance)
