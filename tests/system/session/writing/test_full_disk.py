"""Full disks: what was confirmed is never lost, and a session is finished with what it has."""

import errno
import os
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.errors import DiskFullError
from capture_app.session.format.manifest import MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import camera_record
from tests.unit.session.writing.full_take import Take


def test_a_disk_that_is_full_once_at_any_call_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every write, sync, rename and folder fails once for want of room; then it is tried again."""
    names = ("write", "fsync", "fdatasync", "replace", "mkdir", "posix_fallocate")
    real = {name: getattr(os, name) for name in names}
    real["fsync"] = real["fdatasync"] = lambda _: None  # what a sync costs is not at stake here
    step = failed = 0
    while True:
        step += 1
        left = step

        def fail(name: str, *arguments: Any, **options: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                if name == "write":
                    real["write"](arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
                raise OSError(errno.ENOSPC, "No space left on device")
            return real[name](*arguments, **options)

        take = Take(tmp_path / str(step))
        for name in names:
            monkeypatch.setattr(os, name, lambda *a, name=name, **k: fail(name, *a, **k))
        errors = retrying(take)
        monkeypatch.undo()
        assert verify(Session.open(take.folder)) == [], step
        assert len(take.confirmed) == 6
        failed += errors
        if left > 0:
            break
    assert failed > 60


def retrying(take: Take) -> int:
    """Write a session and do again what fails because the disk is full; how often that was."""
    errors = 0

    def again(work: Callable[[], Any]) -> Any:
        nonlocal errors
        try:
            return work()
        except DiskFullError:
            errors += 1
            return work()

    writer = again(take.begin)
    for name, instant in take.places:
        again(partial(take.add, writer, name, instant))
    again(lambda: take.end(writer))
    return errors


def test_on_a_disk_that_is_really_full_nothing_confirmed_is_lost(small_disk: Callable[[int], Path]) -> None:
    full = finished = 0
    for pages in range(1, 90, 2):
        root = small_disk(pages)
        take = Take(root)
        writer = None
        try:
            writer = take.begin()
            for name, instant in take.places:
                take.add(writer, name, instant)
            take.end(writer)
            finished += 1
        except DiskFullError as error:
            full += "is full" in str(error)
            if writer is not None and take.confirmed:
                # The room that was reserved lets the session be finished with what it has, all the same.
                missing_at_least_one(take, writer)
            elif writer is not None:
                writer.abort()
        small_disk(1000)
        if take.folder.exists() and (take.folder / "burst.json").exists():
            take.check_repaired()
        else:
            assert not take.confirmed
        subprocess.run(["umount", str(root)], check=True)
    assert full > 15
    assert finished > 2


def missing_at_least_one(take: Take, writer: SessionWriter) -> None:
    cameras = [camera_record(name) for name in take.names]
    gaps = [
        MissingImage(camera=name, instant=instant, reason="the leader's disk is full")
        for name, instant in take.places
        if (name, instant) not in take.confirmed
    ]
    session = writer.finish(cameras, take.burst, gaps, origin="simulated")
    assert verify(session) == []
    assert len(session.manifest.images) == len(take.confirmed)
