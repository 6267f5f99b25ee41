"""Where the pictures of a contact sheet lie: their size, their regions, and those in sight; all in cells."""

from collections.abc import Iterator

from textual.geometry import Offset, Region, Size

from capture_app.session.reading.take_sheet import TakeSheet

GUTTER = 9
"""Columns for the time of an instant."""
LEAST, MOST = 10, 60
"""Columns of a picture."""


def thumb_size_of(sheet: TakeSheet, room: Size, zoom: float) -> Size:
    """Columns and rows of a picture, where the whole sheet has that room."""
    wide = (room.width - GUTTER) // max(1, len(sheet.cameras)) - 1
    # Where there are few instants, large pictures must leave room for another row.
    high = int((room.height - 1) * 2 / max(2, min(sheet.instants, 3)) / sheet.aspect)
    width = round(min(max(min(wide, high, MOST), LEAST) * zoom, 4 * MOST, room.width - GUTTER))
    rows = max(2, round(width * sheet.aspect / 2))
    return Size(max(4, min(width, round(2 * rows / sheet.aspect))), rows)


def region_of(x: int, y: int, thumb: Size) -> Region:
    """A picture's region in the whole sheet, by the places of its camera and instant."""
    return Region(GUTTER + x * (thumb.width + 1), 1 + y * (thumb.height + 1), thumb.width, thumb.height)


def places_in_sight(sheet: TakeSheet, thumb: Size, scrolled: Offset, room: Size) -> Iterator[tuple[int, int]]:
    """Camera and instant of each picture that is seen, by their places."""
    left, top = scrolled
    for y in range(top // (thumb.height + 1), sheet.instants):
        if y * (thumb.height + 1) - top >= room.height:
            break
        for x in range(left // (thumb.width + 1), len(sheet.cameras)):
            if x * (thumb.width + 1) - left >= room.width - GUTTER:
                break
            yield x, y
