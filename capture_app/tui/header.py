"""The line on top: the modes with their keys, which rig this is, whether it is ready, room on its disk."""

from textual import events
from textual.content import Content

from capture_app.node.wire.status import RigStatus
from capture_app.text import printable
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.messages import ModeRequested
from capture_app.tui.states import NO_LEADER, WAITING, rig_sign

MODES = {"rig": "Rig", "shoot": "Shoot", "sessions": "Sessions", "jobs": "Jobs"}
"""By name, in the order of their keys 1 to 4."""


class Header(Lines):
    """One line; a click on a mode goes there."""

    DEFAULT_CSS = "Header { dock: top; height: 1; background: $panel; color: $foreground; }"

    def __init__(self, mode: str) -> None:
        super().__init__(id="header")
        self._mode = mode
        self._status: RigStatus | None = None
        self._lost = ""

    def show_status(self, status: RigStatus) -> None:
        """Show how the rig is."""
        self._status = status
        self._show()

    def show_link(self, reason: str) -> None:
        """Show that the leader does not answer; empty: that it does."""
        self._lost = reason
        self._show()

    def on_resize(self) -> None:
        """Show what there is room for."""
        self._show()

    def on_click(self, event: events.Click) -> None:
        """Go to the mode that was clicked."""
        left = 0
        for number, (mode, title) in enumerate(MODES.items(), 1):
            left += len(f" {number} {title} ")
            if event.x < left:
                self.post_message(ModeRequested(mode))
                return

    def _show(self) -> None:
        tabs = [
            Content.assemble(
                (f" {number} ", "bold $primary" if mode != self._mode else "reverse bold $primary"),
                (f"{title} ", "$foreground" if mode != self._mode else "reverse bold $primary"),
            )
            for number, (mode, title) in enumerate(MODES.items(), 1)
        ]
        left = Content("").join(tabs)
        room = self.size.width - left.cell_length - 1
        parts: list[Content] = []
        for part in self._parts():  # the most important first; what does not fit is left out
            if part.cell_length + 3 <= room:
                room -= part.cell_length + 3
                parts.append(part)
        right = Content(" · ").join(parts[::-1])
        gap = self.size.width - left.cell_length - right.cell_length - 1
        self.show([Content.assemble(left, " " * max(gap, 1), right)])

    def _parts(self) -> list[Content]:
        status = self._status
        sign = NO_LEADER if self._lost else WAITING if status is None else rig_sign(status)
        parts = [Content.styled(str(sign), f"bold {sign.style}")]
        if status is None:
            return parts
        free = status.disk_free_bytes
        if free is not None:
            low = free < 2e9
            parts.append(
                Content.styled(f"{'! ' if low else ''}{free / 1e9:.0f} GB free", "$error" if low else "")
            )
        parts.append(Content.styled(printable(status.leader), "$foreground-muted"))
        if status.period_ns:
            parts.append(Content.styled(f"{1e9 / status.period_ns:.3g} fps", "$foreground-muted"))
        return parts
