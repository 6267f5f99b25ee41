"""Draws a Textual screenshot (SVG) as pixels, cell by cell, so that blocks meet without seams."""

import html
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

CELL = 9, 18
"""Width and height of a cell, in pixels."""
SVG_CELL = 12.2, 24.4
FONTS = Path(mpl.get_data_path()) / "fonts" / "ttf"
BLOCKS: dict[str, tuple[tuple[float, float, float, float], ...]] = {
    "█": ((0, 0, 1, 1),),
    "▀": ((0, 0, 1, 0.5),),
    "▄": ((0, 0.5, 1, 1),),
    "▌": ((0, 0, 0.5, 1),),
    "▐": ((0.5, 0, 1, 1),),
    "▘": ((0, 0, 0.5, 0.5),),
    "▚": ((0, 0, 0.5, 0.5), (0.5, 0.5, 1, 1)),
    "▛": ((0, 0, 1, 0.5), (0, 0.5, 0.5, 1)),
    "▜": ((0, 0, 1, 0.5), (0.5, 0.5, 1, 1)),
    "▙": ((0, 0, 0.5, 1), (0.5, 0.5, 1, 1)),
} | {character: ((0, 1 - (n + 1) / 8, 1, 1),) for n, character in enumerate("▁▂▃▄▅▆▇")}
"""Parts of a cell, from the left upper corner: x, y, x, y."""
_STYLE = re.compile(r"\.(terminal-\d+-r\d+|[\w-]+-r\d+) \{([^}]*)\}")
_RECT = re.compile(r'<rect fill="(#\w+)" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"')
_TEXT = re.compile(r'<text class="([\w-]+)" x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]*)</text>')


def draw_screen(svg: str, columns: int, rows: int, ground: str = "#16171f") -> NDArray[np.uint8]:
    """The screen as height x width x RGB."""
    width, height = CELL
    image = Image.new("RGB", (columns * width, rows * height), ground)
    draw = ImageDraw.Draw(image)
    fonts = {
        bold: ImageFont.truetype(str(FONTS / f"DejaVuSansMono{'-Bold' if bold else ''}.ttf"), 14)
        for bold in (False, True)
    }
    styles = dict(_STYLE.findall(svg))
    body = svg[svg.index("-matrix") :]
    for fill, x, y, w, h in _RECT.findall(body):
        left, top = round(float(x) / SVG_CELL[0]), round((float(y) - 1.5) / SVG_CELL[1])
        right = left + round(float(w) / SVG_CELL[0])
        bottom = top + max(round(float(h) / SVG_CELL[1]), 1)
        if right <= left:
            continue
        draw.rectangle((left * width, top * height, right * width - 1, bottom * height - 1), fill=fill)
    for name, x, y, text in _TEXT.findall(body):
        style = styles.get(name, "")
        colour = re.search(r"fill: (#\w+)", style)
        font = fonts["bold" in style]
        column, row = round(float(x) / SVG_CELL[0]), round((float(y) - 20) / SVG_CELL[1])
        for at, character in enumerate(html.unescape(text).replace("\xa0", " "), column):
            place = at * width, row * height
            if character in BLOCKS:
                for a, b, c, d in BLOCKS[character]:
                    box = (
                        place[0] + a * width,
                        place[1] + b * height,
                        place[0] + c * width,
                        place[1] + d * height,
                    )
                    x0, y0, x1, y1 = (round(value) for value in box)
                    draw.rectangle((x0, y0, x1 - 1, y1 - 1), fill=colour[1] if colour else "#fff")
            elif character != " ":
                draw.text(place, character, font=font, fill=colour[1] if colour else "#fff")
    return np.asarray(image)
