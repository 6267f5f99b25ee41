"""The list of sessions as they are on disk now, and beside it the one under the cursor."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

from textual import work
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.message import Message
from textual.timer import Timer
from textual.widgets import Input

from capture_app.errors import SimulshotError
from capture_app.session.library.listing import SessionCard, SessionListing, SessionState
from capture_app.session.library.thumbnails import ThumbnailCache
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.text import count, printable
from capture_app.tui.jobs.job import Job
from capture_app.tui.jobs.job_list import JobList
from capture_app.tui.library.session_rows import Entry, Order, SessionRows, arrange
from capture_app.tui.library.take import TakePane
from capture_app.tui.rig_record import Mishap
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.row_list import RowList

LOOK_AGAIN_S = 2.0
"""How often the folder is looked at while it is seen."""
SETTLED_S = 0.15
"""How long the cursor rests on a session before its pictures are loaded."""
WIDE = 120
"""From this width on the session under the cursor is shown beside the list."""


class SessionBrowser(Horizontal):
    """Follows a folder of sessions, one of bundled samples, and the jobs of both."""

    DEFAULT_CSS = """
    SessionBrowser #sessions-frame { width: 1fr; height: 1fr; border: round $border;
        border-title-color: $primary; border-title-style: bold; border-subtitle-color: $foreground-muted; }
    SessionBrowser #sessions-frame:focus-within { border: round $primary; }
    SessionBrowser #sessions-find { border: none; height: 1; padding: 0 1; background: $surface;
        display: none; }
    SessionBrowser #sessions-empty { padding: 1 2; display: none; }
    SessionBrowser TakePane { display: none; width: 1fr; height: 1fr; border: round $border;
        border-title-color: $primary; border-title-style: bold; }
    SessionBrowser TakePane:focus-within { border: round $primary; }
    SessionBrowser.-wide TakePane { display: block; }
    SessionBrowser.-wide #sessions-frame { max-width: 92; }
    """

    class Changed(Message):
        """Another session is under the cursor, or it is not as it was."""

    def __init__(
        self, root: Path, samples: Path | None, jobs: JobList, thumbnails: ThumbnailCache, order: Order
    ) -> None:
        super().__init__()
        self.root = root
        self.order = order
        self._jobs = jobs
        self._listing = SessionListing(root)
        self._sample_listing = None if samples is None else SessionListing(samples)
        self._rows = SessionRows(thumbnails)
        self._pane = TakePane()
        self._find = Input(placeholder="name, note, camera, date", id="sessions-find", select_on_focus=False)
        self._empty = Lines(id="sessions-empty")
        self._cards: list[SessionCard] = []
        self._samples: list[SessionCard] = []
        self._read = False
        self._wanted: Path | None = None
        self._settling: Timer | None = None

    def compose(self) -> ComposeResult:
        """The list, and beside it the session under the cursor."""
        yield Vertical(self._find, self._empty, self._rows, id="sessions-frame")
        yield self._pane

    def on_mount(self) -> None:
        """Begin to follow the folder and the jobs."""
        self._stop_watching = self._jobs.watch(self._show_job)
        self.set_interval(LOOK_AGAIN_S, self._look_again)
        self.look_at_disk()

    def on_unmount(self) -> None:
        """Follow the jobs no longer."""
        self._stop_watching()

    def on_resize(self) -> None:
        """Show the chosen session beside the list where there is room."""
        self.set_class(self.size.width >= WIDE, "-wide")
        self._settle()

    @property
    def entry(self) -> Entry | None:
        """The session under the cursor."""
        return self._rows.entry if self.is_mounted else None

    @property
    def is_finding(self) -> bool:
        """Whether only what was looked for is shown."""
        return bool(self._find.display)

    def select(self, folder: Path | None) -> None:
        """Put the cursor on a session as soon as it is listed."""
        self._wanted = folder

    def open_folder(self, folder: Path, session: str | None) -> None:
        """Show the sessions of a folder; of the samples, where it is theirs, which are listed already."""
        listings = [one for one in (self._listing, self._sample_listing) if one is not None]
        known = next((one for one in listings if one.root.absolute() == folder.absolute()), None)
        if known is None:
            self.root, self._listing = folder, SessionListing(folder)
        self.select(folder if session is None else folder / session)
        self._read = False
        self.look_at_disk()

    def sort(self, order: Order) -> None:
        """Sort otherwise, and go to the first."""
        self.order = order
        self._show()
        self._rows.action_move(-len(self._rows.keys))

    def find(self) -> None:
        """Let the user type what to look for."""
        self._find.display = True
        self._find.focus()

    def show_all(self) -> None:
        """Show all sessions again."""
        self._find.value = ""
        self._find.display = False
        self._rows.focus()
        self._show()

    def focus_list(self) -> None:
        """Let keys move the cursor."""
        self._rows.focus()

    @work(exclusive=True, group="listing")
    async def look_at_disk(self) -> None:
        """Read the folder in a thread and show what has changed."""
        cards = await asyncio.to_thread(self._listing.read)
        if self._sample_listing is not None and not self._read:
            self._samples = await asyncio.to_thread(self._sample_listing.read)
        if not self._read or cards != self._cards or self._wanted is not None:
            self._cards, self._read = cards, True
            self._show()

    async def open_sheet(self, entry: Entry) -> TakeSheet | None:
        """Open a session as a contact sheet; None, and a sentence on the screen, where that fails."""
        try:
            return await asyncio.to_thread(TakeSheet.open, entry.card.folder)
        except SimulshotError as error:
            self.post_message(Mishap(error))
            return None

    def on_row_list_chosen(self, message: RowList.Chosen) -> None:
        """Show what is under the cursor."""
        if not isinstance(message, RowList.Opened):
            self._settle()
            self.post_message(self.Changed())

    def on_input_changed(self) -> None:
        """Find as one types."""
        self._show()

    def on_input_submitted(self) -> None:
        """Back to what was found."""
        self._rows.focus()

    def _look_again(self) -> None:
        if self.screen.is_active:
            self.look_at_disk()

    def _show(self) -> None:
        words = self._find.value if self.is_finding else ""
        entries = arrange(self._cards, self._samples, self.order, words)
        jobs: dict[Path, list[Job]] = {}
        for job in self._jobs.jobs:
            jobs.setdefault(job.place, []).append(job)
        nothing_chosen = not self._rows.chosen
        self._rows.show_entries(entries, jobs)
        if nothing_chosen:
            _choose_saved(self._rows, entries)
        self._choose_wanted(entries)
        self._rows.display = bool(entries)
        self._empty.display = not entries and self._read
        where = printable(str(self.root))
        text = f"No session in {where} yet: in Shoot (key 2), space takes one."
        self._empty.show([Content(f"No session has “{printable(words)}”; esc shows all." if words else text)])
        self._show_titles(entries)
        self._settle()
        self.post_message(self.Changed())

    def _choose_wanted(self, entries: list[Entry]) -> None:
        """Put the cursor on the session that is wanted; of a folder's, the first that is saved."""
        if self._wanted is not None:
            wanted = self._wanted.absolute()
            if _choose_saved(self._rows, [e for e in entries if wanted in (Path(e.key), Path(e.key).parent)]):
                self._wanted = None

    def _show_titles(self, entries: list[Entry]) -> None:
        frame = self.query_one("#sessions-frame")
        here = sum(not entry.is_sample for entry in entries)
        samples = f" · {count(len(entries) - here, 'sample')}" if len(entries) > here else ""
        title, subtitle = f"{count(here, 'session')}{samples}", f"{self.order} · s sorts · / finds"
        if frame.border_title != title:
            frame.border_title = title
        if frame.border_subtitle != subtitle:
            frame.border_subtitle = subtitle

    def _show_job(self, job: Job) -> None:
        self._rows.show_jobs(job.place, self._jobs.of(job.session))
        if job.state.is_over:
            self.post_message(self.Changed())

    def _settle(self) -> None:
        if self._settling is not None:
            self._settling.stop()
        self._settling = self.set_timer(SETTLED_S, self._show_pane) if self.has_class("-wide") else None

    @work(exclusive=True, group="pane")
    async def _show_pane(self) -> None:
        entry = self.entry
        title = "" if entry is None else printable(entry.card.name)
        if str(self._pane.border_title or "") != title:
            self._pane.border_title = Content(title)
        if entry is None or entry.card.state is not SessionState.COMPLETE:
            self._pane.show(entry, None)
        elif entry != self._pane.entry:
            self._pane.show(entry, await self.open_sheet(entry))


def _choose_saved(rows: SessionRows, entries: Sequence[Entry]) -> bool:
    """Put the cursor on the first session that is saved, else on the first; whether there is any."""
    saved = (entry for entry in entries if entry.card.state is SessionState.COMPLETE)
    for entry in (*saved, *entries)[:1]:
        rows.choose(entry.key)
    return bool(entries)
