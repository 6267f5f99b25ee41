"""Faults that are put into the product, to show that seeds find their like."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any
from unittest.mock import patch

from capture_app.node.burst.camera_delivery import CameraDelivery
from capture_app.node.camera import uploader
from capture_app.session.format.burst_plan import CameraPlan
from tests.virtual.world import World


@contextlib.contextmanager
def _without_sync(world: World) -> Iterator[None]:
    """The leader does not sync a session's journal."""
    world.disks.ignored_sync = lambda path: path.startswith("lead") and path.endswith("journal.ndjson")
    yield


def _without_retry(_: World) -> AbstractContextManager[Any]:
    """A node whose stream breaks off waits for ever before it opens another one."""
    return patch.object(uploader.Uploader.__init__, "__kwdefaults__", {"retry_s": (1e6,), "trust": None})


def _with_stale_reports(_: World) -> AbstractContextManager[Any]:
    """A report that says nothing new counts as progress of its camera."""
    note = CameraDelivery.note_report

    def note_any(delivery: CameraDelivery, plan: CameraPlan, now_ns: int) -> None:
        note(delivery, plan, now_ns)
        delivery.since_ns = max(delivery.since_ns, now_ns)

    return patch.object(CameraDelivery, "note_report", note_any)


def _without_timeouts(_: World) -> AbstractContextManager[Any]:
    """A leader waits for ever for a camera that sends nothing."""
    return patch.object(CameraDelivery, "why_silent", lambda *_, **__: "")


PLANTED: dict[str, Callable[[World], AbstractContextManager[Any]]] = {
    "sync": _without_sync,
    "retry": _without_retry,
    "stale": _with_stale_reports,
    "timeout": _without_timeouts,
}
"""Faults by name; each docstring says what is wrong."""
