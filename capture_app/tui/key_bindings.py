"""Actions with keys, under their names in keys.toml, and the help screen made from the bindings."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.content import Content
from textual.dom import DOMNode
from textual.widgets import Static

from capture_app.common.grouping import grouped
from capture_app.tui.question import BoxDialog
from capture_app.tui.screen_settings import KEYS_FILE
from capture_app.tui.widgets.lines import Lines

OWN = "capture_app."
EVERYWHERE = "app"
KEY_WIDTH, NAME_WIDTH = 9, 22
TERMS = {
    "leader": "program whose clock is the rig's time; it saves the takes",
    "syncing": "a camera measures its clock",
    "aligning": "a camera moves its frames onto the instants",
    "instant": "a common time at which every camera takes a frame",
    "burst": "frames at successive instants, saved as a session's folder",
    "phase": "time from the rig's common frame times to a camera's frames",
    "error": "uncertainty (95 %) of a camera's frame times",
    "degraded": "synchronized, but less accurately than requested",
    "drops": "frames that a camera did not deliver",
    "↔": "spread: time from the first to the last image of an instant",
    "late": "an image off its instant by more than the tolerance",
    "exposure": "also gain, white balance, focus: enter on a camera, then X",
    "calibrate": "capture-app coverage, a burst, then reconstruct calibrate",
    "fps": "the rate of a recording, or fps=60 in a camera's SPEC",
    "★": "best synchronized take, of those that lack no image",
}
"""Words that a newcomer may not know, or look for in vain on the screen."""


def known_actions() -> dict[str, Binding]:
    """Return all actions of this package's imported screens and widgets, with their built-in keys."""
    found = (
        (binding.id, binding)
        for kind in _subclasses(DOMNode)
        if kind.__module__.startswith(OWN)
        for binding in kind.__dict__.get("BINDINGS", ())
        if isinstance(binding, Binding) and binding.id is not None
    )
    return dict(sorted(found, key=itemgetter(0)))


def unknown_names(names: Iterable[str]) -> list[str]:
    """Return the names that are not actions."""
    return sorted(set(names) - known_actions().keys())


def keys_file_text() -> str:
    """Return the text of a keys.toml that lists all actions, commented out."""
    lines = [
        "# Keys of capture-app's screen. Remove the # at the start of a line and change its key;",
        '# write several as "x,space". Key names are Textual\'s: enter, f2, ctrl+a.',
    ]
    for room, actions in groupby(known_actions().items(), key=lambda item: item[0].partition(".")[0]):
        lines += ["", f"# {room}"]
        lines += [f'# "{name}" = "{one.key}"'.ljust(44) + f"# {one.description}" for name, one in actions]
    return "\n".join(lines) + "\n"


def _subclasses(kind: type[DOMNode]) -> Iterator[type[DOMNode]]:
    for each in kind.__subclasses__():
        yield each
        yield from _subclasses(each)


class HelpScreen(BoxDialog[bool]):
    """Help over the current screen. Returns whether to write a keys.toml."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark", "dismiss", "Back", id="help.back"),
        Binding("W", "dismiss(True)", "Write keys.toml", id="help.write"),
    ]

    def __init__(self, actions: Sequence[Binding], key_names: dict[str, str], folder: str, log: str) -> None:
        """`actions`: bindings of the screen below; `key_names`: display names of keys.

        `folder`: the folder of keys.toml; empty if settings are not stored. `log`: the rig's log file, if it
        is on this machine.
        """
        rows = Lines(id="help-keys")
        rows.show(_rows(actions, key_names))
        words = ["esc closes; tab moves the focus; ctrl+p finds an action by a few letters."]
        if folder:
            words.append(f"W writes {KEYS_FILE} to {folder}; change keys there.")
        if log:
            words.append(f"The rig's log: {log}")
        super().__init__("keys", VerticalScroll(rows), Static(Content("\n".join(words)), id="help-foot"))


def _rows(actions: Sequence[Binding], key_names: dict[str, str]) -> list[Content]:
    # One line per action, with all of its keys; the app-wide actions come last.
    by_name = grouped(
        (binding.id, binding) for binding in actions if binding.id is not None and binding.description
    )
    rooms: dict[str, list[Content]] = {}
    for name, found in by_name.items():
        keys = " ".join(dict.fromkeys(key_names.get(each.key, each.key) for each in found))
        rooms.setdefault(name.partition(".")[0], []).append(
            Content.assemble(
                (f"{keys:<{KEY_WIDTH}} ", "bold $primary"),
                f"{found[0].description:<{NAME_WIDTH}}",
                (found[0].tooltip, "$foreground-muted"),
            )
        )
    rows: list[Content] = []
    for room in sorted(rooms, key=lambda room: room == EVERYWHERE):
        title = Content.styled("everywhere" if room == EVERYWHERE else room, "bold $secondary")
        rows += [Content(""), title, *rooms[room]]
    rows += [Content(""), Content.styled("words", "bold $secondary")]
    rows += [Content.assemble((f"{term:<{KEY_WIDTH}} ", "bold"), what) for term, what in TERMS.items()]
    return rows[1:]
