"""Authenticated sender of a sealed datagram."""

from dataclasses import dataclass

from capture_app.sync.wire.datagrams import Hello


@dataclass(frozen=True, slots=True)
class Principal:
    """Node identified by the key issued to it, for one instance of it under one name."""

    name: str
    instance: int
    pin: str = ""
    """Pin of its machine's certificate."""
    is_relay: bool = False
    """Whether it may introduce other nodes."""

    def may_introduce(self, hello: Hello) -> bool:
        """Whether a hello is the node's own, or a relay's for a node below it."""
        if hello.via is not None:
            return self.is_relay
        return (hello.name, hello.instance) == (self.name, self.instance)
