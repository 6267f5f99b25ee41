"""What a session's writer owes those who give it images, in histories that are drawn.

An image that was saved is there as it was saved, once, whatever disk errors, crashes and returns come before
and after; none is there that was not; and whoever reads what was finished sees no contradiction.
"""

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from errno import EIO, ENOSPC
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from capture_app.common import system
from capture_app.common.errors import DiskError, DiskFullError, TryAgainError
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.manifest import BurstRecord, MissingImage
from capture_app.session.reading.reader import Session, writing_state
from capture_app.session.reading.verify import verify
from capture_app.session.writing import video_store
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import CLOCK, INSTANTS, camera_record
from tests.unit.session.recorded import frame

Key = tuple[str, int]
VIDEOS, IMAGES = ("film", "movie"), ("left", "right")
"""Cameras whose frames are saved in videos, and as files."""
CAMERAS = {name: camera_record(name, width=32, height=24) for name in (*IMAGES, *VIDEOS)}
BURST = BurstRecord(instants_ns=INSTANTS, period_ns=33_000_000)
OTHER = {name: frame(name, 0).data for name in CAMERAS}
FRAMES = {(name, instant): frame(name, instant) for name in CAMERAS for instant in range(len(INSTANTS))}


class Disk:
    """A disk of which one of the next changes fails."""

    def __init__(self, chance: random.Random, patch: pytest.MonkeyPatch) -> None:
        self.chance, self.left, self.errno = chance, 0, 0
        patch.setattr(os, "write", self._failing(os.write))
        patch.setattr(system, "replace", self._failing(system.replace))
        patch.setattr(system, "sync_data", self._failing(lambda _: None))
        patch.setattr(system, "sync_path", self._failing(lambda _: None))

    def _failing(self, real: Any) -> Any:
        def call(*arguments: Any) -> Any:
            if self.left:
                self.left -= 1
                if not self.left:
                    raise OSError(self.errno, os.strerror(self.errno))
            return real(*arguments)

        return call

    @contextmanager
    def at_times(self) -> Iterator[None]:
        """Let a change fail, or none; leave the block with what the writer says then."""
        if self.chance.random() < 0.4:
            self.left, self.errno = self.chance.randrange(1, 9), self.chance.choice([EIO, ENOSPC])
        fails, kind = self.left > 0, DiskFullError if self.errno == ENOSPC else DiskError
        try:
            yield
            assert self.left or not fails, "an error of the disk was passed over"
        except kind:
            assert fails
            assert not self.left
            raise
        finally:
            self.left = 0


class WritingDuty:
    """A leader that writes a session on a disk that fails at times; each method is something that happens."""

    def __init__(self, root: Path, chance: random.Random, disk: Disk) -> None:
        self.chance, self.disk = chance, disk
        self.saved: dict[Key, StoredImage] = {}
        self.pending: dict[Key, StoredImage] = {}
        """Images that were appended since their last sync."""
        self.events, self.note, self.left_out = 0, "", set[str]()
        self.writer = SessionWriter.create(root, "duty")
        parts = tuple(CameraPlan(camera=camera) for camera in CAMERAS.values())
        self.plan = BurstPlan(
            name="duty",
            created=self.writer.created,
            software=self.writer.software,
            leader=1,
            number=1,
            burst=BURST,
            cameras=parts,
        )
        self.writer.set_plan(self.plan)
        self.folder = self.writer.folder

    def _draw(self) -> tuple[list[StoredImage], bool]:
        in_videos = self.chance.random() < 0.5
        cameras = [name for name in (VIDEOS if in_videos else IMAGES) if name not in self.left_out]
        drawn = []
        for _ in range(self.chance.randrange(1, 4) if cameras else 0):
            image = FRAMES[self.chance.choice(cameras), self.chance.randrange(len(INSTANTS))]
            if self.chance.random() < 0.3:
                # Another one of an instant: the first counts.
                image = replace(image, data=OTHER[image.record.camera])
                record = structs.replace(image.record, sha256=FRAMES[image.key[0], 0].record.sha256)
                image = replace(image, record=structs.replace(record, bytes=len(image.data)))
            drawn.append(image if in_videos else replace(image, truth=self.chance.choice([b"", b"npz"])))
        return drawn, in_videos

    def append(self) -> None:
        """Images arrive; those of a camera are written, or none of them."""
        images, in_videos = self._draw()
        if not images:
            return
        done = [{*dict.fromkeys(image.record.camera for image in images)}]
        try:
            with self.disk.at_times():
                self.writer.append(images, in_videos=in_videos)
        except DiskError:
            # Cameras' videos are written one after the other.
            done = [{name for name in VIDEOS if self._has_written(name, images)} if in_videos else set()]
        for image in images:
            if image.record.camera in done[0] and image.key not in self.saved:
                self.pending.setdefault(image.key, image)

    def _has_written(self, camera: str, images: list[StoredImage]) -> bool:
        there = {
            instant for part in self.writer.videos._videos.get(camera, ()) for instant, *_ in part.unsynced
        }
        given = {image.key for image in images if image.key[0] == camera} - {*self.saved}
        return {instant for _, instant in given} <= there

    def sync(self) -> None:
        """What was appended is made safe; what could not be is to be given again."""
        cameras = self.chance.sample(VIDEOS, self.chance.randrange(3))
        try:
            with self.disk.at_times():
                self.writer.sync(*cameras)
        except DiskError:
            # What failed is to be given again; what comes after it is still to be synced.
            synced = self._synced_before_an_error(cameras)
        else:
            synced = [*cameras, *IMAGES]
        for key in [*self.pending]:
            if key[0] in synced:
                self.saved[key] = self.pending.pop(key)

    def _synced_before_an_error(self, cameras: list[str]) -> list[str]:
        for place, camera in enumerate(cameras):
            if lost := [key for key in self.pending if key[0] == camera and not self.writer.has(*key)]:
                for key in lost:
                    del self.pending[key]
                # Of a video in parts, those before the one that failed are safe.
                return cameras[: place + 1]
        for key in [*self.pending]:
            if key[0] in IMAGES:
                del self.pending[key]
        return cameras

    def note_event(self) -> None:
        """Something happens in the rig."""
        try:
            with self.disk.at_times():
                self.writer.add_event({"event": "joined"})
            self.events += 1
        except DiskError:
            pass

    def crash(self) -> None:
        """The leader is killed, or its machine is, and starts again."""
        self.writer.abort()
        with pytest.raises(TryAgainError, match="is closed"):
            self.writer.add_event({})
        self.pending.clear()
        for path in sorted(path for kind in ("*.mjpeg", "*.ndjson") for path in self.folder.rglob(kind)):
            if self.chance.random() < 0.3 and path.name != "events.ndjson":
                with path.open("ab") as file:
                    file.write(b'{"torn')
        while True:
            try:
                with self.disk.at_times():
                    self.writer = SessionWriter.resume(self.folder)
                break
            except DiskError:
                continue

    def finish(self) -> None:
        """The session is finished and read, and opened again for late images; or its disk fails before."""
        self.writer.sync(*VIDEOS)
        self.saved |= self.pending
        self.pending.clear()
        if len(self.left_out) < 2 and self.chance.random() < 0.2:
            self.left_out.add(self.chance.choice([*CAMERAS]))
        cameras = [
            structs.replace(camera, clock=structs.replace(CLOCK, offset_ns=2**63))
            if name in self.left_out
            else camera
            for name, camera in CAMERAS.items()
        ]
        missing = [MissingImage(camera=name, instant=n, reason="lost") for name, n in FRAMES]
        note = f"note {self.events}"
        try:
            # Where it fails while a camera is set aside, only the next start of the leader finds the rest.
            with nullcontext() if self.left_out else self.disk.at_times():
                session = self.writer.finish(cameras, BURST, missing, note=note, plan=self.plan)
        except DiskError:
            return
        self.note = self.note or note
        self.saved = {key: image for key, image in self.saved.items() if key[0] not in self.left_out}
        self._check_finished(session)
        self.writer = SessionWriter.resume(self.folder)
        assert writing_state(self.folder) == "reopened"

    def _check_finished(self, session: Session) -> None:
        assert [str(problem) for problem in verify(session)] == []
        manifest = session.manifest
        images = {(image.camera, image.instant): image for image in manifest.images}
        assert {key: session.image_bytes(image) for key, image in images.items()} == {
            key: image.data for key, image in self.saved.items()
        }
        first, *reasons = manifest.note.split("; ")
        assert first == self.note
        assert sorted(reason.split()[0] for reason in reasons) == sorted(self.left_out)
        absent = {(gap.camera, gap.instant) for gap in manifest.missing}
        assert absent == {key for key in FRAMES if key[0] not in self.left_out} - {*self.saved}
        times = session.true_times()
        # Of frames of videos only the frames themselves tell.
        if not any(name in IMAGES for name, _ in self.saved):
            return
        assert {(true.camera, true.instant) for true in (times.images if times else ())} == {*self.saved}

    def check(self) -> None:
        """See that exactly what was saved is there; a camera that is left out may be half set aside."""
        keys = [key for key in FRAMES if key[0] not in self.left_out]
        assert {key for key in keys if self.writer.has(*key)} == {*keys} & {*self.saved}
        for name, instant in keys:
            record, saved = self.writer.image(name, instant), self.saved.get((name, instant))
            assert (record and record.sha256) == (saved and saved.record.sha256)
            assert (instant in self.writer.instants_of(name)) is (saved is not None)


@pytest.mark.parametrize("max_part_bytes", [1, 4_000_000_000])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32))
def test_what_was_saved_is_there_whatever_happens(
    tmp_path_factory: pytest.TempPathFactory, seed: int, max_part_bytes: int
) -> None:
    chance = random.Random(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(video_store, "MAX_PART_BYTES", max_part_bytes)
        duty = WritingDuty(tmp_path_factory.mktemp("duty"), chance, Disk(chance, patch))
        for name in chance.choices(
            ("append", "sync", "note_event", "crash", "finish"), (8, 6, 1, 1, 1), k=30
        ):
            getattr(duty, name)()
            duty.check()
        duty.writer.abort()
