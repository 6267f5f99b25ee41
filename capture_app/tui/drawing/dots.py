"""Marks in the cells of a terminal, of block glyphs that every monospaced font has (braille many lack)."""

_QUARTERS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"
_LINES = {0: " ", 1: "▔", 2: "─", 4: "▁"}
_STROKE = "│"


class DotCanvas:
    """A grid of dots, two across and two down in each cell; (0, 0) is at the top left."""

    def __init__(self, width: int, height: int) -> None:
        """`width` and `height` count cells."""
        self.dots = 2 * width, 2 * height
        """How many dots there are across and down."""
        self._cells = [[0] * width for _ in range(height)]

    def put(self, x: int, y: int) -> None:
        """Put a dot; beyond the edge nothing happens."""
        if 0 <= x < self.dots[0] and 0 <= y < self.dots[1]:
            self._cells[y // 2][x // 2] |= 1 << (2 * (y % 2) + x % 2)

    def row(self, y: int) -> str:
        """A row of cells as text."""
        return "".join(_QUARTERS[marks] for marks in self._cells[y])


class TraceCanvas:
    """A thin line over time: one value a cell, at one of three levels in each row of cells."""

    def __init__(self, width: int, height: int) -> None:
        """`width` and `height` count cells."""
        self.levels = 3 * height
        """How many levels there are; 0 is the highest."""
        self._cells = [[0] * width for _ in range(height)]

    def put(self, x: int, level: int, to_level: int) -> None:
        """Draw column `x` from one level to another, both ends included."""
        for each in range(min(level, to_level), max(level, to_level) + 1):
            self._cells[each // 3][x] |= 1 << (each % 3)

    def row(self, y: int, empty: str = " ") -> str:
        """A row of cells as text, `empty` where the line is not."""
        return "".join(_LINES.get(marks, _STROKE) if marks else empty for marks in self._cells[y])
