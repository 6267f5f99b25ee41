"""Pages to print at true size, as SVG or PDF, with a bar that reveals a wrong scale; the page of a board.

Lengths are in millimetres from the page's upper left corner. Everything is drawn as rectangles and text, so
that both formats have the same content.
"""

import html
from collections.abc import Iterator
from itertools import product

import cv2
import numpy as np

from capture_app.board.boards import DEFAULT_BOARD, CharucoBoard
from capture_app.common.errors import BadInputError

PAGES = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
"""Widths and heights of landscape pages, mm."""
MARGIN_MM = 9.0
"""White margin that markers need and printers leave empty, mm."""
FOOT_MM = 24.0
"""Space below the drawing for the bar and the text, mm."""
BAR_MM = 100.0
POINTS_PER_MM = 72 / 25.4
TEXT_MM = 3.2
Rectangle = tuple[float, float, float, float]
"""Left, top, width and height."""


class Page:
    """A page with one centred drawing: `black`, then `white` rectangles, then `lines`."""

    def __init__(self, paper: str, size: tuple[float, float], what: str, *, smaller: str) -> None:
        """Reserve the centre for a drawing of `size`, mm; `what` names it, `smaller` says how to shrink it.

        Raises BadInputError if it does not fit the page in either orientation.
        """
        needed = size[0] + 2 * MARGIN_MM, size[1] + MARGIN_MM + FOOT_MM
        fitting = [
            page
            for page in (PAGES[paper], PAGES[paper][::-1])
            if needed[0] <= page[0] and needed[1] <= page[1]
        ]
        if not fitting:
            raise BadInputError(
                f"{what} of {size[0]:g} x {size[1]:g} mm does not fit {paper.upper()}",
                hint=f"{needed[0]:g} x {needed[1]:g} mm are needed; a larger --page or {smaller}",
            )
        self.width, self.height = fitting[0]
        self.left = (self.width - size[0]) / 2
        self.top = (self.height - FOOT_MM + MARGIN_MM - size[1]) / 2
        self.black: list[Rectangle] = []
        self.white: list[Rectangle] = []
        self.lines: list[tuple[float, float, str]] = []
        """Left end and baseline of each line of text, which is TEXT_MM high, and the text."""
        self._foot = self.top + size[1] + 5.0

    def add_foot(self, *texts: str) -> None:
        """Add the bar that reveals a wrong scale below the drawing, and lines of text below the bar."""
        top = self._foot
        self.black.append((self.left, top + 3.0, BAR_MM, 1.0))
        for number in range(int(BAR_MM / 10) + 1):
            # Ticks are inside the bar's ends, so that it is 100 mm from edge to edge.
            at = min(max(self.left + 10 * number - 0.1, self.left), self.left + BAR_MM - 0.2)
            self.black.append((at, top, 0.2, 4.0))
        self.lines.append((self.left + BAR_MM + 3, top + 4.0, f"this bar is {BAR_MM:g} mm long: measure it"))
        self.lines += [(self.left, top + 9.0 + 4.5 * number, text) for number, text in enumerate(texts)]


def to_svg(page: Page) -> bytes:
    """Encode the page as an SVG at true size."""
    paths = [
        f'<path fill="{colour}" d="{"".join(_svg_path(rectangles))}"/>'
        for colour, rectangles in (("#000", page.black), ("#fff", page.white))
    ]
    words = [
        f'<text x="{left:g}" y="{baseline:g}" font-size="{TEXT_MM:g}">{html.escape(text, quote=False)}</text>'
        for left, baseline, text in page.lines
    ]
    width, height = f"{page.width:g}", f"{page.height:g}"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">'
    )
    ground = f'<rect width="{width}" height="{height}" fill="#fff"/>'
    words = ['<g font-family="Helvetica, Arial, sans-serif">', *words, "</g>"]
    return "\n".join([head, ground, *paths, *words, "</svg>", ""]).encode()


def _svg_path(rectangles: list[Rectangle]) -> Iterator[str]:
    for left, top, width, height in rectangles:
        yield f"M{left:.4f} {top:.4f}h{width:.4f}v{height:.4f}h{-width:.4f}z"


def to_pdf(page: Page) -> bytes:
    """Encode the page as a PDF at true size (PDF 1.4, ISO 32000; one page, Helvetica)."""
    drawn = [f"{POINTS_PER_MM:.6f} 0 0 {-POINTS_PER_MM:.6f} 0 {page.height * POINTS_PER_MM:.4f} cm"]
    for level, rectangles in ((0, page.black), (1, page.white)):
        outlines = (f"{x:.4f} {y:.4f} {width:.4f} {height:.4f} re" for x, y, width, height in rectangles)
        drawn += [f"{level} g", *outlines, "f"]
    drawn.append("0 g")
    for left, baseline, text in page.lines:
        escaped = text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        # The page's y axis points down, the text's own points up.
        drawn.append(f"BT /F {TEXT_MM:g} Tf 1 0 0 -1 {left:.4f} {baseline:.4f} Tm ({escaped}) Tj ET")
    stream = "\n".join(drawn).encode("latin-1", "replace")
    box = f"[0 0 {page.width * POINTS_PER_MM:.4f} {page.height * POINTS_PER_MM:.4f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        f"<< /Length {len(stream)} >>\nstream\n".encode() + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    out, starts = b"%PDF-1.4\n", []
    for number, content in enumerate(objects, 1):
        starts.append(len(out))
        out += f"{number} 0 obj\n".encode() + content + b"\nendobj\n"
    table = "".join(f"{start:010d} 00000 n \n" for start in starts)
    return (
        out
        + (
            f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}"
            f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{len(out)}\n%%EOF\n"
        ).encode()
    )


def board_page(board: CharucoBoard, paper: str = "a4") -> Page:
    """Draw a board in the centre of a page. Raises BadInputError if it does not fit."""
    square, marker = 1000 * board.square_m, 1000 * board.marker_m
    page = Page(paper, (board.across * square, board.down * square), "a board", smaller="smaller --square-mm")
    words = board.words_of_markers()
    modules = words.markerSize + 2
    cell = marker / modules
    made = board.to_opencv()
    corners = np.asarray(made.getObjPoints(), np.float64)[:, 0, :2] * 1000
    marked = {tuple((corner / square).astype(int).tolist()) for corner in corners}
    for row, column in product(range(board.down), range(board.across)):
        if (column, row) not in marked:
            page.black.append((page.left + column * square, page.top + row * square, square, square))
    for number, corner in zip(np.ravel(made.getIds()).tolist(), corners, strict=True):
        x, y = page.left + float(corner[0]), page.top + float(corner[1])
        page.black.append((x, y, marker, marker))
        bits = cv2.aruco.generateImageMarker(words, number, modules, borderBits=1)
        for row, column in np.argwhere(np.asarray(bits) > 0).tolist():
            page.white.append((x + column * cell, y + row * cell, cell, cell))
    sizes = f"squares {square:g} mm, markers {marker:g} mm"
    calibrate = " ".join(["reconstruct calibrate SESSION --from charuco", *calibrate_options(board)])
    page.add_foot(
        f"simulshot ChArUco board {board.shape}, {sizes}, dictionary {board.dictionary}",
        f"Print at 100 % (not 'fit to page') and fix it to something flat. {calibrate}",
    )
    return page


def calibrate_options(board: CharucoBoard) -> list[str]:
    """Return the command-line options for this board, none for the default one."""
    options = [
        f"--board {board.shape}",
        f"--square-mm {1000 * board.square_m:g}",
        f"--marker-mm {1000 * board.marker_m:g}",
        f"--dictionary {board.dictionary}",
    ]
    return [] if board == DEFAULT_BOARD else options
