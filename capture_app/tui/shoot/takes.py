"""The takes that the screen has heard of, whoever ordered them, and what became of each."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from textual.containers import VerticalScroll
from textual.content import Content
from textual.widgets import Static

from capture_app.common.text import printable
from capture_app.protocol.status import BurstStatus, CameraTransfer
from capture_app.rig.taking import TakePlan, local_session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import GRADE_LIMITS, Verdict
from capture_app.tui.signs import GRADES
from capture_app.tui.widgets.picture import Picture, Source

SAID_AFTER_S = 2
"""A take without news for so long says for how long."""
EARLIER = 8
BAR = 10
WIDE = 34
"""From so many columns on there is room for what the times mean."""


@dataclass(slots=True)
class Take:
    """One take: what was asked for, where it was asked from here, how far it is, and what it is worth."""

    status: BurstStatus
    plan: TakePlan | None = None
    sheet: TakeSheet | None = None
    """The take's pictures and verdict, where it is on this machine's disk."""
    problem: str = ""
    """Why it could not be judged."""
    trashed: bool = False
    is_new: bool = True
    """The take was made while the screen was open."""
    begun_s: float = 0.0
    """When the screen heard of it first."""
    retake_of: str = ""
    """The take that it was taken again for."""

    @property
    def name(self) -> str:
        """The name of its session."""
        return self.status.name


def open_take(status: BurstStatus) -> TakeSheet | None:
    """Open the session of a take that is over; None where it is not on this machine. Blocks on the disk.

    Raises BadInputError or IncompleteError where the session cannot be read.
    """
    session = local_session(status)
    return None if session is None else TakeSheet(session)


def progress_words(status: BurstStatus, seconds: float) -> str:
    """How far a burst is that was ordered so many seconds ago."""
    if status.recording and not status.done:
        lacking = f", {status.expected - status.received} on their way" if status.expected else ""
        return f"recording: {status.received} frames{lacking}; Space ends it"
    after = f", {seconds:.0f} s" if seconds >= SAID_AFTER_S else ""
    if status.received:
        return f"{status.received} of {status.expected} images"
    if status.message or not status.expected:
        return f"{printable(status.message) or 'ordered'}{after}"
    return f"taken; cameras are saving{after}"


class TakePanel(VerticalScroll, can_focus=False):
    """The newest take in full, a line for each of those before it."""

    def __init__(self) -> None:
        self._newest, self._earlier = Static(id="takes-newest"), Static(id="takes-earlier")
        self.plain = ""
        """What it says."""
        self._picture = Picture(id="takes-depth")
        self._picture.display = self._earlier.display = False
        super().__init__(self._newest, self._picture, self._earlier, id="takes")
        self.border_title = "Takes"

    def show(
        self,
        takes: Sequence[Take],
        now_s: float = 0.0,
        depth: Iterable[Content] = (),
        picture: Source | None = None,
    ) -> None:
        """Show these, the newest last, with lines about its depth and a picture of it."""
        self._picture.display = picture is not None
        self._picture.show(picture)
        self._earlier.display = len(takes) > 1
        newest = Content("\n").join(_lines(takes, now_s, depth, wide=self.size.width >= WIDE))
        earlier = Content("\n").join(_in_short(take, now_s) for take in takes[-2 : -2 - EARLIER : -1])
        self.plain = f"{newest.plain}\n\n{earlier.plain}".rstrip()
        for part, text in ((self._newest, newest), (self._earlier, earlier)):
            shown = part.content
            if not isinstance(shown, Content) or not shown.is_same(text):
                part.update(text)


def verdict_line(verdict: Verdict) -> Content:
    """A take's verdict in one line."""
    sign = GRADES[verdict.grade]
    return Content.assemble(
        (f"{sign.glyph} ", sign.style),
        (verdict.spread, "bold"),
        (" · ", "$foreground-muted"),
        (verdict.headline, sign.style),
    )


def transfer_line(transfer: CameraTransfer) -> Content:
    """How much a camera has brought: name, bar, numbers, and why no more will come."""
    done = transfer.received >= transfer.expected
    filled = BAR if done else BAR * transfer.received // max(1, transfer.expected)
    style = "$success" if done else "$error" if transfer.problem else "$primary"
    sign = " ✔" if done else " ✖" if transfer.problem else ""
    return Content.assemble(
        (f"{printable(transfer.camera):<8.12} ", "$foreground"),
        ("█" * filled, style),
        ("░" * (BAR - filled), "$foreground-muted"),
        f" {transfer.received}/{transfer.expected}{sign}",
        (f" {printable(transfer.problem)}" if transfer.problem else "", "$error"),
    )


def _lines(takes: Sequence[Take], now_s: float, depth: Iterable[Content], *, wide: bool) -> Iterator[Content]:
    if not takes:
        yield Content.styled("No take yet: press Space.", "$foreground-muted")
        return
    yield Content.styled(printable(takes[-1].name) or "the take", "bold")
    if takes[-1].retake_of:
        yield Content.styled(f"retake of {printable(takes[-1].retake_of)}", "$foreground-muted")
    if takes[-1].trashed:
        yield Content.styled("in the trash", "$foreground-muted")
    else:
        yield from _in_full(takes[-1], now_s, wide=wide)
        yield from depth


def _verdict_lines(verdict: Verdict, *, wide: bool) -> Iterator[Content]:
    sign = GRADES[verdict.grade]
    yield Content.styled(f"{sign.glyph} {verdict.headline}", sign.style)
    yield Content.assemble(("spread ", "$foreground-muted"), (verdict.spread, "bold"))
    if verdict.stamps:
        yield Content.styled(printable(verdict.stamps), "$warning")
    if wide:
        yield from (Content.styled(text, "$foreground-muted") for text in (verdict.sentence, GRADE_LIMITS))


def _in_full(take: Take, now_s: float, *, wide: bool) -> Iterator[Content]:
    status = take.status
    if take.sheet is not None:
        yield from _verdict_lines(take.sheet.verdict, wide=wide)
    elif take.problem:
        yield Content.styled(f"✖ {printable(take.problem)}", "$error")
    elif not status.done:
        yield Content.styled(f"◔ {progress_words(status, now_s - take.begun_s)}", "$primary")
    elif status.session is not None:
        yield Content.styled("✔ saved where the leader runs:", "$success")
        yield Content(printable(status.session))
        yield Content(f"{status.received} of {status.expected} images")
    else:
        yield Content.styled("✖ no session", "$error")
    if status.message and take.sheet is None and (status.done or status.received):
        yield Content.styled(printable(status.message), "$warning")
    whole = status.done and all(one.received >= one.expected for one in status.transfer)
    begun = status.done or any(one.received or one.problem for one in status.transfer)
    if begun and not (whole and take.sheet is not None):
        yield Content("")
        yield from map(transfer_line, status.transfer)


def _in_short(take: Take, now_s: float) -> Content:
    name = f"{printable(take.name):<10} "
    if take.trashed:
        return Content.assemble((name, "$foreground-muted strike"), ("in the trash", "$foreground-muted"))
    if take.sheet is None:
        status = take.status
        state = progress_words(status, now_s - take.begun_s)
        if status.done:
            state = "saved" if status.session else "no session"
        return Content.assemble(name, (state, "$foreground-muted"))
    sign = GRADES[take.sheet.verdict.grade]
    return Content.assemble(name, (f"{sign} ", sign.style), take.sheet.verdict.spread)
