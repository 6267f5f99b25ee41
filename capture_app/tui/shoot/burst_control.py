"""What ends a take: the key that takes a burst back, ahead or being saved, and the end of a recording."""

from collections.abc import Awaitable
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType

from capture_app.errors import SimulshotError
from capture_app.node.wire.status import RigStatus
from capture_app.text import clock_offset, count
from capture_app.tui.messages import Mishap
from capture_app.tui.mode import ModeView
from capture_app.tui.question import CANCEL, Answer, Question
from capture_app.tui.rig_source import RigSource

MOST_ANSWERS = 9
"""As many as there are keys for."""


class BurstControl(ModeView):
    """A mode in which bursts can be cancelled, and recordings ended."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "x",
            "cancel_burst",
            "Cancel a burst",
            id="shoot.cancel",
            show=False,
            tooltip="ahead, or being saved",
        ),
    ]
    _rig: RigSource
    _status: RigStatus | None

    def action_cancel_burst(self) -> None:
        """Ask which burst to cancel, and cancel it."""
        offers = {} if self._status is None else cancellable_bursts(self._status)
        if not offers:
            self.notify("no burst lies ahead, and none is being saved")
            return
        answers = [
            Answer(str(burst), str(key), words)
            for key, (burst, words) in enumerate(list(offers.items())[:MOST_ANSWERS], 1)
        ]

        def cancel(answer: str | None) -> None:
            if answer is not None:
                self._order(self._rig.cancel_burst(int(answer)))

        text = "What has come of it already is saved."
        self.app.push_screen(Question(text, [*answers, CANCEL], title="Cancel a burst"), cancel)

    def end_recording(self) -> bool:
        """End the recording that is under way; whether there is one."""
        newest = None if self._status is None else self._status.burst
        if newest is None or not newest.recording or newest.done:
            return False
        self._order(self._rig.end_burst(newest.burst))
        return True

    @work(group="orders")
    async def _order(self, order: Awaitable[None]) -> None:
        try:
            await order
        except SimulshotError as error:
            self.post_message(Mishap(error))


def cancellable_bursts(status: RigStatus) -> dict[int, str]:
    """The bursts that can be cancelled, by number, in words: the one being saved, then those ahead."""
    offers = {}
    newest = status.burst
    ahead = sorted(status.ahead, key=lambda burst: burst.first_leader_ns)
    if newest is not None and newest.burst and not newest.done:
        offers[newest.burst] = f"{newest.name}: {newest.received} of {newest.expected} images are here"
    for burst in ahead:
        begins = clock_offset(max(0, burst.first_leader_ns - status.now_ns), signed=False)
        offers[burst.burst] = f"{burst.name}: begins in {begins}, {count(burst.instants, 'frame')}"
    return offers
