"""All other programs that follow a leader, started and closed with it."""

from collections.abc import Callable

from capture_app.clock import NodeClock
from capture_app.interop.app_leader import AppPhoneStatus
from capture_app.interop.app_phones import AppNews, AppPhones, Take
from capture_app.interop.rpicam import RpicamSync, SharedGrid
from capture_app.node.wire.messages import BurstRequest
from capture_app.sync.phase.goal import Goal


class Guests:
    """Those that a user has asked for; none by default."""

    def __init__(self, app_phones: AppPhones | None = None, rpicam: RpicamSync | None = None) -> None:
        self._app_phones, self._rpicam = app_phones, rpicam

    def start(
        self, clock: NodeClock, on_news: Callable[[AppNews], None], goal: Callable[[], Goal | None]
    ) -> None:
        """Lead them; `goal` returns the rig's grid. Raises NetworkError where a port of theirs is in use."""
        if self._app_phones is not None:
            self._app_phones.start(clock, on_news)
        if self._rpicam is not None:
            self._rpicam.start(clock, lambda: None if (grid := goal()) is None else SharedGrid(grid))

    async def close(self) -> None:
        """Let them go."""
        if self._app_phones is not None:
            await self._app_phones.close()
        if self._rpicam is not None:
            await self._rpicam.close()

    def app_phones(self) -> tuple[AppPhoneStatus, ...]:
        """The phones with the app that are or were here lately."""
        return () if self._app_phones is None else self._app_phones.statuses()

    def set_exposure(self, exposure_ns: int, iso: int) -> None:
        """Have phones with the app expose so."""
        if self._app_phones is not None:
            self._app_phones.set_exposure(exposure_ns, iso)

    def take_alone(self, request: BurstRequest) -> str:
        """Have them take it in a rig without a camera; return what was told whom, empty where nobody is here.

        Raises BadInputError for a recording without an end.
        """
        return "" if self._app_phones is None else self._app_phones.take_alone(request)

    def take_part(self, take: Take) -> None:
        """Have those that can take their part of a burst."""
        if self._app_phones is not None:
            self._app_phones.take_part(take)
