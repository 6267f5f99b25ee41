"""The numbers of frames as the transport has them."""


class FrameNumbers:
    """Counts frames by the transport's numbers, which have 16 bits and no 0 in GigE Vision 1."""

    _CYCLE = 65_535

    def __init__(self) -> None:
        self._last: int | None = None
        self._sequence = 0

    def count(self, number: int) -> int | None:
        """The number of a frame since the first one; None for one that came before."""
        if self._last is not None:
            step = number - self._last
            if step < -self._CYCLE // 2 and self._last <= self._CYCLE:
                step += self._CYCLE
            if step <= 0:
                return None
            self._sequence += step
        self._last = number
        return self._sequence
