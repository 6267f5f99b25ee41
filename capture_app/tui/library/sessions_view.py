"""Mode Sessions: the sessions on disk, the selected one, and the actions on it."""

import asyncio
import os
from functools import partial
from pathlib import Path
from typing import ClassVar

from platformdirs import user_cache_path
from textual import work
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import free_name, typed_name
from capture_app.common.text import count, megabytes, printable
from capture_app.session.exporting.exporter import load_exporters, unmet_needs
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.library.changes import (
    TRASH,
    check_note,
    empty_trash,
    rename_session,
    restore_session,
    results_folder,
    set_note,
    trash_session,
    trashed_sessions,
)
from capture_app.session.library.listing import SessionCard, SessionListing, disk_bytes
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.jobs.result_screen import open_report, show_result
from capture_app.tui.jobs.run import (
    CAN_EXPORT,
    CAN_IMPORT,
    COMMANDS,
    COVERAGE,
    EXPORTS,
    IMPORT,
    REPAIR,
    STUDIES,
    VERIFY,
    Command,
    Run,
    RunState,
)
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.library.session_rows import ORDERS, Entry, Order, SessionRows, TakePane, arrange
from capture_app.tui.mode import ModeView
from capture_app.tui.question import Answer, ListQuestion, Question, TextQuestion, explain_verdict
from capture_app.tui.rig_record import RecordChanged, SessionMoved, showing_errors
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.lines import Lines, write_border
from capture_app.tui.widgets.text_field import TextField

LOOK_AGAIN_S = 2.0
"""Interval at which the folder is read while visible, in seconds."""
FOLLOW_EVERY_S = 0.25
"""Redraw interval of runs on the sessions, in seconds."""
SETTLED_S = 0.15
"""Delay before a newly selected session's images are loaded, in seconds."""
WIDE = 120
"""Width from which the selected session is shown beside the list."""


class SessionsView(ModeView):
    """View of a folder's sessions, the bundled samples, and the runs on both."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "enter",
            "on_session('look')",
            "Look",
            id="sessions.look",
            tooltip="its pictures, verdict, size and folder",
        ),
        Binding("y", "on_session('explain')", "Why", id="sessions.why", tooltip="explains the verdict"),
        Binding(
            "c",
            "on_session('compare')",
            "Compare",
            id="sessions.compare",
            tooltip="synchronized against offset",
        ),
        Binding(
            "R", "on_session('results')", "Results", id="sessions.results", tooltip="result of the last job"
        ),
        *([Binding("e", "on_session('export')", "Export", id="sessions.export")] if CAN_EXPORT else []),
        Binding(
            "A",
            "on_session('analyse')",
            "Analyse",
            id="sessions.analyse",
            tooltip="depth, walk, splat, calibrate, time offsets",
        ),
        Binding(
            "delete,backspace",
            "on_session('trash')",
            "Trash",
            id="sessions.trash",
            key_display="del",
            tooltip="delete it; u restores it",
        ),
        Binding("n", "on_session('rename')", "Name", id="sessions.rename"),
        Binding("t", "on_session('note')", "Note", id="sessions.note"),
        Binding("u", "undo", "Undo", id="sessions.undo"),
        Binding(
            "E",
            "empty_trash",
            "Empty the trash",
            show=False,
            id="sessions.empty-trash",
            tooltip="frees its disk space, after a question",
        ),
        Binding(
            "less_than_sign",
            "sort",
            "Sort",
            id="sessions.sort",
            key_display="<",
            tooltip="takes against each other: by synchronization, name, time, size",
        ),
        Binding("slash", "filter", "Find", id="sessions.filter", key_display="/"),
        Binding(
            "V",
            "on_session('verify')",
            "Verify",
            id="sessions.verify",
            tooltip="check that all files are intact",
        ),
        *(
            [Binding("I", "import", "Import", id="sessions.import", tooltip="import a folder of videos")]
            if CAN_IMPORT
            else []
        ),
        Binding("escape", "show_all", "Show all", id="sessions.show-all", key_display="esc"),
    ]

    def __init__(self, root: Path, runs: Runs, samples: Path | None, settings: Settings) -> None:
        """`samples`: a folder of further sessions, shown read-only."""
        self._runs, self._settings = runs, settings
        self._listing = SessionListing(root)
        self._sample_listing = None if samples is None else SessionListing(samples)
        cache = user_cache_path("simulshot", appauthor=False) / "thumbnails"
        self._rows = SessionRows(cache, runs)
        self._pane = TakePane()
        self._find = TextField(
            placeholder="name, note, camera, date", id="sessions-find", select_on_focus=False
        )
        self._empty = Lines(id="sessions-empty")
        self._frame = Vertical(self._find, self._empty, self._rows, id="sessions-frame")
        self._cards: list[SessionCard] | None = None
        """Sessions as last read; None before the first read or after a change of folder."""
        self._samples: list[SessionCard] = []
        self._target: Path | None = None
        """Session, or folder of sessions, to select once it is listed."""
        self._reading = asyncio.Lock()
        """Held while the folder is read, which may exceed the read interval on a slow disk."""
        super().__init__(self._frame, self._pane)

    def on_mount(self) -> None:
        """Start following the folder."""
        self.set_interval(LOOK_AGAIN_S, self._look_again)
        self.set_interval(FOLLOW_EVERY_S, self._follow_runs)
        self.look_at_disk()

    def on_mode_shown(self) -> None:
        """Read the folder at once."""
        super().on_mode_shown()
        self._look_again()
        self._measure()

    def on_resize(self) -> None:
        """Show the selected session beside the list if there is space."""
        self.set_class(self.size.width >= WIDE, "-wide")
        self.on_row_list_chosen(SessionRows.Chosen())

    def focus_first(self) -> None:
        """Focus the list, the session shown in full, or the mode where there is no session."""
        list_or_mode = self._rows if self._rows.display else self
        (self._pane.sheet if self.has_class("-whole") else list_or_mode).focus()

    def _keep_focus(self) -> None:
        if self.screen.focused in (None, self, self._rows):
            self.focus_first()

    def on_record_changed(self, message: RecordChanged) -> None:
        """Update the runs shown on the sessions."""
        if message.what is self._runs:
            self._rows.show_all_again()
            self.refresh_bindings()
            self._measure()

    @property
    def entry(self) -> Entry | None:
        """Selected session."""
        return self._rows.item if self.is_mounted else None

    def open_folder(self, folder: Path) -> None:
        """Show the sessions of a folder; samples are always listed."""
        listings = [one for one in (self._listing, self._sample_listing) if one is not None]
        if not any(one.root.absolute() == folder.absolute() for one in listings):
            self._listing = SessionListing(folder)
        self._cards = None
        self._look_for(folder)

    # List

    def _look_for(self, folder: Path) -> None:
        self._target = folder
        self.look_at_disk()

    def _look_again(self) -> None:
        if self.screen.is_active and not self._reading.locked():
            self._rows.show_all_again()
            self.look_at_disk()

    def _follow_runs(self) -> None:
        for run in self._runs.unfinished:
            self._rows.show_again(str(run.session.absolute()))
        self._name_frame()

    def _name_frame(self, title: str | None = None) -> None:
        importing = [f"◔ {run}" for run in self._runs.unfinished if run.kind == IMPORT.name]
        subtitle = " · ".join([*importing, self._order, "< sorts · / finds" + " · I imports" * CAN_IMPORT])
        write_border(self._frame, title, subtitle)

    @work(group="listing")
    async def look_at_disk(self) -> None:
        """Read the folder in a thread and show changes."""
        await self._list()

    async def _list(self) -> None:
        async with self._reading:
            listing = self._listing
            cards = await asyncio.to_thread(listing.read)
            if self._sample_listing is not None and self._cards is None:
                self._samples = await asyncio.to_thread(self._sample_listing.read)
            if listing is self._listing and (cards != self._cards or self._target is not None):
                self._cards = cards
                self._show()
                self._measure()

    @work(exclusive=True, group="sizes")
    async def _measure(self) -> None:
        """Measure results and the trash in a thread, as that takes seconds on a slow disk."""
        root, cards = self._listing.root, [*(self._cards or ()), *self._samples]

        def measure() -> dict[Path, int]:
            return {root / TRASH: disk_bytes(root / TRASH)} | {
                card.folder: disk_bytes(
                    results_folder(card.folder, root), *[card.folder] * (card.state != "complete")
                )
                for card in cards
            }

        found = await asyncio.to_thread(measure)
        if found != self._rows.further:
            self._rows.further = found
            self._show()

    @property
    def _order(self) -> Order:
        return next((one for one in ORDERS if one == self._settings.recall("sessions.order", "")), ORDERS[0])

    def _show(self) -> None:
        if self._cards is None:
            return
        words = self._find.value if self._find.display else ""
        entries = arrange(self._cards, self._samples, self._order, words, self._rows.further)
        nothing_chosen = not self._rows.chosen
        self._rows.show_items({entry.key: entry for entry in entries})
        if nothing_chosen:
            self._choose_saved(entries)
        if self._target is not None:
            target = self._target.absolute()
            if self._choose_saved([e for e in entries if target in (Path(e.key), Path(e.key).parent)]):
                self._target = None
        self._rows.display = bool(entries)
        # A list that is hidden loses the focus to nothing, and no key of the mode would work.
        self.call_after_refresh(self._keep_focus)
        self._empty.display = not entries
        text = (
            f"No session in {printable(str(self._listing.root))} yet: "
            f"in Shoot (key 2), space takes one{'; I imports videos' * CAN_IMPORT}."
        )
        self._empty.show([Content(f"No session has “{printable(words)}”; esc shows all." if words else text)])
        here = sum(not entry.is_sample for entry in entries)
        samples = f" · {count(len(entries) - here, 'sample')}" if len(entries) > here else ""
        in_trash = self._rows.further.get(self._listing.root / TRASH)
        trash = f" · trash {megabytes(in_trash)}" if in_trash else ""
        self._name_frame(f"{count(here, 'session')}{samples}{trash}")
        self.on_row_list_chosen(SessionRows.Chosen())

    on_input_changed = _show

    def _choose_saved(self, entries: list[Entry]) -> bool:
        """Select the first complete session, else the first one; return whether there is any."""
        saved = (entry for entry in entries if entry.card.state == "complete")
        for entry in (*saved, *entries)[:1]:
            self._rows.choose(entry.key)
        return bool(entries)

    def on_row_list_chosen(self, message: SessionRows.Chosen) -> None:
        """Show the selected session and its actions, or open it."""
        if self.has_class("-wide"):
            self._show_pane(SETTLED_S)
        self.refresh_bindings()
        if message.opens and self.check_action("on_session", ("look",)):
            self.action_on_session("look")

    def on_input_submitted(self) -> None:
        """Move the focus from the search to the list of sessions that match."""
        self._rows.focus()

    @work(exclusive=True, group="pane")
    async def _show_pane(self, after_s: float = 0.0) -> None:
        await asyncio.sleep(after_s)
        entry = self.entry
        write_border(self._pane, "" if entry is None else printable(entry.card.shown))
        if entry is None or entry.card.state != "complete":
            self._pane.show(entry, None)
        elif entry != self._pane.entry:
            sheet = None
            with showing_errors(self):
                sheet = await asyncio.to_thread(TakeSheet.open, entry.card.folder)
            self._pane.show(entry, sheet)

    # Viewing

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only actions available for the selected session."""
        if action == "show_all":
            return bool(self._find.display) or self.has_class("-whole")
        if action != "on_session":
            return True
        entry, (what, *_) = self.entry, parameters
        if entry is None or what == "results":
            return entry is not None and self._latest_result(entry) is not None
        # The key explains why not, while a hidden key explains nothing.
        return bool(_why_not(entry, what)) or entry.card.state == "complete" or what in ("analyse", "trash")

    def action_on_session(self, what: str, *choice: str) -> None:
        """Do something with the selected session, or say why that does not work.

        `choice`: the command or format, which is asked for otherwise.
        """
        entry = self.entry
        if entry is not None and (why := _why_not(entry, what)):
            self.app.notify(f"{printable(entry.card.shown)} {why}", markup=False)
        elif entry is not None and what in COMMANDS:
            self._start(COMMANDS[what], entry)
        elif entry is not None:
            getattr(self, f"_{what}")(entry, *choice)

    def _look(self, _: Entry) -> None:
        """Show the session in the whole view."""
        self._show_pane()
        self._look_whole(True)

    @work
    async def _explain(self, entry: Entry) -> None:
        """Explain the verdict on the session."""
        with showing_errors(self):
            self.app.push_screen(explain_verdict(await asyncio.to_thread(TakeSheet.open, entry.card.folder)))

    def _look_whole(self, whole: bool) -> None:
        self.set_class(whole, "-whole")
        self.focus_first()
        self.refresh_bindings()

    @work
    async def _results(self, entry: Entry) -> None:
        """Show the latest result on the session."""
        if (run := self._latest_result(entry)) is not None:
            await show_result(self, run, self._runs.log(run))

    def _latest_result(self, entry: Entry) -> Run | None:
        return next((run for run in self._runs.of(entry.card.folder) if run.result is not None), None)

    # Sorting and filtering

    def action_sort(self) -> None:
        """Switch to the next sort order and select the first session."""
        self._settings.remember("sessions.order", ORDERS[(ORDERS.index(self._order) + 1) % len(ORDERS)])
        self._show()
        self._rows.action_move(-len(self._rows.keys))

    def action_filter(self) -> None:
        """Open the filter line."""
        self._find.display = True
        self._find.focus()
        self.refresh_bindings()

    def action_show_all(self) -> None:
        """Clear the filter, or leave the whole view of a session."""
        if self.has_class("-whole"):
            self._look_whole(False)
            return
        self._find.value = ""
        self._find.display = False
        self._rows.focus()
        self._show()

    # Starting commands

    @work
    async def _analyse(self, entry: Entry, name: str | None = None) -> None:
        """Ask for a command, unless it is given, and its options, and run it."""
        commands = (*STUDIES, VERIFY) if entry.card.state == "complete" else (REPAIR,)
        rows = {one.name: (one.title, one.what) for one in commands}
        name = (
            name
            if name in rows
            else await self.app.push_screen_wait(ListQuestion(f"Run a command on {entry.card.shown}", rows))
        )
        if name is not None:
            command, folder, quick = COMMANDS[name], entry.card.folder, COMMANDS[name].quick
            if command.choices:
                choices = {options: (title, options) for title, options in command.choices}
                chosen = await self.app.push_screen_wait(ListQuestion(command.title, choices))
                if chosen == COVERAGE:
                    await self.app.run_action("run_in_mode('rig', 'coverage')")
                if chosen in (None, COVERAGE):
                    return
                quick = chosen
            options = await self.app.push_screen_wait(
                options_question(command, folder, self._runs.out(command, folder), quick)
            )
            if options is not None and command.would_replace(folder, options):
                answer = await self.app.push_screen_wait(
                    Question(
                        f"{entry.card.shown} has a calibration: its own, or the one of its rig.",
                        [Answer("keep", "k", "Keep it"), Answer("replace", "r", "Replace it")],
                        title=command.title,
                    )
                )
                options = f"{options} --replace" if answer == "replace" else None
            if options is not None and (run := self._start(command, entry, options)) is not None:
                await self._open_at_end(run)

    async def _open_at_end(self, run: Run) -> None:
        """Open the page of a run, if it writes one, once it is done."""
        while not run.state.is_over:  # noqa: ASYNC110 - it is followed as often anyway
            await asyncio.sleep(FOLLOW_EVERY_S)
        if run.state is RunState.DONE and run.report is not None:
            open_report(self, run.report)

    @work
    async def _export(self, entry: Entry, name: str | None = None) -> None:
        """Ask for a format, unless it is given, and a folder, and export."""
        calibrated = await asyncio.to_thread((entry.card.folder / CALIBRATION).is_file)
        formats = load_exporters()
        needs = {one: unmet_needs(exporter, calibrated=calibrated) for one, exporter in formats.items()}
        rows = {
            one: (one, f"needs {' and '.join(needs[one])}" if needs[one] else exporter.help)
            for one, exporter in formats.items()
        }
        before = self._settings.recall("sessions.export-format", "colmap")
        name = name or await self.app.push_screen_wait(
            ListQuestion(f"Export {entry.card.shown}", rows, before)
        )
        if name is None:
            return
        if unmet := needs.get(name):
            remedies = (f"\n{what}: {remedy}" for what, remedy in unmet.items())
            self.app.notify(f"An export to {name} needs{''.join(remedies)}", timeout=20, markup=False)
            return
        folder = self._settings.recall("sessions.export-folder", str(self._listing.root.parent))
        typed = await self.app.push_screen_wait(folder_question(entry.card, Path(folder), name))
        if typed is not None:
            out = typed_path(typed)
            self._settings.remember("sessions.export-folder", str(out.parent))
            self._settings.remember("sessions.export-format", name)
            self._start(EXPORTS[name], entry, out=out)

    @work
    async def action_import(self) -> None:
        """Ask for a folder of videos, import it, and select the first new session."""
        proposed = self._settings.recall("sessions.import-folder", str(Path.cwd()))
        typed = await self.app.push_screen_wait(import_question(proposed))
        if typed is None:
            return
        folder = typed_path(typed).absolute()
        self._settings.remember("sessions.import-folder", str(folder))
        before, out = set(self._rows.keys), self._listing.root
        options = await self.app.push_screen_wait(
            options_question(IMPORT, folder, out, "", "Numbered pictures need their --fps. ")
        )
        if options is None:
            return
        with showing_errors(self):
            run = self._runs.add(IMPORT, folder, options, out)
            while not run.state.is_over:  # noqa: ASYNC110 - it is followed as often anyway
                await asyncio.sleep(FOLLOW_EVERY_S)
            # To wait for a worker would make an error of the screen's end.
            await self._list()
            self._rows.choose(next((key for key in self._rows.keys if key not in before), ""))

    def _start(
        self, command: Command, entry: Entry, options: str | None = None, out: Path | None = None
    ) -> Run | None:
        run = None
        with showing_errors(self):
            state = "is waiting" if self._runs.are_held or self._runs.unfinished else "has started"
            run = self._runs.add(command, entry.card.folder, options, out)
            self.app.notify(
                f"{command.title} of {printable(entry.card.shown)} {state}: key 4 shows its progress. "
                "It ends when simulshot quits.",
                markup=False,
            )
        return run

    # Changing sessions

    @work
    async def _rename(self, entry: Entry) -> None:
        """Ask for a new name and rename the session."""
        if name := await self.app.push_screen_wait(name_question(entry.card)):
            with showing_errors(self):
                renamed = await asyncio.to_thread(rename_session, entry.card.folder, name)
                self.post_message(SessionMoved(entry.card.folder, renamed))
                self._look_for(renamed)
            await self._runs.read()

    @work
    async def _note(self, entry: Entry) -> None:
        """Ask for a note and store it."""
        question = TextQuestion(
            "One line, saved with the session.",
            entry.card.note,
            check=check_note,
            title=f"Note of {entry.card.shown}",
        )
        note = await self.app.push_screen_wait(question)
        if note is not None:
            with showing_errors(self):
                await asyncio.to_thread(set_note, entry.card.folder, note)
            self.look_at_disk()

    @work
    async def _trash(self, entry: Entry) -> None:
        """Move the session to the trash without asking, because undo restores it."""
        with showing_errors(self):
            if any(not run.state.is_over for run in self._runs.of(entry.card.folder)):
                raise SimulshotError(
                    "a job is working on this session", hint="cancel it first: key 4, then x"
                )
            await asyncio.to_thread(trash_session, entry.card.folder)
            self.post_message(SessionMoved(entry.card.folder, None))
            self.app.notify(f"{printable(entry.card.shown)} is in the trash: u restores it", markup=False)
        self.look_at_disk()
        await self._runs.read()

    @work
    async def action_undo(self) -> None:
        """Restore the session trashed last."""
        with showing_errors(self):
            restored = await asyncio.to_thread(restore_session, self._listing.root)
            self.app.clear_notifications()  # "u restores it" is over
            self.post_message(SessionMoved(restored, restored))
            self._look_for(restored)
        await self._runs.read()

    @work
    async def action_empty_trash(self) -> None:
        """Delete the sessions in the trash for good, after a question."""
        root = self._listing.root
        sessions = count(len(await asyncio.to_thread(trashed_sessions, root)), "session")
        size = megabytes(self._rows.further.get(root / TRASH, 0))
        question = Question(
            f"The trash of {root} has {sessions}, {size}. Nothing restores what is deleted here.",
            [Answer("keep", "k", "Keep the trash"), Answer("delete", "d", "Delete for good")],
            title="Empty the trash?",
        )
        if await self.app.push_screen_wait(question) == "delete":
            with showing_errors(self):
                deleted = await asyncio.to_thread(empty_trash, root)
                self.app.notify(f"{count(deleted, 'session')} deleted")
            await self._runs.read()


def _why_not(entry: Entry, what: object) -> str:
    """Return why an action does not work for a session that has its key; empty if it works."""
    card = entry.card
    if card.state == "being saved":
        return "is being saved: try again when that is done"
    if entry.is_sample and what in ("rename", "note", "trash"):
        return "is a sample that comes with simulshot, and stays as it is"
    if what != "compare" or card.state != "complete":
        return ""
    if not card.images or len(card.cameras) < 2:
        return f"has {'one camera' if card.images else 'no images'}: nothing to compare"
    return "has one instant: no frame can be offset. Take 5 or more" if card.instants == 1 else ""


def name_question(card: SessionCard) -> TextQuestion:
    """Return the dialog that asks for a session's new name."""

    def check(name: str) -> None:
        name = typed_name(name, "session")
        if name != card.name and card.folder.with_name(name).exists():
            raise BadInputError(f"{name} exists already", hint="choose another name")

    return TextQuestion("Renames its folder and its results, too.", card.name, check=check, title="Rename")


def options_question(command: Command, folder: Path, out: Path, quick: str, note: str = "") -> TextQuestion:
    """Return the dialog for a command's options, with its help on them; `quick` is the initial text."""
    return TextQuestion(
        f"$ {command.line(folder, out, 'OPTIONS')}\n\n{note}Its OPTIONS, or none: enter starts it, ↑ and ↓ "
        "scroll their help.",
        quick,
        check=partial(command.line, folder, out),
        title=command.title,
        read_help=command.options_help,
    )


def import_question(folder: str) -> TextQuestion:
    """Return the dialog for the folder to import, with `folder` as initial text."""

    def check(text: str) -> None:
        # `Path.is_dir` raises for impossible names and inaccessible folders.
        if not text.strip() or not os.path.isdir(typed_path(text)):  # noqa: PTH112
            is_file = bool(text.strip()) and os.path.isfile(typed_path(text))  # noqa: PTH113
            raise BadInputError(
                "this is a file: give its folder" if is_file else "this folder does not exist"
            )

    return TextQuestion(
        "A folder of videos, or another program's recording. Clips taken together are found and aligned by "
        "times, sound, flashes or motion.",
        folder,
        check=check,
        title="Import",
    )


def folder_question(card: SessionCard, folder: Path, format_name: str) -> TextQuestion:
    """Return the dialog for the export's folder; `folder` is the proposed parent."""

    def check(text: str) -> None:
        target = typed_path(text)
        if not text.strip():
            raise BadInputError("no folder is given", hint="type its path")
        try:
            taken = target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            raise BadInputError(f"{target}: {error.strerror}", hint="choose another folder") from error
        if taken:
            raise BadInputError(f"{target} exists already", hint="choose another folder")

    return TextQuestion(
        "Folder to write, new or empty.",
        str(folder / free_name(f"{card.name}-{format_name}", [one.name for one in folder.glob("*")])),
        check=check,
        title=f"Export {card.shown} to {format_name}",
    )


def typed_path(text: str) -> Path:
    """Return the path that a user typed."""
    # `Path.expanduser` raises for an unknown home directory, such as a half-typed name.
    return Path(os.path.expanduser(text.strip()))  # noqa: PTH111
