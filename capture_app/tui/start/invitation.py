"""How another machine joins: the line to type there, and the same as a QR code."""

import segno
from textual.content import Content

DEVICE = "v4l2:/dev/video0"
QUIET = 2
"""Modules of light around the code; readers of screens do with two."""
_HALF = {(True, True): "█", (True, False): "▀", (False, True): "▄", (False, False): " "}


def joining_line(leader: str) -> str:
    """The command for the machine of a camera."""
    return f"capture-app node --leader {leader} --camera {DEVICE}"


def qr_lines(text: str) -> list[Content]:
    """A QR code in half blocks, light on dark: what is drawn are its light modules."""
    code = segno.make(text, error="l", boost_error=False, micro=False)
    light = [[not module for module in row] for row in code.matrix_iter(border=QUIET)]
    if len(light) % 2:
        light.append([False] * len(light[0]))
    return [
        Content.styled("".join(_HALF[pair] for pair in zip(upper, lower, strict=True)), "#ffffff on #000000")
        for upper, lower in zip(light[::2], light[1::2], strict=True)
    ]
