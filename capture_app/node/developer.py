"""Develops a node's picked frames one after the other, into its spool where there is room."""

import asyncio
import contextlib
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from capture_app.cameras.base import CapturedFrame
from capture_app.errors import SimulshotError
from capture_app.node.develop import DevelopError, develop, without
from capture_app.node.spool import Spool
from capture_app.node.work import BurstWork, Developed
from capture_app.session.manifest import MissingImage
from capture_app.sync.trigger import Pick

LOW_PRIORITY = 10
"""Niceness of the thread that develops pictures: the clock exchange comes first."""


class Developer:
    """One thread that turns frames into image files; without a spool they stay in memory."""

    def __init__(self, talk: Callable[[str], None], spool: Spool | None) -> None:
        self.image_bytes = 0
        """Size of the newest image."""
        self._talk = talk
        self._spool = spool
        self._thread = ThreadPoolExecutor(1, "develop", initializer=_lower_priority)

    async def develop_next(self, work: BurstWork) -> None:
        """Develop the first frame of a burst that has one, and move it to its images."""
        loop = asyncio.get_running_loop()
        pick = work.picks[0]
        try:
            developed = await loop.run_in_executor(self._thread, self._develop, work, pick)
        except DevelopError as error:
            lost = MissingImage(camera=work.report.camera.name, instant=pick.instant, reason=str(error))
            work.report = without(work.report, lost)
            self._talk(f"burst {work.report.burst}: instant {pick.instant} is lost: {error}")
            developed = None
        # While it was developed, the leader may have refused the burst.
        if work.picks and work.picks[0] is pick:
            work.picks.popleft()
            if developed is not None:
                work.images.append(developed)

    def close(self) -> None:
        """Develop nothing more."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _develop(self, work: BurstWork, pick: Pick[CapturedFrame]) -> Developed:
        upload, data = develop(work.report, pick)
        self.image_bytes = len(data)
        if self._spool is None or not work.spooling:
            return Developed(upload, data)
        try:
            if work.spooled is None:
                work.spooled = self._spool.begin(work.report)
            work.spooled.keep(upload, data)
        except SimulshotError as error:
            work.spooling = False
            self._talk(f"burst {work.report.burst} is kept in memory until the leader has it: {error}")
            return Developed(upload, data)
        return Developed(upload, None)


def _lower_priority() -> None:
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)
