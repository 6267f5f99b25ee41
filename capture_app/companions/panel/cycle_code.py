"""Cycle code of a screen's panel: cells beside the lamps with the number of the cycle, and of the page.

The lamps repeat after a cycle, 17 s at 60 Hz. The code identifies the cycle, which recordings that nothing
synchronized do not. Its cells are black or white squares of one pitch between the left markers and between
the right ones: 12 bits of the cycle, 6 bits that the page draws by chance when it is loaded, and a checksum
(CRC-6-ITU).
"""

from typing import NamedTuple

from capture_app.companions.panel.pattern import Panel

CYCLE_BITS, PAGE_BITS, CHECK_BITS = 12, 6, 6
BITS = CYCLE_BITS + PAGE_BITS + CHECK_BITS
CYCLES, PAGES = 1 << CYCLE_BITS, 1 << PAGE_BITS
"""Number of cycles before they repeat, 19 hours at 60 Hz; and of distinct pages."""
CHECK_POLYNOMIAL = 0b000011
"""CRC-6-ITU's polynomial, x^6 + x + 1, without its highest term."""
_ROWS, _COLUMNS = 6, 2
_LEFT = 1.0
"""Distance of the cells from the frame's left and right edges."""


class Cycle(NamedTuple):
    """What a cycle code says: the number of the cycle, and of the page that drew it."""

    number: int
    page: int


def cell_places(panel: Panel) -> tuple[tuple[float, float], ...]:
    """Return the upper left corners of the cells, in pitches, from the highest bit to the lowest."""
    top = panel.height / 2 - _ROWS / 2
    lefts = [_LEFT + n for n in range(_COLUMNS)]
    lefts += [panel.width - _LEFT - _COLUMNS + n for n in range(_COLUMNS)]
    return tuple((left, top + row) for left in lefts for row in range(_ROWS))


def encode_cycle(cycle: Cycle) -> tuple[int, ...]:
    """Return the cells of a cycle, 1 for black."""
    value = cycle.number % CYCLES << PAGE_BITS | cycle.page % PAGES
    coded = value << CHECK_BITS | _checksum(value)
    return tuple(coded >> bit & 1 for bit in reversed(range(BITS)))


def decode_cycle(cells: tuple[int, ...]) -> Cycle | None:
    """Return the cycle of cells, or None if their checksum is wrong."""
    coded = int("".join(map(str, cells)), 2)
    value = coded >> CHECK_BITS
    if coded & (1 << CHECK_BITS) - 1 != _checksum(value):
        return None
    return Cycle(value >> PAGE_BITS, value & PAGES - 1)


def _checksum(value: int) -> int:
    # All cells of a page without a code are white, and their checksum must be wrong.
    check = (1 << CHECK_BITS) - 1
    for bit in reversed(range(CYCLE_BITS + PAGE_BITS)):
        top = check >> CHECK_BITS - 1 ^ value >> bit & 1
        check = (check << 1 ^ (CHECK_POLYNOMIAL if top else 0)) & (1 << CHECK_BITS) - 1
    return check
