"""Dots in braille: two across and four down in each cell of the terminal."""

_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_EMPTY = 0x2800


class DotCanvas:
    """A grid of dots, (0, 0) at the top left; `width` and `height` count cells."""

    def __init__(self, width: int, height: int) -> None:
        self.width = width
        self.height = height
        self._cells = [[0] * width for _ in range(height)]

    @property
    def dots(self) -> tuple[int, int]:
        """How many dots there are across and down."""
        return 2 * self.width, 4 * self.height

    def put(self, x: int, y: int) -> None:
        """Put a dot; beyond the edge nothing happens."""
        if 0 <= x < 2 * self.width and 0 <= y < 4 * self.height:
            self._cells[y // 4][x // 2] |= _BITS[y % 4][x % 2]

    def put_column(self, x: int, y: int, to_y: int) -> None:
        """Put the dots of one column from `y` to `to_y`, both ends included."""
        for each in range(min(y, to_y), max(y, to_y) + 1):
            self.put(x, each)

    def row(self, y: int, empty: str = " ") -> str:
        """A row of cells as text, `empty` where there is no dot."""
        return "".join(chr(_EMPTY + bits) if bits else empty for bits in self._cells[y])
