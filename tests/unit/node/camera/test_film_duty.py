"""What a burst's film in its node's spool owes, in histories that are drawn.

What the leader does not have can be read, also after the node was killed or its disk was full; what it has is
deleted, and nothing else; what a power cut could take is synced.
"""

import errno
import hashlib
import json
import os
import random
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given, settings
from msgspec.structs import replace

from capture_app.common.errors import DiskFullError
from capture_app.node.camera import film_spool
from capture_app.node.camera.film_spool import SpooledFilm
from capture_app.protocol.messages import ImageUpload
from capture_app.session.files.durable import AppendOnlyFile, write_all
from tests.histories import histories
from tests.unit.node.bursts import upload

MAX_BYTES = 40
"""Length of a segment here: some four frames."""
MAX_BATCH = 3 * 14
TRUTH = b"depth"


def frame(instant: int) -> tuple[ImageUpload, bytes]:
    """A frame of its own length, each third with ground truth behind its image."""
    image = b"%d" % instant * (1 + instant % 5)
    truth = TRUTH if instant % 3 == 0 else b""
    header = upload("a", instant)
    record = replace(header.record, bytes=len(image), sha256=hashlib.sha256(image).hexdigest())
    return replace(header, record=record, truth_bytes=len(truth)), image + truth


def open_files() -> int:
    return len([*Path("/dev/fd").iterdir()])


class Duty:
    """A film on a disk; each method is something that happens."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.film = folder, SpooledFilm(folder)
        self.here: set[int] = set()
        """Instants that the leader does not have."""
        self.known: set[int] = set()
        """Instants of which the film was told."""
        self.next = 0
        self.unsynced: set[int] = set()
        self.current: Path | None = None
        """The segment to which frames may be appended still."""
        self.lost: set[int] = set()
        """Instants of a film that somebody has deleted."""
        self.others_open = open_files()

    def append(self, number: int) -> None:
        count = 1 + number % 3
        frames = [frame(instant) for instant in range(self.next, self.next + count)]
        self.film.append(frames)
        self._note({*range(self.next, self.next + count)})
        self.current = max(self.folder.glob("*.film"))
        assert self.current.stat().st_size < MAX_BYTES + MAX_BATCH

    def fill(self, number: int) -> None:
        """The disk is full after so many frames of the next ones, or before their lines in the index."""
        left = number

        def write(handle: int, data: bytes) -> None:
            nonlocal left
            if not left:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            left -= 1
            write_all(handle, data)

        def no_line(*_: object, **__: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(film_spool, "write_all", write)
            patch.setattr(AppendOnlyFile, "append", no_line)
            with pytest.raises(DiskFullError):
                self.film.append([frame(instant) for instant in range(self.next, self.next + 3)])
        self.current = None
        if number % 2:
            self.next += 3  # Memory takes them.

    def release(self, number: int) -> None:
        drawn = random.Random(number)
        self._release({instant for instant in self.here if drawn.random() < 0.6})

    def release_all(self, _: int) -> None:
        self._release({*self.here})

    def release_again(self, number: int) -> None:
        """The leader says once more that it has what it has, or what was never here."""
        assert self.film.release([*(self.known - self.here), 10_000]) == []

    def sync(self, _: int) -> None:
        synced = {*self.film.to_sync()}
        for path, instants in self._stored():
            if instants & self.unsynced & self.here:
                assert {path, path.with_suffix(".film")} <= synced, "a power cut would lose it"
        assert self.lost or synced <= {*self.folder.iterdir()}
        self.unsynced.clear()
        assert self.film.to_sync() == [], "nothing was written since"

    def lose(self, _: int) -> None:
        """Somebody deletes a film."""
        for path, instants in self._stored():
            if (film := path.with_suffix(".film")) != self.current:
                self.lost |= instants
                film.unlink(missing_ok=True)
                break

    def close(self, _: int) -> None:
        self.film.close()
        self.current = None

    def restart(self, _: int) -> None:
        """The node is killed; its next run finds what it has left."""
        self.film.close()
        self.film, self.current = SpooledFilm(self.folder), None
        recovered = {image.record.instant: image for image in self.film.recover()}
        assert self.here - self.lost <= {*recovered} <= self.known - self.lost
        assert recovered == {instant: frame(instant)[0] for instant in recovered}
        self.here = {*recovered} | (self.here & self.lost)
        self.unsynced = {*recovered}

    def check(self) -> None:
        known = sorted(self.known)
        read = self.film.read([frame(instant)[0] for instant in known])
        there = self.here - self.lost
        assert read == [frame(instant)[1] if instant in there else None for instant in known]
        assert open_files() - self.others_open == (0 if self.current is None else 2)
        for path, instants in self._stored():
            is_needed = bool(instants & self.here) or path.with_suffix(".film") == self.current
            assert is_needed, "nobody needs it any more"

    def finish(self) -> None:
        self.restart(0)
        self._release({*self.here})
        left = [path for path in self.folder.glob("*.film") if path.stat().st_size]
        assert not left, "it is never deleted"

    def _note(self, instants: set[int]) -> None:
        self.here |= instants
        self.known |= instants
        self.unsynced |= instants
        self.next = max(instants) + 1

    def _release(self, instants: set[int]) -> None:
        self.here -= instants
        for path in self.film.release(sorted(instants)):
            path.unlink(missing_ok=not self.lost.isdisjoint(instants))

    def _stored(self) -> Iterator[tuple[Path, set[int]]]:
        """Yield each index on the disk with its instants."""
        for path in sorted(self.folder.glob("*.ndjson")):
            lines = map(json.loads, path.read_bytes().splitlines())
            if instants := {line["frame"]["record"]["instant"] for line in lines}:
                yield path, instants


USUAL = ("append", "append", "append", "release", "sync")
OTHERS = ("release_all", "release_again", "fill", "close", "lose", "restart")


@given(histories(USUAL, OTHERS, max_steps=20, max_others=3))
@example([*[("append", 2)] * 6, ("release_all", 0), ("sync", 0)])
@settings(max_examples=60)
def test_what_the_leader_does_not_have_is_kept_and_nothing_else(history: list[tuple[str, int]]) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(film_spool, "SEGMENT_BYTES", MAX_BYTES)
        duty = Duty(Path(folder))
        for step, number in history:
            getattr(duty, step)(number)
            duty.check()
        duty.finish()
        duty.film.close()
