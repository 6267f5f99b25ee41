"""How another machine joins: the line to type there, and the same as a QR code."""

import segno
from textual.content import Content

from capture_app.errors import SimulshotError
from capture_app.text import printable
from capture_app.trust.pairing import show_code
from capture_app.tui.rig_source import RigSource

DEVICE = "v4l2:/dev/video0"
QUIET = 2
"""Modules of light around the code; readers of screens do with two."""
_HALF = {(True, True): "█", (True, False): "▀", (False, True): "▄", (False, False): " "}


NOT_INVITED = "A machine that is not known here yet asks for a number, once: press i."


async def invitation(source: RigSource) -> str:
    """Let the leader make a code for the next machine, and return what to say of it, or why there is none."""
    try:
        invited = await source.invite()
    except SimulshotError as error:
        return printable(str(error)).capitalize()
    return (
        f"A machine that is not known here yet asks for a number, once: {show_code(invited.code)}."
        f" It is for one machine and {invited.good_for_s // 60} minutes; i shows another."
    )


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
