"""The app: four modes on a rig, what holds in all of them, and the one worker that hears of the rig."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

from textual import work
from textual.app import App
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widget import Widget

from capture_app.node.wire.status import RigStatus
from capture_app.node.wire.views import NewsLine
from capture_app.text import printable
from capture_app.tui.header import MODES
from capture_app.tui.jobs.job_list import JobList
from capture_app.tui.jobs.jobs_view import JobsView
from capture_app.tui.library.catalogue import find_samples
from capture_app.tui.library.sessions_view import SessionsView
from capture_app.tui.messages import (
    LinkChanged,
    Mishap,
    ModeRequested,
    NewsReceived,
    RigMessage,
    SessionsRequested,
    ShowSessions,
    StatusChanged,
    message_of,
)
from capture_app.tui.mode import ModeScreen
from capture_app.tui.placeholder import NotThereYet
from capture_app.tui.record import RigRecord
from capture_app.tui.rig.view import RigView
from capture_app.tui.rig_source import RigSource
from capture_app.tui.settings import Settings
from capture_app.tui.themes import DARK, PLAIN, THEMES


class SimulshotApp(App[None]):
    """The screen of a rig, wherever its leader runs."""

    TITLE = "simulshot"
    CSS_PATH = Path(__file__).with_name("app.tcss")
    DEFAULT_MODE = "rig"
    ENABLE_COMMAND_PALETTE = True
    COMMAND_PALETTE_BINDING = "ctrl+p"
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(str(number), f"go('{mode}')", title, id=f"app.{mode}", show=False)
            for number, (mode, title) in enumerate(MODES.items(), 1)
        ),
        Binding("question_mark", "help", "Help", id="app.help", key_display="?"),
        Binding("q", "quit", "Quit", id="app.quit"),
    ]

    def __init__(
        self,
        source: RigSource,
        *,
        settings: Settings,
        sessions: Path,
        local: bool = True,
        started: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`sessions`: the folder that is shown; `clock`: seconds that only grow, for what runs over time.

        `local`: the leader is on this machine; `started`: it was started for this screen.
        """
        super().__init__()
        self._source = source
        self._settings = settings
        self._sessions = sessions
        self._local = local
        self._started = started
        self._record = RigRecord(clock)
        self.jobs = JobList(sessions)
        for mode in MODES:
            self.add_mode(mode, partial(self._mode_screen, mode))
        for theme in THEMES.values():
            self.register_theme(theme)
        theme_name = settings.recall("theme", DARK.name)
        self.theme = (
            PLAIN.name if self.no_color else theme_name if theme_name in self.available_themes else DARK.name
        )
        self.set_keymap(settings.keys)

    def on_mount(self) -> None:
        """Begin to follow the rig."""
        for warning in self._settings.warnings:
            self.show_mishap(warning, "warning")
        self._settings.on_change = self._save_soon
        self.screen_change_signal.subscribe(self, self._tell_screen)
        self.theme_changed_signal.subscribe(self, lambda theme: self._settings.remember("theme", theme.name))
        self._follow()
        self.run_worker(self.jobs.find_earlier(), group="jobs")

    async def on_unmount(self) -> None:
        """End the jobs: their results are there whole or not at all."""
        await self.jobs.close()

    def _mode_screen(self, mode: str) -> ModeScreen:
        return ModeScreen(mode, self._view(mode))

    def _view(self, mode: str) -> Widget:
        if mode == "rig":
            return RigView(self._source, self._record, self._settings, self._sessions, local=self._local)
        if mode == "sessions":
            samples = find_samples(self._sessions)
            return SessionsView(self._sessions, self.jobs, samples=samples, settings=self._settings)
        if mode == "jobs":
            return JobsView(self.jobs)
        return NotThereYet(MODES[mode])

    # The rig

    @work(group="rig")
    async def _follow(self) -> None:
        """Tell the screens that are seen what changes; the others read the record when they are."""
        async for update in self._source.updates():
            if isinstance(update, RigStatus) and self._record.lost:
                self._post(lambda: LinkChanged(""))
            self._record.add(update)
            if isinstance(update, RigStatus):
                self.jobs.hold_for(update)
            self._post(partial(message_of, update))

    def _post(self, message: Callable[[], RigMessage]) -> None:
        for screen in self.screen_stack:
            screen.post_message(message())

    def _tell_screen(self, screen: Screen[object]) -> None:
        """Tell a screen that is now seen how the rig is."""
        screen.post_message(LinkChanged(self._record.lost))
        if self._record.status is not None:
            screen.post_message(StatusChanged(self._record.status))

    # What views ask for

    def on_mode_requested(self, message: ModeRequested) -> None:
        """Go to a mode."""
        self.switch_mode(message.mode)

    async def on_sessions_requested(self, message: SessionsRequested) -> None:
        """Go to the sessions of a folder."""
        await self.switch_mode("sessions")
        screen = self.screen_stack[0]
        if isinstance(screen, ModeScreen):
            screen.view.post_message(ShowSessions(message.folder, message.session))

    def on_mishap(self, message: Mishap) -> None:
        """Show what went wrong, and keep it in the news."""
        self.show_mishap(str(message.error))

    def show_mishap(self, text: str, level: Literal["warning", "error"] = "error") -> None:
        """Show a sentence about what went wrong until it is read, and keep it in the news."""
        news = NewsLine(unix_ns=time.time_ns(), text=printable(text), level=level)
        self._record.add(news)
        self._post(lambda: NewsReceived(news))
        self.notify(news.text, severity=level, markup=False, timeout=10)

    # Doing

    def action_go(self, mode: str) -> None:
        """Go to a mode."""
        self.switch_mode(mode)

    # Settings

    def _save_soon(self) -> None:
        self._save_settings()

    @work(thread=True, exclusive=True, group="settings")
    def _save_settings(self) -> None:
        try:
            self._settings.save()
        except OSError as error:
            self.call_from_thread(self.show_mishap, f"choices are not remembered: {error}", "warning")
