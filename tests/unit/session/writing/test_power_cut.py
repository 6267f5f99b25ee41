"""Power cuts: what was confirmed has been synced, and so have its name, all its folders and its line.

A killed process leaves its writes to the kernel, a power cut does not: a file, or a name in a folder, is safe
once it was synced after its last change. This model of a disk keeps count of what is not.
"""

import os
from pathlib import Path
from typing import Any

import pytest

from capture_app.session.format.journal import TRUE_TIMES_JOURNAL, frames_path, ground_truth_path
from capture_app.session.format.manifest import JOURNAL, MANIFEST, image_path, video_path
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.recorded import frame, save_frames
from tests.unit.session.writing.full_take import Take
from tests.unit.session.writing.killed_writer import CAMERAS, received


class VolatileDisk:
    """Knows which files and folders below `root` have changed since they were synced."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = root
        self.changed: set[Path] = set()
        self.syncs = 0
        real: dict[str, Any] = {
            name: getattr(os, name) for name in ("open", "write", "replace", "mkdir", "fsync", "fdatasync")
        }

        def open_file(path: Any, flags: int, *mode: Any, **options: Any) -> int:
            if flags & os.O_CREAT and not Path(path).exists():
                self.changed |= {Path(path), Path(path).parent}
            handle: int = real["open"](path, flags, *mode, **options)
            return handle

        def write(handle: int, data: Any) -> int:
            self.changed.add(path_of(handle))
            written: int = real["write"](handle, data)
            return written

        def replace(old: Any, new: Any, **options: Any) -> None:
            real["replace"](old, new, **options)
            if Path(old) in self.changed:
                self.changed.add(Path(new))
            self.changed -= {Path(old)}
            self.changed |= {Path(old).parent, Path(new).parent}

        def make_folder(path: Any, *arguments: Any, **options: Any) -> None:
            real["mkdir"](path, *arguments, **options)
            self.changed |= {Path(path), Path(path).parent}

        def sync(handle: int) -> None:
            self.syncs += 1
            real["fsync"](handle)
            self.changed.discard(path_of(handle))

        for name, watched in (
            ("open", open_file), ("write", write), ("replace", replace), ("mkdir", make_folder),
            ("fsync", sync), ("fdatasync", sync),
        ):  # fmt: skip
            monkeypatch.setattr(os, name, watched)

    def is_safe(self, path: Path) -> bool:
        """Whether a file, its name, and the names of all its folders would outlive a power cut."""
        return not self.changed & {path, *(p for p in path.parents if p.is_relative_to(self.root))}


def path_of(handle: int) -> Path:
    return Path(f"/proc/self/fd/{handle}").readlink()


def test_an_image_is_confirmed_when_it_would_outlive_a_power_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = VolatileDisk(tmp_path, monkeypatch)
    take = Take(tmp_path)
    writer = take.begin()
    for name, instant in take.places:
        take.add(writer, name, instant)
        for confirmed in (image_path(name, instant), JOURNAL, ground_truth_path(name, instant)):
            assert disk.is_safe(take.folder / confirmed), confirmed
    take.end(writer)
    assert disk.is_safe(take.folder / MANIFEST)
    assert not {path for path in disk.changed if path.exists() and path != tmp_path}


def test_images_that_come_together_are_safe_together_for_fewer_syncs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = VolatileDisk(tmp_path, monkeypatch)
    take = Take(tmp_path)
    writer = take.begin()
    batch = [(camera, instant) for instant in range(3) for camera in range(CAMERAS)]
    began = disk.syncs
    writer.save([received(*of) for of in batch])
    for camera, instant in batch:
        name = f"cam{camera}"
        for confirmed in (
            image_path(name, instant), ground_truth_path(name, instant), JOURNAL, TRUE_TIMES_JOURNAL
        ):  # fmt: skip
            assert disk.is_safe(take.folder / confirmed), confirmed
    # Six pictures and six ground truths, two folders of each with the four above them, and two journals.
    assert disk.syncs - began <= 24
    writer.abort()


def test_a_frame_of_a_video_is_safe_before_its_line_and_both_when_it_is_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line without its frame would count a picture of zeros as saved."""
    disk = VolatileDisk(tmp_path, monkeypatch)
    writer = SessionWriter.create(tmp_path, "walk")
    video, lines = (writer.folder / name for name in (video_path("left"), frames_path(video_path("left"))))
    counted = os.write

    def write(handle: int, data: Any) -> int:
        if path_of(handle) == lines:
            assert disk.is_safe(video)
        return counted(handle, data)

    monkeypatch.setattr(os, "write", write)
    for instant in range(2):
        save_frames(writer, frame("left", instant))
        assert disk.is_safe(video)
        assert disk.is_safe(lines)
    writer.abort()
