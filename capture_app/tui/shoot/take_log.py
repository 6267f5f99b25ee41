"""The takes that the screen has heard of, whoever ordered them."""

from capture_app.node.wire.messages import BurstRequest
from capture_app.node.wire.status import BurstStatus
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.shoot.take import Take

MOST_TAKES = 100


class TakeLog:
    """Takes by the name of their session, the newest last."""

    def __init__(self) -> None:
        self.takes: list[Take] = []

    @property
    def newest(self) -> Take | None:
        """The take that was ordered last."""
        return self.takes[-1] if self.takes else None

    @property
    def latest_ordered(self) -> Take | None:
        """The last take that was ordered on this screen."""
        return next((take for take in reversed(self.takes) if take.request is not None), None)

    def of_sheet(self, sheet: TakeSheet | None) -> Take | None:
        """The take that a sheet shows."""
        return next((take for take in self.takes if take.judged and take.judged.sheet is sheet), None)

    def is_newer(self, take: Take, than: Take | None) -> bool:
        """Whether a take was ordered after another, or there is no other."""
        return than is None or self.takes.index(take) > self.takes.index(than)

    def note(
        self, status: BurstStatus, request: BurstRequest | None, now_s: float, retake_of: str = ""
    ) -> Take | None:
        """Note how far a burst is at `now_s`; return its take where that is news.

        It is told twice: by the answer to the request, which is known then, and by the rig's status.
        """
        take = next((take for take in self.takes if take.name == status.name), None)
        if take is None:
            take = Take(
                status,
                request,
                is_new=not status.done or request is not None,
                begun_s=now_s,
                retake_of=retake_of,
            )
            self.takes = [*self.takes, take][-MOST_TAKES:]
            return take
        take.request, take.retake_of = request or take.request, retake_of or take.retake_of
        if take.status.done or status == take.status:
            return None
        take.status = status
        return take
