"""Faults that are put into the product, to show that seeds find their like."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

from msgspec.structs import replace

from capture_app.node.burst.camera_delivery import CameraDelivery
from capture_app.node.burst.resumed_bursts import ResumedBursts
from capture_app.node.camera import uploader
from capture_app.node.leader.bursts import ActiveBursts
from tests.virtual.world import World


@contextlib.contextmanager
def _in_place_of(module: Any, name: str, value: Any) -> Iterator[None]:
    real = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, real)


@contextlib.contextmanager
def _without_sync(world: World) -> Iterator[None]:
    """The leader does not sync a session's journal."""
    world.disks.ignored_sync = lambda path: path.startswith("lead") and path.endswith("journal.ndjson")
    yield


def _without_retry(_: World) -> AbstractContextManager[None]:
    """A node whose stream breaks off waits for ever before it opens another one."""
    return _in_place_of(uploader.Uploader.__init__, "__kwdefaults__", {"retry_s": (1e6,), "trust": None})


def _with_stale_reports(_: World) -> AbstractContextManager[None]:
    """A leader takes a report of an earlier run's burst for one of its own."""
    find = ActiveBursts.find_session

    async def find_any(bursts: ActiveBursts, report: Any, pin: str) -> Any:
        if report.burst in bursts._bursts:
            report = replace(report, leader=bursts._engine.config.instance)
        return await find(bursts, report, pin)

    return _in_place_of(ActiveBursts, "find_session", find_any)


@contextlib.contextmanager
def _without_timeouts(_: World) -> Iterator[None]:
    """A leader waits for ever for a camera that sends nothing."""
    with _in_place_of(CameraDelivery, "why_silent", lambda *_, **__: ""):
        yield


def _forgetful(_: World) -> AbstractContextManager[None]:
    """A restarted leader does not resume what was interrupted."""

    async def resume_nothing(bursts: ResumedBursts, *_: Any, **__: Any) -> None:
        bursts._all_resumed.set()

    return _in_place_of(ResumedBursts, "resume_all", resume_nothing)


PLANTED: dict[str, Callable[[World], AbstractContextManager[None]]] = {
    "sync": _without_sync,
    "retry": _without_retry,
    "stale": _with_stale_reports,
    "timeout": _without_timeouts,
    "resume": _forgetful,
}
"""Faults by name; each docstring says what is wrong."""
