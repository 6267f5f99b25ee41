"""What became of the last takes: transfer by camera, spread with its error bar, and the verdict."""

from collections.abc import Sequence

from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.content import Content
from textual.widgets import Static

from capture_app.node.wire.status import CameraTransfer
from capture_app.session.reading.verdict import GRADE_LIMITS
from capture_app.text import printable
from capture_app.tui.shoot.status_line import progress_words
from capture_app.tui.shoot.take import Take
from capture_app.tui.states import GRADES

EARLIER = 8
BAR = 10
WIDE = 34
"""From so many columns on there is room for what the times mean."""


class TakePanel(VerticalScroll, can_focus=False):
    """The newest take in full, a line for each of those before it."""

    DEFAULT_CSS = """
    TakePanel { height: 1fr; border: round $border; padding: 0 1; scrollbar-size: 1 1; }
    TakePanel > Static { width: 1fr; height: auto; }
    """

    def __init__(self) -> None:
        super().__init__(id="takes")
        self.border_title = "Takes"
        self._text = Static(id="takes-text")
        self._shown: Content | None = None

    def compose(self) -> ComposeResult:
        """All of it is one text, which wraps."""
        yield self._text

    @property
    def plain(self) -> str:
        """What it says."""
        return "" if self._shown is None else self._shown.plain

    def show(self, takes: Sequence[Take], now_s: float = 0.0) -> None:
        """Show these, the newest last."""
        lines = [Content.styled("No take yet: press Space.", "$foreground-muted")]
        if takes:
            lines = [*_in_full(takes[-1], now_s, wide=self.size.width >= WIDE)]
            if len(takes) > 1:
                lines += [Content(""), *(_in_short(take, now_s) for take in takes[-2 : -2 - EARLIER : -1])]
        text = Content("\n").join(lines)
        if self._shown is None or text.markup != self._shown.markup:
            self._shown = text
            self._text.update(text)


def verdict_line(take: Take) -> Content:
    """The verdict of a judged take in one line."""
    assert take.judged is not None
    verdict = take.judged.verdict
    sign = GRADES[verdict.grade]
    return Content.assemble(
        (f"{sign.glyph} ", sign.style),
        (verdict.spread, "bold"),
        (" · ", "$foreground-muted"),
        (verdict.headline, sign.style),
    )


def transfer_line(transfer: CameraTransfer, width: int = BAR) -> Content:
    """How much a camera has brought: name, bar, numbers, and why no more will come."""
    done = transfer.received >= transfer.expected
    filled = width if done else width * transfer.received // max(1, transfer.expected)
    style = "$success" if done else "$error" if transfer.problem else "$primary"
    sign = " ✔" if done else " ✖" if transfer.problem else ""
    return Content.assemble(
        (f"{printable(transfer.camera):<8.12} ", "$foreground"),
        ("█" * filled, style),
        ("░" * (width - filled), "$foreground-muted"),
        f" {transfer.received}/{transfer.expected}{sign}",
        (f" {printable(transfer.problem)}" if transfer.problem else "", "$error"),
    )


def _in_full(take: Take, now_s: float, *, wide: bool) -> list[Content]:
    status = take.status
    lines = [Content.styled(printable(take.name) or "the take", "bold")]
    if take.retake_of:
        lines.append(Content.styled(f"retake of {printable(take.retake_of)}", "$foreground-muted"))
    if take.trashed:
        return [*lines, Content.styled("in the trash", "$foreground-muted")]
    if take.judged is not None:
        verdict = take.judged.verdict
        sign = GRADES[verdict.grade]
        lines.append(Content.styled(f"{sign.glyph} {verdict.headline}", sign.style))
        lines.append(Content.assemble(("spread ", "$foreground-muted"), (verdict.spread, "bold")))
        if verdict.stamps:
            lines.append(Content.styled(printable(verdict.stamps), "$warning"))
        if wide:
            lines.append(Content.styled(verdict.sentence, "$foreground-muted"))
            lines.append(Content.styled(GRADE_LIMITS, "$foreground-muted"))
    elif take.problem:
        lines.append(Content.styled(f"✖ {printable(take.problem)}", "$error"))
    elif not status.done:
        lines.append(Content.styled(f"◔ {progress_words(status, now_s - take.begun_s)}", "$primary"))
    elif status.session is not None:
        lines.append(Content.styled("✔ saved where the leader runs:", "$success"))
        lines.append(Content(printable(status.session)))
        lines.append(Content(f"{status.received} of {status.expected} images"))
    else:
        lines.append(Content.styled("✖ no session", "$error"))
    if status.message and take.judged is None and (status.done or status.received):
        lines.append(Content.styled(printable(status.message), "$warning"))
    whole = status.done and all(one.received >= one.expected for one in status.transfer)
    begun = status.done or any(one.received or one.problem for one in status.transfer)
    if begun and not (whole and take.judged is not None):
        lines += [Content(""), *(transfer_line(one) for one in status.transfer)]
    return lines


def _in_short(take: Take, now_s: float) -> Content:
    name = f"{printable(take.name):<10} "
    if take.trashed:
        return Content.assemble((name, "$foreground-muted strike"), ("in the trash", "$foreground-muted"))
    if take.judged is None:
        status = take.status
        state = progress_words(status, now_s - take.begun_s)
        if status.done:
            state = "saved" if status.session else "no session"
        return Content.assemble(name, (state, "$foreground-muted"))
    verdict = take.judged.verdict
    sign = GRADES[verdict.grade]
    return Content.assemble(name, (f"{sign} ", sign.style), verdict.spread)
