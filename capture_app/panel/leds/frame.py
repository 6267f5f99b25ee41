"""The frame of an LED panel on a page to print: its markers, its dark ground, and a cross for each LED."""

from capture_app.board.page import Page
from capture_app.panel.pattern import MARKER_SIZE, Panel, marker_squares
from capture_app.text import duration

PITCH_MM = 10.0
"""From one LED to the next, unless something else is asked for: it suits LEDs of 5 mm."""
CROSS_MM = (4.0, 0.3)
"""Length and width of a cross's lines."""


def frame_page(panel: Panel, paper: str = "a4", pitch_mm: float = PITCH_MM) -> Page:
    """Return the page; raises BadInputError where the frame does not fit the paper."""
    size = panel.width * pitch_mm, panel.height * pitch_mm
    page = Page(paper, size, "a frame", smaller="smaller --pitch-mm")

    def placed(x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        return page.left + x * pitch_mm, page.top + y * pitch_mm, width * pitch_mm, height * pitch_mm

    page.black += [placed(*ground) for ground in panel.dark]
    for marker in panel.markers:
        page.black.append(placed(marker.x, marker.y, MARKER_SIZE, MARKER_SIZE))
        squares = marker_squares(marker.number)
        side = MARKER_SIZE / len(squares)
        page.white += [
            placed(marker.x + column * side, marker.y + row * side, side, side)
            for row, line in enumerate(squares)
            for column, white in enumerate(line)
            if white
        ]
    length, width = CROSS_MM
    for lamp in panel.lamps:
        x, y = page.left + lamp.x * pitch_mm, page.top + lamp.y * pitch_mm
        page.white.append((x - length / 2, y - width / 2, length, width))
        page.white.append((x - width / 2, y - length / 2, width, length))
    each = f"{duration(panel.tick_ns)} a column, LEDs {pitch_mm:g} mm apart"
    page.add_foot(
        f"simulshot panel {panel.name}: {each}",
        "Print at 100 % (not 'fit to page'). An LED goes through the middle of each cross.",
    )
    return page
