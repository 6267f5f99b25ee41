"""The line on top: the modes with their keys, which rig this is, whether it is ready, room on its disk."""

from collections.abc import Iterator

from textual import events
from textual.content import Content

from capture_app.text import count, printable
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.signs import NO_LEADER, WAITING, rig_sign
from capture_app.tui.widgets.lines import Lines

MODES = {"rig": "Rig", "shoot": "Shoot", "sessions": "Sessions", "jobs": "Jobs"}
"""By name, in the order of their keys 1 to 4."""


class Tabs(Lines):
    """The modes with their keys; a click goes to one."""

    def __init__(self, mode: str) -> None:
        super().__init__(id="tabs")
        tabs = [
            Content.assemble(
                (f" {number} ", "bold $primary" if name != mode else "reverse bold $primary"),
                (f"{title} ", "$foreground" if name != mode else "reverse bold $primary"),
            )
            for number, (name, title) in enumerate(MODES.items(), 1)
        ]
        self.show([Content("").join(tabs)])

    def on_click(self, event: events.Click) -> None:
        """Go to the mode that was clicked."""
        left = 0
        for number, (mode, title) in enumerate(MODES.items(), 1):
            left += len(f" {number} {title} ")
            if event.x < left:
                self.app.switch_mode(mode)
                return


class RigLine(Lines):
    """How the rig is, in as many words as there is room for."""

    def __init__(self, record: RigRecord) -> None:
        super().__init__(id="rig-line")
        self._record = record

    def draw(self) -> None:
        """Show the rig as it is now, or that its leader is lost."""
        room = self.size.width - 1
        parts: list[Content] = []
        for part in self._parts():  # the most important first; what does not fit is left out
            if part.cell_length + 3 <= room:
                room -= part.cell_length + 3
                parts.append(part)
        line = Content(" · ").join(parts[::-1])
        self.show([Content(" " * max(self.size.width - line.cell_length - 1, 0)) + line])

    on_resize = draw

    def _parts(self) -> Iterator[Content]:
        status = self._record.status
        sign = NO_LEADER if self._record.lost else WAITING if status is None else rig_sign(status)
        yield Content.styled(str(sign), f"bold {sign.style}")
        if status is None:
            return
        if status.is_open:
            yield Content.styled("OPEN to anybody", "$warning")
        if present := [phone for phone in status.app_phones if phone.state != "lost"]:
            synced = sum(phone.state == "synced" for phone in present)
            words = f"{synced} of {count(len(present), 'app phone')} with the time"
            yield Content.styled(words, "$warning")
        free = status.disk_free_bytes
        if free is not None:
            low = free < 2e9
            words = f"{'! ' if low else ''}{free / 1e9:.0f} GB free"
            yield Content.styled(words, "$error" if low else "")
        yield Content.styled(printable(status.leader), "$foreground-muted")
        if status.period_ns:
            yield Content.styled(f"{1e9 / status.period_ns:.3g} fps", "$foreground-muted")
