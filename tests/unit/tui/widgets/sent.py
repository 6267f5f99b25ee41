"""A picture that a terminal was sent, without a terminal."""

from collections.abc import Iterator

from rich.console import Console, ConsoleOptions
from rich.segment import Segment
from rich.style import Style

PLACEHOLDER = "\U0010eeee"


class Sent:
    """Stands in for textual-image's picture: a mark in each cell."""

    held = 0

    def __init__(self, picture: object, columns: int, rows: int) -> None:
        self._size = columns, rows

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        columns, rows = self._size
        Sent.held += 1
        for _ in range(rows):
            yield Segment(PLACEHOLDER * columns + "\n", Style(color="#010203"))

    def cleanup(self) -> None:
        Sent.held -= 1
