"""The actions that have keys, in all screens that are known, by the names that keys.toml uses."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from textual.binding import Binding
from textual.dom import DOMNode

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
