"""Parts of lines that several lists draw: two ends, the mark of what is chosen, a bar."""

from rich.segment import Segment
from textual.content import Content
from textual.strip import Strip
from textual.widget import Widget


def strip_of_line(widget: Widget, line: Content) -> Strip:
    """A styled line as a widget sends it to the terminal."""
    parse = widget.app.stylesheet.parse_style
    return Strip(
        Segment(text, style.rich_style)
        for text, style in line.render(
            widget.visual_style, end="", parse_style=lambda style: parse(str(style))
        )
    )


def justified(left: Content, right: Content, width: int) -> Content:
    """A line of that width with `left` at its beginning, cut where it must be, and `right` at its end."""
    room = width - right.cell_length - (1 if right.cell_length else 0)
    left = left.truncate(max(0, room), ellipsis=True)
    return Content.assemble(left, " " * max(0, width - left.cell_length - right.cell_length), right)


def chosen_line(line: Content, width: int) -> Content:
    """A line of what is under the cursor: its first cell is the mark, and all of the width has its colour."""
    line = Content.assemble(("▌", "$primary"), line[1:])
    return line.pad_right(max(width - line.cell_length, 0)).stylize_before("on $block-cursor-background")


def filled_cells(share: float, width: int) -> str:
    """So large a share of that many cells, to an eighth of one."""
    eighths = round(8 * width * min(max(share, 0.0), 1.0))
    return "█" * (eighths // 8) + ("▏▎▍▌▋▊▉"[eighths % 8 - 1] if eighths % 8 else "")
