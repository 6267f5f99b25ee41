"""Header with the modes and their keys, the rig's state and address, and free disk space."""

from collections.abc import Iterator

from textual import events
from textual.content import Content

from capture_app.common.text import count, printable
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.signs import NO_LEADER, WAITING, rig_sign
from capture_app.tui.widgets.lines import Lines, fitting, justified

MODES = {"rig": "Rig", "shoot": "Shoot", "sessions": "Sessions", "jobs": "Jobs"}
"""Titles by mode, in the order of their keys 1 to 4."""


class Header(Lines):
    """Mode tabs, which can be clicked, and as much of the rig's state as fits."""

    def __init__(self, mode: str, record: RigRecord) -> None:
        super().__init__(id="header")
        self._record = record
        tabs = [
            Content.assemble(
                (f" {number} ", "bold $primary" if name != mode else "reverse bold $primary"),
                (f"{title} ", "$foreground" if name != mode else "reverse bold $primary"),
            )
            for number, (name, title) in enumerate(MODES.items(), 1)
        ]
        self._tabs = Content("").join(tabs)

    def on_click(self, event: events.Click) -> None:
        """Switch to the mode that was clicked."""
        left = 0
        for number, (mode, title) in enumerate(MODES.items(), 1):
            left += len(f" {number} {title} ")
            if event.x < left:
                self.app.switch_mode(mode)
                return

    def draw(self) -> None:
        """Draw the rig's state or the loss of its leader, most important part first."""
        parts = fitting(self._parts(), " · ", self.size.width - self._tabs.cell_length - 4)
        self.show([justified(self._tabs, Content(" · ").join(parts[::-1]) + " ", self.size.width)])

    on_resize = draw

    def _parts(self) -> Iterator[Content]:
        status = self._record.status
        sign = NO_LEADER if self._record.lost else WAITING if status is None else rig_sign(status)
        yield Content.styled(str(sign), f"bold {sign.style}")
        if status is None:
            return
        if status.is_open:
            yield Content.styled("OPEN: no pairing", "$warning")
        if present := [phone for phone in status.app_phones if phone.state != "lost"]:
            synced = sum(phone.state == "synced" for phone in present)
            words = f"{synced} of {count(len(present), 'app phone')} synchronized"
            yield Content.styled(words, "$warning")
        free = status.disk_free_bytes
        if free is not None:
            low = free < 2e9
            words = f"{'! ' if low else ''}{free / 1e9:.0f} GB free"
            yield Content.styled(words, "$error" if low else "")
        yield Content.styled(printable(status.leader), "$foreground-muted")
        if status.period_ns:
            yield Content.styled(f"{1e9 / status.period_ns:.3g} fps", "$foreground-muted")
