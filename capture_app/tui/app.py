"""Textual app: four modes on one rig, their common actions, and the worker that follows the rig."""

import asyncio
import contextlib
import gc
import os
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Literal

from textual import work
from textual.app import App, SystemCommand
from textual.binding import Binding, BindingType
from textual.screen import Screen

from capture_app.common import system
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.text import count, printable
from capture_app.common.timeouts import SCREEN_STOP_TIMEOUT_S
from capture_app.protocol.orders import EndBurst, StopRig
from capture_app.protocol.status import BurstStatus, LogLine, RigStatus
from capture_app.rig.process import AttachedRig, list_rigs
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.tui.jobs.jobs_view import JobsView
from capture_app.tui.jobs.run import CAN_EXPORT, EXPORTS, MOMENT, STUDIES, Run, RunState
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.key_bindings import HelpScreen, keys_file_text, unknown_names
from capture_app.tui.library.session_rows import find_samples
from capture_app.tui.library.sessions_view import SessionsView
from capture_app.tui.mode import MODES, ModeScreen, ModeView
from capture_app.tui.palette import Palette
from capture_app.tui.question import Answer, Question
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.rig.rig_view import RigView
from capture_app.tui.rig_record import ActionFailed, RecordChanged, RigRecord, SessionMoved, SessionsRequested
from capture_app.tui.screen_settings import KEYS_FILE, Settings
from capture_app.tui.shoot.shoot_view import ShootView
from capture_app.tui.signs import DARK, PLAIN, THEMES
from capture_app.tui.widgets.picture import SharpTerminal, find_sharp_terminal

_IN_RIG = (
    (
        "capture-app cameras set",
        "Exposure, gain, white balance, focus",
        "in Rig, enter opens a camera, and X sets it",
    ),
    (
        "capture-app node fps",
        "Frames a second",
        "of a recording, the rate in Shoot; of a camera, in its spec, as in "
        "`capture-app node --camera v4l2:/dev/video0,fps=60`",
    ),
    (
        "capture-app cameras add",
        "IP cameras",
        "by RTSP, in another terminal: `capture-app cameras add rtsp://USER:PASSWORD@HOST/PATH`",
    ),
    (
        "capture-app people",
        "Joints as OSC or LSL",
        "in another terminal, while the rig runs: `capture-app people --osc 127.0.0.1:9000`",
    ),
)
"""Entries of the palette that say how a thing is done: command line, title and words."""
LEAVE, FINISH, STOP, STAY = "leave", "finish", "stop", "stay"
POLL_S = 0.2
"""Interval at which a take that is awaited is looked at, s."""
FOREIGN_JOBS_S = 2.0
"""Interval at which the state of another screen's jobs is read, s."""
SETTLED_S = 5.0
"""Time from the start after which what is in memory stays there, in seconds."""
NAMED_JOBS = 2
"""Maximum number of jobs named in the quit question; the rest are counted."""


def quit_question(
    status: RigStatus | None, *, started: bool, local: bool, jobs: Sequence[str]
) -> Question | None:
    """Return the question before quitting, or None if nothing is lost and no local rig stays running.

    `started`: the rig was started for this screen; `jobs`: running and waiting jobs with their progress.
    """
    own = [] if status is None else [n for n in status.nodes if n.on_leader and n.state is not NodeState.LOST]
    asks_for_rig = local and status is not None and bool(own or (started and status.nodes))
    lines = []
    if asks_for_rig and status is not None:
        own_cameras = f" with {count(len(own), 'camera')}" if own else ""
        lines.append(
            f"The rig at {status.leader}{own_cameras} can keep running without the screen. "
            "The next start of the screen finds it."
        )
        if unsaved := _unsaved(status):
            takes = (
                f"{take.name} is {'recording' if _goes_on(take) else 'being saved'}: {take.received} of "
                f"{take.expected} images are here. "
                for take in unsaved[:NAMED_JOBS]
            )
            lines.append(
                "".join(takes) + "A rig that stops now saves no others: cameras keep what they have stored, "
                "and bring it when they join again; simulated ones lose what is unrendered."
                + " If it is left running, `capture-app record --stop` ends the recording."
                * any(map(_goes_on, unsaved))
            )
    if jobs:
        more = f" and {count(len(jobs) - NAMED_JOBS, 'more job')}" if len(jobs) > NAMED_JOBS else ""
        lines.append(
            f"{', '.join(jobs[:NAMED_JOBS])}{more} {'ends' if len(jobs) == 1 else 'end'} with the screen, "
            "without a result."
        )
    if not lines:
        return None
    ending = f", end the {'job' if len(jobs) == 1 else 'jobs'}" if jobs else ""
    stay = Answer(STAY, "n", "Stay here")
    if not asks_for_rig:
        return Question("\n\n".join(lines), [stay, Answer(LEAVE, "y", "Quit" + ending)], title="Quit?")
    answers = [Answer(LEAVE, "l", f"Leave the rig running{ending}"), Answer(STOP, "s", "Stop the rig")]
    if _unsaved(status):
        answers.insert(0, Answer(FINISH, "f", "Finish saving, then stop the rig"))
    # The first answer has the focus, so that Enter ends no job.
    answers = [stay, *answers] if jobs else [*answers, stay]
    return Question("\n\n".join(lines), answers, title="Quit?")


def _unsaved(status: RigStatus | None) -> list[BurstStatus]:
    """Return the takes of which images are still to come, the newest one first."""
    if status is None:
        return []
    newest = [] if status.burst is None or status.burst.done else [status.burst]
    return [*newest, *status.unsaved]


def _goes_on(take: BurstStatus) -> bool:
    """Return whether a take is a recording that has not ended."""
    return take.recording and not take.ended


class SimulshotApp(App[None]):
    """Terminal UI of a rig, whose leader may be on this or another machine."""

    TITLE = "simulshot"
    COMMANDS: ClassVar[set[Any]] = {Palette}
    CSS_PATH = Path(__file__).with_name("app.tcss")
    DEFAULT_MODE = "rig"
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(str(number), f"switch_mode('{mode}')", title, id=f"app.{mode}", show=False)
            for number, (mode, title) in enumerate(MODES.items(), 1)
        ),
        Binding("l", "start", "Restart leader", id="app.start", tooltip="if it is lost"),
        Binding("question_mark", "help", "Help", id="app.help", key_display="?"),
        Binding("q", "quit", "Quit", id="app.quit", tooltip="asks first if a job or a rig would end"),
    ]

    def __init__(
        self,
        source: RigLink,
        *,
        settings: Settings,
        sessions: Path,
        local: bool = True,
        started: bool = False,
        record: RigRecord | None = None,
        sharp_terminal: SharpTerminal | None = None,
        depth: bool = False,
    ) -> None:
        """`sessions`: the folder shown; `record`: the storage for the rig's updates.

        `local`: the leader is on this machine; `started`: it was started for this screen; `sharp_terminal`:
        the protocol that draws still images, None for glyphs; `depth`: compute depth after each take.
        """
        # Textual removes colours only in ANSI mode, with the terminal's own palette; otherwise it turns them
        # grey.
        super().__init__(ansi_color=True if "NO_COLOR" in os.environ else None)
        self._source = source
        self._settings = settings
        self._local = local
        self._started = started
        self.sharp_terminal = sharp_terminal
        self._record = record or RigRecord()
        self.runs = Runs(sessions, self._notify_run)
        samples, rig = find_samples(sessions), (source, self._record, settings)
        self._views: dict[str, ModeView] = {
            "rig": RigView(*rig, sessions, samples, local=local),
            "shoot": ShootView(*rig, self.runs if depth else None),
            "sessions": SessionsView(sessions, self.runs, samples, settings),
            "jobs": JobsView(self.runs),
        }
        for mode, view in self._views.items():
            self.add_mode(mode, partial(ModeScreen, mode, view, self._record))
        for theme in THEMES:
            self.register_theme(theme)
        chosen = PLAIN.name if self.no_color else settings.recall("theme", DARK.name)
        self.theme = chosen if chosen in self.available_themes else DARK.name
        self.set_keymap(settings.keys)

    def on_mount(self) -> None:
        """Start following the rig."""
        for warning in self._settings.warnings:
            self.show_error(warning, "warning")
        if wrong := unknown_names(self._settings.keys):
            self.show_error(
                f"{KEYS_FILE} names unknown actions: {', '.join(wrong)}; the help (?) lists all", "warning"
            )
        self._settings.on_change = self._save_settings
        with contextlib.suppress(NotImplementedError, ValueError):  # not in the main thread, as in tests
            system.on_end(self.exit)
        self.screen_change_signal.subscribe(self, self._notify_screen)
        self.theme_changed_signal.subscribe(self, lambda theme: self._settings.remember("theme", theme.name))
        self._follow()
        self.run_worker(self.runs.read(), group="jobs")
        self.set_interval(FOREIGN_JOBS_S, self._read_foreign_jobs)

    def _read_foreign_jobs(self) -> None:
        if any(run.is_foreign for run in self.runs.all):
            self.run_worker(self.runs.read(), group="jobs", exclusive=True)

    async def on_unmount(self) -> None:
        """Stop the runs of commands; each result is then complete or absent."""
        await self.runs.close()

    # Updates for screens; a hidden screen reads the record when it is shown

    @work(group="rig")
    async def _follow(self) -> None:
        async for update in self._source.updates():
            was_lost = self._record.lost
            self._record.add(update)
            if self._record.lost != was_lost:
                self.refresh_bindings()
            if isinstance(update, RigStatus):
                self.runs.hold(update.burst is not None and not update.burst.done)
            elif isinstance(update, LinkLost):
                self.runs.hold(False)
            self._send(update)

    def _send(self, what: object) -> None:
        for screen in self.screen_stack:
            screen.post_message(RecordChanged(what))
            if isinstance(screen, ModeScreen):
                screen.view.post_message(RecordChanged(what))

    def _notify_screen(self, _: Screen[object]) -> None:
        """Send the rig's state to a screen that has just become visible."""
        if self._record.status is not None:
            self._send(self._record.status)
        if self._record.lost:
            self._send(LinkLost(self._record.lost))

    def _notify_run(self, run: Run | None) -> None:
        """Notify all modes that runs have changed; show a message if `run` is done or has failed."""
        self._send(self.runs)
        if run is None or run.kind == MOMENT.name or run.state not in (RunState.DONE, RunState.FAILED):
            return
        what = f"{run.command.title} of {printable(run.session.name)}"
        if run.state is RunState.FAILED:
            self.notify(f"{what} failed: {run.message}", severity="error", markup=False, timeout=10)
        elif run.result is not None:
            self.notify(f"{what} is done: press R in Sessions for the result", markup=False)
        else:
            self.notify(f"{what}: {run.message}", markup=False)

    # Requests from views

    async def on_sessions_requested(self, message: SessionsRequested) -> None:
        """Show the sessions of a folder."""
        await self.switch_mode("sessions")
        self.screen.query_one(SessionsView).open_folder(message.folder)

    def on_session_moved(self, message: SessionMoved) -> None:
        """Let the takes of the mode Shoot follow their sessions."""
        if isinstance(view := self._views.get("shoot"), ShootView):
            after = None if message.after is None else message.after.absolute()
            view.follow_session(message.before.absolute(), after)

    def on_action_failed(self, message: ActionFailed) -> None:
        """Show an error and add it to the log."""
        self.show_error(str(message.error))

    def show_error(self, text: str, level: Literal["warning", "error"] = "error") -> None:
        """Show an error or warning as a notification and add it to the log."""
        line = LogLine(unix_ns=time.time_ns(), text=printable(text), level=level)
        self._record.add(line)
        self._send(line)
        self.notify(line.text, severity=level, markup=False, timeout=10)

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer a lost leader of this machine to be restarted."""
        return bool(self._record.lost) and self._local if action == "start" else True

    def action_start(self) -> None:
        """Restart the rig's leader."""
        self.notify(f"starting a leader at {self._source.leader} …", markup=False)
        if isinstance(view := self._views.get("rig"), RigView):
            view.restart_leader()

    @work(group="help")
    async def action_help(self) -> None:
        """Show the keys of the current screen."""
        if isinstance(self.screen, HelpScreen):
            return
        actions = [each.binding for each in self.screen.active_bindings.values()]
        names = {binding.key: self.get_key_display(binding) for binding in actions}
        folder = "" if self._settings.folder is None else str(self._settings.folder)
        here = list_rigs(port=self._source.leader.port) if self._local else ()
        log = next((rig.log for rig in here if rig.log), "")
        if await self.push_screen_wait(HelpScreen(actions, names, folder, log)):
            self._write_keys()

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """Yield the actions of the command palette."""
        return (action for _, action in self.actions(screen))

    def actions(self, screen: Screen[Any]) -> Iterator[tuple[str, SystemCommand]]:
        """Yield the actions of this screen, of the other modes, on the selected session, and the themes.

        Each comes with its command line, or its name, by which other programs' words for it are known.
        """
        seen: set[str] = set()
        for node, binding, enabled, _ in screen.active_bindings.values():
            if enabled and binding.id is not None and binding.id not in seen:
                seen.add(binding.id)
                yield (
                    f"capture-app {binding.id}",
                    SystemCommand(
                        binding.description,
                        f"key {self.get_key_display(binding)}",
                        partial(self.run_action, binding.action, node),
                    ),
                )
        for mode, view in self._views.items():
            for one in Binding.make_bindings(view.BINDINGS):
                if one.id is not None and one.id not in seen:
                    seen.add(one.id)
                    key = self._settings.keys.get(one.id, one.key).partition(",")[0]
                    yield (
                        f"capture-app {one.id}",
                        SystemCommand(
                            f"{one.description}: {one.tooltip}" if one.tooltip else one.description,
                            f"in {MODES[mode]}, key {one.key_display or key}",
                            partial(self.action_run_in_mode, mode, one.action),
                        ),
                    )
        for action, choice, line, title, what in (
            *(("analyse", one.name, f"reconstruct {one.words[0]}", one.title, one.what) for one in STUDIES),
            *(
                ("export", name, f"capture-app sessions export --to {name}", one.title, "files for it")
                for name, one in EXPORTS.items()
                if CAN_EXPORT
            ),
        ):
            run = partial(self.action_run_in_mode, "sessions", f"on_session('{action}', '{choice}')")
            yield line, SystemCommand(title, f"{what}, from the session selected in Sessions", run, False)
        for line, title, what in _IN_RIG:
            yield line, SystemCommand(title, what, partial(self.action_switch_mode, "rig"))
        yield (
            "capture-app theme",
            SystemCommand("Theme", "dark, light, no colour and others", self.action_change_theme),
        )
        for theme in sorted(self.available_themes, key=lambda name: not name.startswith("simulshot")):
            yield (
                "capture-app theme",
                SystemCommand(f"Theme {theme}", "", partial(setattr, self, "theme", theme), False),
            )

    async def action_switch_mode(self, mode: str) -> None:
        """Show a mode itself: a single camera, or the page to add some, that was open there is closed."""
        if mode == self.current_mode and isinstance(view := self._views[mode], RigView):
            view.action_back()
        await self.switch_mode(mode)
        if isinstance(self.screen, CameraScreen):
            self.screen.action_leave()

    async def action_run_in_mode(self, mode: str, action: str) -> None:
        """Switch to a mode and run an action of its view there."""
        await self.action_switch_mode(mode)
        if not await self.run_action(action, self._views[mode]):
            self.notify(
                f"nothing that this applies to is selected in {MODES[mode]}: select it, then try again"
            )

    # Quitting

    def action_help_quit(self) -> None:
        """Say which key quits, to who presses ctrl+c."""
        keys = (each.binding for each in self.active_bindings.values() if each.binding.id == "app.quit")
        self.notify(f"press {', '.join(map(self.get_key_display, keys)) or 'esc, then q,'} to quit")

    async def action_quit(self) -> None:
        """Close the screen; ask first if that would end jobs or leave a rig running."""
        status = None if self._record.lost else self._record.status
        question = quit_question(
            status, started=self._started, local=self._local, jobs=list(map(str, self.runs.unfinished))
        )
        if isinstance(self.screen, Question):
            self.exit()  # quit pressed again without an answer: leave the rig running
        elif question is not None:
            self.push_screen(question, self._leave)
        elif self._started and self._local and status is not None:
            self._leave(STOP)  # a rig without cameras that was started for this screen
        else:
            self.exit()

    def _leave(self, answer: str | None) -> None:
        if answer == FINISH:
            self._finish()
        elif answer in (STOP, LEAVE):
            self._end(stop_rig=answer == STOP)
        elif answer == STAY:
            self._record.ending = ""
            self.workers.cancel_group(self, "leaving")

    @work(group="leaving", exclusive=True)
    async def _finish(self) -> None:
        """End a recording, and stop the rig when all takes are saved; the screen stays usable meanwhile."""
        self._record.ending = "stops when saved"
        self.notify("The rig stops when the take is saved; q asks again", timeout=SCREEN_STOP_TIMEOUT_S)
        for take in filter(_goes_on, _unsaved(self._record.status)):
            with contextlib.suppress(SimulshotError):  # it has just ended
                await self._source.order(EndBurst(burst=take.burst))
        while self._record.lost or _unsaved(self._record.status):  # noqa: ASYNC110 - of the record
            await asyncio.sleep(POLL_S)
        self._end(stop_rig=True)

    @work(group="leaving", exclusive=True)
    async def _end(self, *, stop_rig: bool) -> None:
        self.notify("Stopping the rig …" if stop_rig else "Leaving …", timeout=SCREEN_STOP_TIMEOUT_S)
        message = None
        try:
            if stop_rig:
                await asyncio.wait_for(self._source.order(StopRig()), SCREEN_STOP_TIMEOUT_S)
                message = "The rig is stopped."
        except (SimulshotError, TimeoutError) as error:
            message = printable(f"The rig may still be running: {error or 'it did not answer'}")
        # Close the runs while the screen can still show messages: a running job takes seconds to end.
        await self.runs.close()
        self.exit(message=message)

    # Settings

    @work(thread=True, exclusive=True, group="settings")
    def _write_keys(self) -> None:
        """Write keys.toml with all actions, unless it exists or settings are not stored."""
        if self._settings.folder is None:
            return
        path = self._settings.folder / KEYS_FILE
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as file:
                file.write(keys_file_text())
            words = f"{path} lists all actions. Changed keys take effect at the next start"
        except FileExistsError:
            words = f"{path} exists already; delete it to write a new one"
        except OSError as error:
            words = f"{path} cannot be written: {error}"
        self.call_from_thread(self.notify, printable(words), markup=False, timeout=10)

    @work(thread=True, exclusive=True, group="settings")
    def _save_settings(self) -> None:
        try:
            self._settings.save()
        except OSError as error:
            self.call_from_thread(self.show_error, f"the settings cannot be saved: {error}", "warning")


def run_screen(rig: AttachedRig, *, frames: int | None = None, depth: bool = True) -> None:
    """Show a rig until the user quits; `frames`, if given, is stored as the frames of a burst.

    `depth`: compute depth after each take, if this machine can.
    """
    settings = Settings.load()
    if frames is not None:
        settings.remember("shoot.frames", frames)
    # Each fourth key waited 50 ms for the collector, which looked at all that was imported and built.
    settling = threading.Timer(SETTLED_S, gc.freeze)
    settling.daemon = True
    settling.start()
    SimulshotApp(
        RigLink(rig.leader),
        settings=settings,
        sessions=rig.sessions,
        local=rig.is_local,
        started=rig.started,
        sharp_terminal=find_sharp_terminal(settings.recall("pictures", "local")),
        depth=depth and find_spec("pycolmap") is not None,
    ).run()
