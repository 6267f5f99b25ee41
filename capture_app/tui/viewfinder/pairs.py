"""Of what two cameras see, the two pictures that were taken nearest to the same instant."""

from collections import deque

from capture_app.node.wire.views import Preview

KEPT = 12
"""Previews of each camera: some seconds."""


class InstantPairs:
    """Keeps the last previews of two cameras whose times are known."""

    def __init__(self, first: str, second: str) -> None:
        self._previews: dict[str, deque[Preview]] = {camera: deque(maxlen=KEPT) for camera in (first, second)}
        self._cameras = first, second

    def add(self, preview: Preview) -> None:
        """Keep a preview, if it is of one of them and its time is known."""
        if preview.leader_ns is not None and preview.camera in self._previews:
            self._previews[preview.camera].append(preview)

    def nearest(self) -> tuple[Preview, Preview] | None:
        """The two of least distance in time, the newest of equals; None where one has no preview yet."""
        first, second = (self._previews[camera] for camera in self._cameras)
        pairs = [(one, other) for one in first for other in second]
        return min(pairs, key=lambda pair: (abs(distance_ns(*pair)), -_time(pair[0])), default=None)


def distance_ns(first: Preview, second: Preview) -> int:
    """By how much the second was taken after the first."""
    return _time(second) - _time(first)


def _time(preview: Preview) -> int:
    assert preview.leader_ns is not None
    return preview.leader_ns
