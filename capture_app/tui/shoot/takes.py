"""Takes known to the screen, including those ordered elsewhere, and the pane that shows them."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

from textual.containers import VerticalScroll
from textual.content import Content

from capture_app.common.text import printable
from capture_app.protocol.status import BurstStatus, CameraTransfer
from capture_app.rig.taking import TakePlan, local_session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import Verdict
from capture_app.tui.signs import GRADES
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture, Source

RATE_AFTER_S = 3.0
"""Seconds of saving after which the rest is estimated."""
SAID_AFTER_S = 2
"""Seconds after which the progress text shows the elapsed time."""
EARLIER = 8
BAR = 10
WIDTH = 36
"""Columns of the pane before it is laid out."""


@dataclass(slots=True)
class Take:
    """One take: its status, its plan if it was ordered here, and its verdict."""

    status: BurstStatus
    plan: TakePlan | None = None
    sheet: TakeSheet | None = None
    """Images and verdict of the take, if it is on this machine's disk."""
    problem: str = ""
    """Reason why the take could not be judged."""
    trashed: bool = False
    is_new: bool = True
    """Whether it was taken while the screen was open."""
    begun_s: float = 0.0
    """Time at which the screen first received its status."""
    ended_s: float | None = None
    """Time at which the end of this recording was ordered here or reported by the leader."""
    has_ended_alone: bool = False
    """Whether this recording ended otherwise than planned here, and Space has not said so yet."""
    saved_at: tuple[float, int] | None = None
    """Time at which frames were first saved after that end, and how many then were."""
    retake_of: str = ""
    """Name of the take that this one repeats."""

    @property
    def name(self) -> str:
        """Name of its session, which may have been renamed since it was taken."""
        return self.status.name if self.sheet is None else self.sheet.session.name

    @property
    def planned_s(self) -> float | None:
        """Length of this recording as ordered here; None if it lasts until it is stopped."""
        return self.plan.seconds if self.plan is not None and self.status.recording else None

    @property
    def is_recording(self) -> bool:
        """Whether this recording is under way: no end was ordered or reported."""
        return self.status.recording and not self.status.done and self.ended_s is None

    def length_s(self, now_s: float) -> float:
        """Return the length of this recording until now, at most until its end."""
        length_s = (now_s if self.ended_s is None else self.ended_s) - self.begun_s
        return length_s if self.planned_s is None else min(length_s, self.planned_s)

    def note_saved(self, now_s: float) -> None:
        """Note from when on the saving of this recording, which has ended, can be measured."""
        if self.ended_s is not None and self.status.received and self.saved_at is None:
            self.saved_at = now_s, self.status.received

    def left_s(self, now_s: float) -> float | None:
        """Return for how long frames will still be saved at the rate so far; None if that is unknown."""
        since_s, before = self.saved_at or (now_s, 0)
        saved = self.status.received - before
        if saved <= 0 or now_s - since_s < RATE_AFTER_S:
            return None
        return (self.status.expected - self.status.received) * (now_s - since_s) / saved


def open_take(status: BurstStatus) -> TakeSheet | None:
    """Open the session of a finished take; None if it is on another machine. Blocks on the disk.

    Raises BadInputError or IncompleteError if the session cannot be read.
    """
    session = local_session(status)
    return None if session is None else TakeSheet(session)


def progress_words(take: Take, now_s: float, takes: Sequence[Take] = ()) -> str:
    """Return the progress of a take that is not done, in words; it may wait for another one of `takes`."""
    status, seconds = take.status, take.length_s(now_s)
    # Cameras send one take after the other.
    before = [
        of.name
        for of in takewhile(lambda each: each is not take, takes)
        if of.status.recording and not of.status.done
    ]
    if before and not status.received and (take.ended_s is not None or not status.recording):
        what = f"recorded {_minutes(seconds)}" if status.recording else f"taken {seconds:.0f} s ago"
        return f"{what}; waits until {printable(before[-1])} is saved"
    if status.recording and not status.done:
        length = _minutes(seconds)
        if take.ended_s is not None:
            left_s = take.left_s(now_s)
            left = "" if left_s is None else f", some {left_s:.0f} s left"
            return f"recorded {length}; {status.received} of {status.expected} frames saved{left}"
        of = "" if take.planned_s is None else f" of {_minutes(take.planned_s)}"
        return f"recording {length}{of}: {status.received} of {status.expected} frames saved"
    after = f", {seconds:.0f} s" if seconds >= SAID_AFTER_S else ""
    if status.received:
        return f"{status.received} of {status.expected} images{after}"
    if status.message or not status.expected:
        return f"{printable(status.message) or 'ordered'}{after}"
    return f"taken; cameras are saving{after}"


def _minutes(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02}"


class TakePanel(VerticalScroll, can_focus=False):
    """Pane with the newest take in full and one line for each earlier take."""

    def __init__(self) -> None:
        self._newest, self._earlier = Lines(id="takes-newest"), Lines(id="takes-earlier")
        self.plain = ""
        """Text shown."""
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
        """Show these takes, newest last, with lines about the newest one's depth and its depth image."""
        self._picture.display = picture is not None
        self._picture.show(picture)
        self._earlier.display = len(takes) > 1
        width = self.scrollable_content_region.width or WIDTH
        newest = Content("\n").join(_lines(takes, now_s, depth, width))
        earlier = Content("\n").join(_in_short(take, now_s) for take in takes[-2 : -2 - EARLIER : -1])
        self.plain = f"{newest.plain}\n\n{earlier.plain}".rstrip()
        self._newest.show(newest.wrap(width))
        self._earlier.show(earlier.wrap(width))


def verdict_line(verdict: Verdict) -> Content:
    """Return a take's verdict in one line."""
    sign = GRADES[verdict.grade]
    return Content.assemble(
        (f"{sign.glyph} ", sign.style),
        (verdict.spread, "bold"),
        (" · ", "$foreground-muted"),
        (printable(verdict.headline), sign.style),
    )


def transfer_line(transfer: CameraTransfer, columns: int) -> Content:
    """Return a camera's transfer progress: name, bar, numbers, and the reason if it failed.

    The bar is as long as `columns` leave, at most `BAR`.
    """
    done = transfer.received >= transfer.expected
    sign = " ✔" if done else " ✖" if transfer.problem else ""
    short = Content(printable(transfer.label or transfer.camera)).truncate(12)
    name = short.pad_right(max(0, 8 - short.cell_length) + 1)
    numbers = f" {transfer.received}/{transfer.expected}{sign}"
    bar = max(1, min(BAR, columns - name.cell_length - len(numbers)))
    filled = bar if done else bar * transfer.received // max(1, transfer.expected)
    style = "$success" if done else "$error" if transfer.problem else "$primary"
    return Content.assemble(
        name.stylize("$foreground"),
        ("█" * filled, style),
        ("░" * (bar - filled), "$foreground-muted"),
        numbers,
        (f" {printable(transfer.problem)}" if transfer.problem else "", "$error"),
    )


def _lines(takes: Sequence[Take], now_s: float, depth: Iterable[Content], columns: int) -> Iterator[Content]:
    if not takes:
        yield Content.styled("No take yet: press Space.", "$foreground-muted")
        return
    yield Content.styled(printable(takes[-1].name) or "the take", "bold")
    if takes[-1].retake_of:
        yield Content.styled(f"retake of {printable(takes[-1].retake_of)}", "$foreground-muted")
    if takes[-1].trashed:
        yield Content.styled("in the trash", "$foreground-muted")
    else:
        yield from _in_full(takes[-1], now_s, takes, columns)
        yield from depth


def _in_full(take: Take, now_s: float, takes: Sequence[Take], columns: int) -> Iterator[Content]:
    status = take.status
    if take.sheet is not None and status.done:
        yield _short_verdict(take.sheet.verdict)
        if take.sheet.verdict.stamps:
            yield Content.styled("! timestamps not measured", "$warning")
    elif take.problem:
        yield Content.styled(f"✖ {printable(take.problem)}", "$error")
    elif not status.done:
        yield Content.styled(f"◔ {progress_words(take, now_s, takes)}", "$primary")
    elif status.session is not None:
        yield Content.styled("✔ saved on the leader's machine:", "$success")
        yield Content(printable(status.session))
        yield Content(f"{status.received} of {status.expected} images")
    else:
        yield Content.styled("✖ no session", "$error")
    if status.message and (not status.done or take.sheet is None) and (status.done or status.received):
        yield Content.styled(printable(status.message), "$warning")
    whole = status.done and all(one.received >= one.expected for one in status.transfer)
    begun = status.done or any(one.received or one.problem for one in status.transfer)
    if begun and not (whole and take.sheet is not None):
        yield Content("")
        yield from (transfer_line(one, columns) for one in status.transfer)


def _in_short(take: Take, now_s: float) -> Content:
    name = f"{printable(take.name):<10} "
    if take.trashed:
        return Content.assemble((name, "$foreground-muted strike"), ("in the trash", "$foreground-muted"))
    if take.sheet is None or not take.status.done:
        saved = "saved" if take.status.session else "no session"
        state = saved if take.status.done else progress_words(take, now_s)
        return Content.assemble(name, (state, "$foreground-muted"))
    return Content.assemble(name, _short_verdict(take.sheet.verdict))


def _short_verdict(verdict: Verdict) -> Content:
    sign = GRADES[verdict.grade]
    return Content.assemble((f"{sign} ", sign.style), verdict.spread)
