"""The mode Sessions: the list, the session under the cursor, and what can be done with it."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, TypeVar

from platformdirs import user_cache_path
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from capture_app.errors import SimulshotError
from capture_app.session.library.changes import rename_session, set_note
from capture_app.session.library.listing import SessionState
from capture_app.session.library.thumbnails import ThumbnailCache
from capture_app.session.library.trash import restore_session, trash_session
from capture_app.text import printable
from capture_app.tui.jobs.job import COMPARE, EXPORTS, KINDS, VERIFY, Job, JobKind
from capture_app.tui.jobs.job_list import JobList
from capture_app.tui.jobs.jobs_view import show_result
from capture_app.tui.library.browser import SessionBrowser
from capture_app.tui.library.forms import export_form, job_form, name_question, note_question, typed_path
from capture_app.tui.library.session_rows import Entry, Order
from capture_app.tui.library.take import TakeScreen
from capture_app.tui.mode import ModeView
from capture_app.tui.rig_record import Mishap, ShowSessions
from capture_app.tui.settings import Settings
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.row_list import RowList

T = TypeVar("T")


class SessionsView(ModeView):
    """Shows the sessions of a folder as they are on disk now, and those that came with the program."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "look", "Look", id="sessions.look"),
        Binding("c", "compare", "Compare", id="sessions.compare", tooltip="synchronized against offset"),
        Binding("o", "results", "Results", id="sessions.results", tooltip="figures of its last job"),
        Binding("e", "export", "Export", id="sessions.export"),
        Binding("a", "analyse", "Analyse", id="sessions.analyse", tooltip="depth, panorama, many views"),
        Binding("d,delete", "trash", "Trash", id="sessions.trash"),
        Binding("r", "rename", "Rename", id="sessions.rename"),
        Binding("n", "note", "Note", id="sessions.note"),
        Binding("u", "undo", "Undo", id="sessions.undo"),
        Binding("s", "sort", "Sort", id="sessions.sort"),
        Binding("slash", "filter", "Find", id="sessions.filter", key_display="/"),
        Binding("v", "verify", "Verify", id="sessions.verify", tooltip="whether all files are whole"),
        Binding("escape", "show_all", "Show all", id="sessions.show-all", key_display="esc"),
    ]

    def __init__(
        self,
        root: Path,
        jobs: JobList,
        *,
        samples: Path | None = None,
        thumbnails: ThumbnailCache | None = None,
        settings: Settings | None = None,
    ) -> None:
        """`samples`: a folder of sessions that are shown too, and left as they are."""
        super().__init__()
        self._jobs = jobs
        self._settings = settings or Settings()
        cache = ThumbnailCache(user_cache_path("simulshot", appauthor=False) / "thumbnails")
        order = self._settings.recall("sessions.order", Order.NEWEST.value)
        self._browser = SessionBrowser(
            root,
            samples,
            jobs,
            thumbnails or cache,
            Order(order) if order in list(Order) else Order.NEWEST,
        )

    def compose(self) -> ComposeResult:
        """The list, and beside it the session under the cursor."""
        yield self._browser

    def on_mode_shown(self) -> None:
        """Look at the folder at once."""
        super().on_mode_shown()
        self._browser.look_at_disk()

    def focus_first(self) -> None:
        """The list is what is driven here."""
        self._browser.focus_list()

    @property
    def entry(self) -> Entry | None:
        """The session under the cursor."""
        return self._browser.entry if self.is_mounted else None

    def select(self, folder: Path) -> None:
        """Put the cursor on a session, as soon as it is listed."""
        self._browser.select(folder)
        self._browser.look_at_disk()

    def on_show_sessions(self, message: ShowSessions) -> None:
        """Show a folder of sessions, or one session in it; the cursor goes to the newest otherwise."""
        self._browser.open_folder(message.folder, message.session)

    def on_session_browser_changed(self) -> None:
        """Offer what can be done now."""
        self.refresh_bindings()

    def on_row_list_opened(self, message: RowList.Opened) -> None:
        """Look at it."""
        message.stop()
        self.action_look()

    # Looking

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only what can be done with the session under the cursor."""
        entry = self.entry
        if action == "show_all":
            return self._browser.is_finding
        if action in ("undo", "sort", "filter"):
            return True
        if entry is None:
            return action not in _OF_ONE
        whole = entry.card.state is SessionState.COMPLETE
        has_result = self._latest_result(entry) is not None
        if entry.card.state is SessionState.WRITING:
            # Soon it can be done: the key says so, where a key that is gone says nothing.
            return has_result if action == "results" else True
        return {
            "look": whole,
            "compare": whole and len(entry.card.cameras) > 1,
            "results": has_result,
            "export": whole,
            "verify": whole,
            "rename": whole and not entry.is_sample,
            "note": whole and not entry.is_sample,
            "trash": not entry.is_sample,
        }.get(action, True)

    def _saved_entry(self) -> Entry | None:
        """The session under the cursor; None, and a sentence on the screen, while it is being saved."""
        entry = self.entry
        if entry is not None and entry.card.state is SessionState.WRITING:
            self.app.notify(f"{printable(entry.card.name)} is being saved: press it after that", markup=False)
            return None
        return entry

    @work
    async def action_look(self) -> None:
        """Show the session on the whole screen."""
        entry = self._saved_entry()
        if entry is not None and entry.card.state is SessionState.COMPLETE:
            sheet = await self._browser.open_sheet(entry)
            if sheet is not None:
                self.app.push_screen(TakeScreen(entry, sheet))

    @work
    async def on_contact_sheet_chosen(self, message: ContactSheet.Chosen) -> None:
        """Look at a picture of the sheet beside the list."""
        if self.entry is not None:
            screen = TakeScreen(self.entry, message.sheet)
            await self.app.push_screen(screen)
            screen.on_contact_sheet_chosen(message)

    @work
    async def action_results(self) -> None:
        """Show what was found last about the session."""
        entry = self.entry
        job = None if entry is None else self._latest_result(entry)
        if job is not None:
            await show_result(self, job)

    def _latest_result(self, entry: Entry) -> Job | None:
        return next((job for job in self._jobs.of(entry.card.folder) if job.result is not None), None)

    # Sorting and finding

    def action_sort(self) -> None:
        """Sort by the next thing."""
        self._browser.sort(self._browser.order.following)
        self._settings.remember("sessions.order", self._browser.order.value)

    def action_filter(self) -> None:
        """Type what to look for."""
        self._browser.find()
        self.refresh_bindings()

    def action_show_all(self) -> None:
        """Show all sessions again."""
        self._browser.show_all()

    # Jobs

    def action_compare(self) -> None:
        """Compare with quick settings."""
        self._start(COMPARE)

    def action_verify(self) -> None:
        """Check every file of it."""
        self._start(VERIFY)

    @work
    async def action_analyse(self) -> None:
        """Choose what is to be made of it, and how."""
        entry = self._saved_entry()
        if entry is not None:
            chosen = await self.app.push_screen_wait(job_form(entry.card, self._jobs))
            if chosen is not None:
                self._start(KINDS[chosen.value], entry, chosen.text)

    @work
    async def action_export(self) -> None:
        """Choose a format and a folder, and export."""
        entry = self._saved_entry()
        if entry is None:
            return
        folder = Path(self._settings.recall("sessions.export-folder", str(self._browser.root.parent)))
        name = self._settings.recall("sessions.export-format", "colmap")
        chosen = await self.app.push_screen_wait(export_form(entry.card, folder, name))
        if chosen is not None:
            out = typed_path(chosen.text)
            self._settings.remember("sessions.export-folder", str(out.parent))
            self._settings.remember("sessions.export-format", chosen.value)
            self._start(EXPORTS[chosen.value], entry, "", out)

    def _start(
        self, kind: JobKind, entry: Entry | None = None, options: str | None = None, out: Path | None = None
    ) -> None:
        entry = entry or self._saved_entry()
        if entry is None:
            return
        try:
            self._jobs.add(kind, entry.card.folder, options, out)
        except SimulshotError as error:
            self.post_message(Mishap(error))
            return
        self.app.notify(
            f"{kind.title} of {printable(entry.card.name)} has begun: key 4 shows how far it is; "
            "it ends when the screen is closed",
            markup=False,
        )

    # Changing

    @work
    async def action_rename(self) -> None:
        """Ask for another name."""
        entry = self._saved_entry()
        name = None if entry is None else await self.app.push_screen_wait(name_question(entry.card))
        if entry is not None and name:
            self._browser.select(entry.card.folder.with_name(name))
            renamed = await self._do(lambda: rename_session(entry.card.folder, name))
            if renamed is not None:
                await self._jobs.follow_rename(entry.card.folder, self._browser.root / renamed.name)

    @work
    async def action_note(self) -> None:
        """Ask for a note."""
        entry = self._saved_entry()
        note = None if entry is None else await self.app.push_screen_wait(note_question(entry.card))
        if entry is not None and note is not None:
            await self._do(lambda: set_note(entry.card.folder, note))

    @work
    async def action_trash(self) -> None:
        """Move it to the trash at once: undo brings it back."""
        entry = self._saved_entry()
        if entry is None:
            return
        if any(not job.state.is_over for job in self._jobs.of(entry.card.folder)):
            self.post_message(Mishap(SimulshotError("a job works on it", hint="cancel it first: key 4")))
            return
        if await self._do(lambda: trash_session(entry.card.folder)) is not None:
            self._jobs.drop(entry.card.folder)
            self.app.notify(f"{printable(entry.card.name)} is in the trash: u brings it back", markup=False)

    @work
    async def action_undo(self) -> None:
        """Bring back what was moved to the trash last."""
        folder = await self._do(lambda: restore_session(self._browser.root))
        if folder is not None:
            self.select(folder)
            await self._jobs.find_earlier()

    async def _do(self, change: Callable[[], T]) -> T | None:
        """Change something on disk in a thread, and show what is there then; None where that failed."""
        done = None
        try:
            done = await asyncio.to_thread(change)
        except SimulshotError as error:
            self._browser.select(None)
            self.post_message(Mishap(error))
        self._browser.look_at_disk()
        return done


_OF_ONE = ("look", "compare", "results", "export", "verify", "analyse", "rename", "note", "trash")
