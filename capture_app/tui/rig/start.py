"""Start panel: the cameras and other sources that this machine offers, each with an explanation."""

import asyncio
import textwrap
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import ClassVar, NamedTuple

from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.widgets import OptionList
from textual.widgets.option_list import Option

from capture_app.common.address import DEFAULT_PORT
from capture_app.common.camera_facts import CameraListing
from capture_app.common.errors import SimulshotError
from capture_app.common.plugins import COMMANDS, plugin_names
from capture_app.common.text import count, printable
from capture_app.machine.cameras import list_cameras
from capture_app.protocol.orders import (
    FLAT_SCENES,
    MAX_NODES,
    VIEWS,
    AddCamera,
    AddSimulated,
    InvitePhone,
    Order,
    PhoneInvited,
)
from capture_app.rig.rig_link import RigLink
from capture_app.tui.rig.guide_screens import (
    INVITE,
    PHONE_STEPS,
    GuideScreen,
    invite_machine,
    joining_line,
    joining_place,
    show_codes,
)
from capture_app.tui.rig_record import ActionFailed, SessionsRequested, showing_errors
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.lines import Lines

TITLE_WIDTH = 26
"""Cells of a title; leaves space for the code beside the list in a narrow terminal."""
CAMERA_KEYS = "cefgmpuvwxyz"
"""Keys of detected cameras; the other letters belong to the fixed choices."""
QUICK = "drops=0,scale=0.75,samples=1"
"""Options of simulated cameras: smaller images of one ray a pixel are there in a quarter of the time."""
MAX_WIDTH, MARGIN = 96, 8
"""Width of the panel in a wide terminal, and margin beside its text, in cells."""
CHOICE, CAMERAS, SCENE = "start.choice", "start.cameras", "start.scene"
"""Names under which choices are stored."""


class _Choice(NamedTuple):
    """Entry of the list: key, title, explanation and action."""

    name: str
    key: str
    title: str
    what: str
    do: Callable[[], object]
    is_usable: bool = True


class StartPanel(Vertical):
    """Offers local cameras, other machines, a simulated rig and sessions; stores the last choice."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("i", "invite", "Invite", id="start.invite", tooltip="how another machine joins"),
        Binding(
            "h", "phones", "Phones", show=False, id="start.phones", tooltip="phones as cameras, by a QR code"
        ),
        Binding("s", "simulate", "Simulate", id="start.simulate", tooltip="start cameras of a scene"),
        Binding("plus,equals_sign,right", "more(1)", "More cameras", key_display="+", id="start.more"),
        Binding("minus,left", "more(-1)", "Fewer", key_display="-", id="start.fewer"),
        Binding("N", "scene", "Scene", id="start.scene", tooltip="what simulated cameras see"),
        Binding("O", "open('sessions')", "Sessions", id="start.sessions", tooltip="takes on disk"),
        Binding(
            "S",
            "open('samples')",
            "Samples",
            show=False,
            id="start.samples",
            tooltip="takes that come with simulshot",
        ),
        Binding("r", "rescan", "Again", id="start.rescan", tooltip="search this machine for cameras"),
    ]

    def __init__(
        self, source: RigLink, settings: Settings, sessions: Path, samples: Path | None, *, local: bool
    ) -> None:
        """`samples`: the folder of sample sessions, if any."""
        self._source = source
        self._settings = settings
        self._sessions, self._samples = sessions, samples
        self._local = local
        self._found: list[CameraListing] = []
        self._saved_count = 0
        """Number of sessions in the folder."""
        self._leader = ""
        self._busy = ""
        self._title = Lines(id="start-title")
        self._list = OptionList(id="start-list")
        self._meaning = Lines(id="start-meaning")
        self._line = Lines(id="start-line")
        middle = Vertical(self._title, self._list, self._meaning, id="start-middle")
        super().__init__(Vertical(middle, self._line, id="start-box"), id="start")

    def on_mount(self) -> None:
        """Show the list and search for cameras."""
        self._title.show([Content.styled("Add cameras", "bold $primary")])
        self._offer()
        self.action_rescan()

    def focus_first(self) -> None:
        """Focus the list, and look what is here now."""
        self._list.focus()
        self.action_rescan()

    def show_leader(self, leader: str) -> None:
        """Show the address at which other machines reach the leader."""
        if leader != self._leader:
            self._leader = printable(leader)
            self._explain()

    # Choices

    def _offer(self, selected: str = "") -> None:
        """Fill the list, with the last choice first, and select a choice; by default the one selected now."""
        last = self._settings.recall(CHOICE, "")
        if not selected and self._list.highlighted:  # the user has moved the cursor
            selected = self._chosen
        options = [
            Option(
                Content.assemble(
                    (f" {one.key} ", "bold $primary"),
                    " ",
                    Content(printable(one.title)).truncate(TITLE_WIDTH, ellipsis=True),
                    ("  last time" if one.name == last else "", "italic $secondary"),
                ),
                id=one.name,
                disabled=not one.is_usable,
            )
            for one in sorted(self._choices(), key=lambda one: one.name != (last or self._for_newcomers))
        ]
        self._list.set_options(options)
        self._list.highlighted = next((at for at, one in enumerate(options) if one.id == selected), 0)

    def _choices(self) -> Iterator[_Choice]:
        for key, camera in zip(CAMERA_KEYS, self._found, strict=False):
            yield _Choice(
                camera.spec,
                key,
                f"{camera.model or camera.kind} {Path(camera.spec).name}",
                f"{camera.spec}: {camera.detail}",
                partial(self._start_camera, camera),
                is_usable=camera.usable,
            )
        yield _Choice(
            "invite",
            "i",
            "Invite other machines",
            "Shows a pairing code. Run the command below on the other machine and enter the code.",
            self.action_invite,
        )
        if "phones" in plugin_names(COMMANDS):
            yield _Choice(
                "phones",
                "h",
                "Phones by a QR code",
                "A phone scans a QR code and becomes a camera while the page is open in its browser.",
                self.action_phones,
            )
        yield _Choice(
            "simulated",
            "s",
            f"Try {count(self._cameras, 'simulated camera')}",
            f"Each camera is a process whose clock is hours off. They see the scene “{self.scene}”. "
            f"+ and - change their number, up to its {len(VIEWS[self.scene])} views, N the scene"
            + (f" (“{FLAT_SCENES[0]}” has {MAX_NODES})." if self.scene not in FLAT_SCENES else "."),
            self.action_simulate,
        )
        if self._saved_count:
            yield _Choice(
                "sessions",
                "O",
                f"Open {count(self._saved_count, 'session')}",
                f"Takes in {self._sessions}: view, verify, compare and export them.",
                partial(self.action_open, "sessions"),
            )
        if self._samples:
            yield _Choice(
                "samples",
                "S",
                "Browse the samples",
                f"Takes of simulated cameras, in {self._samples}.",
                partial(self.action_open, "samples"),
            )

    @property
    def _for_newcomers(self) -> str:
        """Choice that comes first where nothing was chosen yet: without a camera, what needs none."""
        return "" if self._found or self._saved_count else "simulated"

    @property
    def _chosen(self) -> str:
        option = self._list.highlighted_option
        return "" if option is None else option.id or ""

    @property
    def _cameras(self) -> int:
        return min(max(self._settings.recall(CAMERAS, 5), 1), len(VIEWS[self.scene]))

    @property
    def scene(self) -> str:
        """Scene of simulated cameras, as last chosen."""
        scene = self._settings.recall(SCENE, "")
        return scene if scene in VIEWS else next(iter(VIEWS))

    def _explain(self) -> None:
        if not self.is_attached:
            return
        words = next((one.what for one in self._choices() if one.name == self._chosen), "")
        width, style = max(min(self.size.width, MAX_WIDTH) - MARGIN, 20), "$foreground-muted"
        if self._busy:
            words, style = self._busy, "$warning"
        self._meaning.show(Content.styled(each, style) for each in textwrap.wrap(printable(words), width))
        said = [joining_place(self._leader)] if self._leader else []
        if self._leader and not self._leader.endswith(f":{DEFAULT_PORT}"):
            said.insert(0, f"The port differs from the default, {DEFAULT_PORT}.")
        line = f"  {joining_line(self._leader) if self._leader else '…'}"
        muted = (Content.styled(each, "$foreground-muted") for each in said)
        rows = Content.styled(line, "bold $secondary").wrap(self._line.size.width or width)
        self._line.show([*muted, *rows])

    on_option_list_option_highlighted = _explain

    on_resize = _explain

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer phones only where their companion is installed."""
        return action != "phones" or action in plugin_names(COMMANDS)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Run the selected entry's action."""
        for one in self._choices():
            if one.name == event.option_id:
                one.do()

    def on_key(self, event: events.Key) -> None:
        """Start the camera whose key was pressed."""
        for key, camera in zip(CAMERA_KEYS, self._found, strict=False):
            if event.character == key and camera.usable:
                event.stop()
                self._start_camera(camera)

    def action_invite(self) -> None:
        """Show how other machines join."""
        self._choose("invite")
        self.app.push_screen(
            GuideScreen(INVITE, "Another machine", 36, partial(invite_machine, self._source, self._leader))
        )

    def action_phones(self) -> None:
        """Show how phones become cameras."""
        self._choose("phones")
        # The server of their page keeps running when the dialog is closed.
        ask = partial(self._source.ask, InvitePhone(), PhoneInvited)
        self.app.push_screen(
            GuideScreen("phones", "Phones as cameras", 36, partial(show_codes, ask, PHONE_STEPS))
        )

    def action_simulate(self) -> None:
        """Start simulated cameras."""
        self._start(
            "simulated",
            AddSimulated(cameras=self._cameras, scene=self.scene, options=QUICK),
            f"Starting {count(self._cameras, 'simulated camera')} …",
        )

    def action_more(self, step: int) -> None:
        """Change the number of simulated cameras, or say which scene has views for more."""
        if step > 0 and self._cameras == len(VIEWS[self.scene]):
            self.app.notify(
                f"“{self.scene}” has no more views; N: the scene. “{FLAT_SCENES[0]}” has {MAX_NODES}"
            )
        self._settings.remember(CAMERAS, min(max(self._cameras + step, 1), len(VIEWS[self.scene])))
        self._offer("simulated")

    def action_scene(self) -> None:
        """Switch to the next scene of the simulated cameras."""
        scenes = list(VIEWS)
        self._settings.remember(SCENE, scenes[(scenes.index(self.scene) + 1) % len(scenes)])
        self._offer("simulated")

    def action_open(self, choice: str) -> None:
        """Show the sessions of the sessions folder, or the samples if there are any."""
        folder = self._samples if choice == "samples" else self._sessions
        if folder is not None:
            self._settings.remember(CHOICE, choice)
            self.post_message(SessionsRequested(folder))

    def _choose(self, choice: str) -> None:
        self._settings.remember(CHOICE, choice)
        self._list.highlighted = self._list.get_option_index(choice)
        self._explain()

    def _start_camera(self, camera: CameraListing) -> None:
        self._start(camera.spec, AddCamera(spec=camera.spec), f"Starting {camera.spec} …")

    @work(exclusive=True, group="offers")
    async def action_rescan(self) -> None:
        """Search for cameras and sessions again."""
        with showing_errors(self):
            found = await asyncio.to_thread(list_cameras, simulated=False) if self._local else []
            selected = len(list(self._sessions.glob("*/session.json")))
            if (found, selected) != (self._found, self._saved_count):
                self._found, self._saved_count = found, selected
                self._offer()

    @work(group="start")
    async def _start(self, choice: str, order: Order, words: str) -> None:
        self._settings.remember(CHOICE, choice)
        self.say_busy(words)
        try:
            await self._source.order(order)
            # Shown until the cameras join; their list then replaces this panel.
            words += " Cameras join within half a minute."
        except SimulshotError as error:
            self.post_message(ActionFailed(error))
            words = str(error)  # a message of some seconds is easily missed
        self.say_busy(words)

    def say_busy(self, words: str) -> None:
        """Show the activity in progress; with an empty text, the explanations again."""
        self._busy = words
        self._explain()
