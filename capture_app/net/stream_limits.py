"""How many streams a port keeps open, and how long each may take: strangers must not use it up."""

import resource
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

MOST_STREAMS, MOST_OF_ONE_ADDRESS = 768, 384
"""A node has two open at most; those below a relay have the address of the relay."""
MOST_SILENT = 96
"""So many may have said nothing yet: TLS takes memory from a stream's first moment on."""
WANTED_FILES = 8192
FILES_OF_A_STREAM, OTHER_FILES = 2, 64


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to wait for a peer, in s."""

    first_s: float = 10.0
    """Until it has sent its first message."""
    idle_s: float | None = 120.0
    """Between two messages; None for ever."""
    message_s: float = 30.0
    """For the rest of a message, for the next piece of a payload, and until an answer is taken."""
    header_bytes: int = 1 << 16
    """The longest header of a peer that is not known yet."""


class Stream(Protocol):
    """What is known of a stream here."""

    @property
    def host(self) -> str:
        """Where it comes from."""

    @property
    def has_spoken(self) -> bool:
        """Whether it has sent a message."""

    @property
    def is_known(self) -> bool:
        """Whether its peer is a node that has joined."""

    def abort(self) -> None:
        """Break it off."""


class OpenStreams:
    """The streams of one port. For a new one room is made by one that has said nothing, or else is not known.

    Of several the oldest; those of nodes that have joined stay.
    """

    def __init__(self, most: int = MOST_STREAMS, most_of_one_address: int = MOST_OF_ONE_ADDRESS) -> None:
        self._most, self._most_of_one_address = most, most_of_one_address
        self._streams: dict[str, list[Stream]] = {}
        self.refused = 0
        """How many were broken off, of those that are there or that come, for lack of room."""

    def __len__(self) -> int:
        return sum(map(len, self._streams.values()))

    def admit(self, stream: Stream) -> bool:
        """Whether a new stream may stay; another one may be broken off for it."""
        own = self._streams.get(stream.host, [])
        silent = [[one for one in streams if not one.has_spoken] for streams in self._streams.values()]
        if sum(map(len, silent)) >= MOST_SILENT:
            admitted = self._make_room(max(silent, key=len))
        elif len(own) >= self._most_of_one_address:
            admitted = self._make_room(own)
        elif len(self) >= self._most:
            # Whoever has the most is the likeliest to have too many.
            admitted = any(map(self._make_room, sorted(self._streams.values(), key=len, reverse=True)))
        else:
            admitted = True
        if admitted:
            self._streams.setdefault(stream.host, []).append(stream)
        else:
            self.refused += 1
        return admitted

    def remove(self, stream: Stream) -> None:
        """Forget a stream that has ended, or was never admitted."""
        own = self._streams.get(stream.host, [])
        with suppress(ValueError):
            own.remove(stream)
        if not own:
            self._streams.pop(stream.host, None)

    def _make_room(self, streams: list[Stream]) -> bool:
        strangers = [stream for stream in streams if not stream.is_known]
        stream = next((one for one in strangers if not one.has_spoken), next(iter(strangers), None))
        if stream is None:
            return False
        self.refused += 1
        stream.abort()
        self.remove(stream)
        return True


def allowed_streams() -> int:
    """Return how many streams this process has files for, after it has asked for as many as it may have."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY:
        wanted = WANTED_FILES if hard == resource.RLIM_INFINITY else min(WANTED_FILES, hard)
        if wanted > soft:
            with suppress(OSError, ValueError):
                resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
                soft = wanted
        return max(1, min(MOST_STREAMS, (soft - OTHER_FILES) // FILES_OF_A_STREAM))
    return MOST_STREAMS
