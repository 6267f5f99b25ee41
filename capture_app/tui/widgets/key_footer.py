"""Footer with the keys that are available here."""

from dataclasses import replace

from textual.binding import Binding
from textual.content import Content
from textual.screen import Screen
from textual.style import Style

from capture_app.tui.widgets.lines import Lines

FIRST = ("start",)
"""Actions shown before all others: the remedy of a lost leader."""
ALWAYS = ("quit", "help")
"""Actions always shown, at the right: quit, and help with all keys."""


class KeyFooter(Lines):
    """Line of context keys; a click presses the key."""

    DEFAULT_CSS = "KeyFooter { dock: bottom; height: 1; background: $panel; color: $foreground; }"

    def on_mount(self) -> None:
        """Subscribe to changes of the screen's keys."""
        self.screen.bindings_updated_signal.subscribe(self, self._show)

    def on_resize(self) -> None:
        """Show the keys that fit the new width."""
        self._show(self.screen)

    def _show(self, screen: Screen[object]) -> None:
        # With eager tasks (Python 3.12 on), a screen exists before the stack by which its keys are resolved.
        if not self.is_attached or screen is not self.screen or not screen.is_current:
            return
        shown: dict[str, Binding] = {}
        for node, binding, enabled, _ in screen.active_bindings.values():
            if binding.show and enabled:
                # A view may name what its key does now.
                describe = getattr(node, "describe_key", None)
                words = (describe and describe(binding.action)) or binding.description
                shown.setdefault(binding.action, replace(binding, description=words))
        right = Content("").join(self._item(shown.pop(action)) for action in ALWAYS if action in shown)
        room, line = self.size.width - right.cell_length, Content("")
        for binding in sorted(shown.values(), key=lambda binding: binding.action not in FIRST):
            item = self._item(binding)
            if line.cell_length + item.cell_length > room:
                # The remaining keys are listed in the help, whose key follows. A full line ends with a space.
                line = line[: room - 1] + "…"
                break
            line += item
        self.show([line.pad_right(room - line.cell_length) + right])

    def _item(self, binding: Binding) -> Content:
        return Content.assemble(
            (f" {self.app.get_key_display(binding)}", "bold $primary"),
            (f" {binding.description} ", "$foreground"),
        ).stylize(Style.from_meta({"@click": f"app.simulate_key('{binding.key}')"}))
