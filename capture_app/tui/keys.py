"""Keys by name, and their help.

The actions that have keys, in all screens that are known, by the names that keys.toml uses.

All keys that do something here, made from the bindings themselves.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.dom import DOMNode
from textual.message import Message
from textual.screen import ModalScreen
from textual.widgets import Static

from capture_app.tui.question import Dialog
from capture_app.tui.settings import KEYS_FILE
from capture_app.tui.widgets.lines import Lines

OWN = "capture_app."


@dataclass(frozen=True, slots=True)
class KeyAction:
    """An action with its keys as the program has them before anybody changes them."""

    id: str
    """Its name in keys.toml, such as shoot.take."""
    keys: str
    """As keys.toml writes them: "space", or "delete,d"."""
    description: str

    @property
    def room(self) -> str:
        """The part of the name before the dot: where the action belongs."""
        return self.id.partition(".")[0]


def known_actions() -> tuple[KeyAction, ...]:
    """All actions of our own screens and widgets that have been imported, by name."""
    found: dict[str, KeyAction] = {}
    for kind in _subclasses(DOMNode):
        if kind.__module__.startswith(OWN):
            for binding in kind.__dict__.get("BINDINGS", ()):
                if isinstance(binding, Binding) and binding.id is not None:
                    found[binding.id] = KeyAction(binding.id, binding.key, binding.description)
    return tuple(found[name] for name in sorted(found))


def unknown_names(names: Iterable[str]) -> list[str]:
    """Those that are no action's."""
    known = {action.id for action in known_actions()}
    return sorted(set(names) - known)


def keys_file_text() -> str:
    """A keys.toml of all actions, none of them changed yet."""
    lines = [
        "# Keys of capture-app's screen. Take away the # before a line and change its key;",
        '# more than one is written "x,space". Names are those of Textual: enter, f2, ctrl+a.',
    ]
    room = ""
    for action in known_actions():
        if action.room != room:
            room = action.room
            lines += ["", f"# {room}"]
        lines.append(f'# "{action.id}" = "{action.keys}"'.ljust(44) + f"# {action.description}")
    return "\n".join(lines) + "\n"


def _subclasses(kind: type[DOMNode]) -> Iterator[type[DOMNode]]:
    for each in kind.__subclasses__():
        yield each
        yield from _subclasses(each)


EVERYWHERE = "app"
KEY_WIDTH, NAME_WIDTH = 16, 22


class HelpScreen(Dialog[None], ModalScreen[None]):
    """A page over the screen; Escape leads back."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark", "leave", "Back", id="help.back"),
        Binding("w", "write", "Write keys.toml", id="help.write"),
    ]
    DEFAULT_CSS = """
    HelpScreen { align: center middle; background: $background 60%; }
    HelpScreen > Vertical {
        width: 76; max-width: 96%; height: auto; max-height: 92%; padding: 0 2;
        background: $panel; border: round $primary; border-title-color: $primary; border-title-style: bold;
    }
    HelpScreen VerticalScroll { height: auto; scrollbar-size-vertical: 1; }
    HelpScreen #help-foot { height: auto; dock: bottom; padding: 1 0 0 0; color: $foreground-muted; }
    HelpScreen #help-keys { margin-bottom: 3; }
    """

    class WriteKeys(Message):
        """The user wants a file in which to change keys."""

    def __init__(self, actions: Sequence[Binding], key_names: dict[str, str], folder: str) -> None:
        """`actions` are those of the screen that help is asked for; `key_names`: how keys are shown.

        `folder` is where keys.toml belongs; empty where nothing is kept.
        """
        super().__init__()
        self._actions = tuple(actions)
        self._names = key_names
        self._folder = folder

    def compose(self) -> ComposeResult:
        """The keys, and how to change them."""
        box = Vertical(VerticalScroll(Lines(id="help-keys")), Static(id="help-foot"))
        box.border_title = "keys"
        yield box

    def on_mount(self) -> None:
        """Fill it."""
        self.query_one("#help-keys", Lines).show(self._rows())
        words = ["esc closes; tab goes around; ctrl+p finds an action by a few letters."]
        if self._folder:
            words.append(f"w writes {KEYS_FILE} to {self._folder}: keys are changed there.")
        self.query_one("#help-foot", Static).update(Content("\n".join(words)))

    def action_leave(self) -> None:
        """Go back."""
        self.dismiss(None)

    def action_write(self) -> None:
        """Ask for the file of keys."""
        if self._folder:
            self.app.post_message(self.WriteKeys())
        self.dismiss(None)

    def _rows(self) -> list[Content]:
        # One line for each action, with all of its keys; what holds everywhere comes last.
        actions: dict[str, list[Binding]] = {}
        for binding in self._actions:
            if binding.id is not None and binding.description:
                actions.setdefault(binding.id, []).append(binding)
        rooms: dict[str, list[Content]] = {}
        for name, found in actions.items():
            keys = " ".join(dict.fromkeys(self._names.get(each.key, each.key) for each in found))
            row = Content.assemble(
                (f"{keys:<{KEY_WIDTH}} ", "bold $primary"),
                f"{found[0].description:<{NAME_WIDTH}}",
                (found[0].tooltip, "$foreground-muted"),
            )
            rooms.setdefault(name.partition(".")[0], []).append(row)
        rows: list[Content] = []
        for room in sorted(rooms, key=lambda room: room == EVERYWHERE):
            title = "everywhere" if room == EVERYWHERE else room
            rows += [Content(""), Content.styled(title, "bold $secondary"), *rooms[room]]
        return rows[1:]
