"""Sessions on file systems that this machine can mount: import, burst, rename, note, trash and doctor."""

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.machine.doctor import disk
from capture_app.rig.rig import Rig
from capture_app.session.library.changes import rename_session, set_note, trash_session
from capture_app.session.reading.reader import Session
from tests.unit.session.conftest import jpeg
from tests.unit.session.writing.test_kills import judge, killed

MIB = 1 << 20
Mount = Callable[[Path, Path], None]


def call(*words: object) -> None:
    subprocess.run([str(word) for word in words], check=True, capture_output=True, timeout=60)


def tmpfs(place: Path, files: Path) -> None:
    call("mount", "-t", "tmpfs", "-o", "size=64m", "none", place)


def overlay(place: Path, files: Path) -> None:
    tmpfs(files, files)
    lower, upper, work = (files / name for name in ("lower", "upper", "work"))
    for folder in (lower, upper, work):
        folder.mkdir()
    call("mount", "-t", "overlay", "-o", f"lowerdir={lower},upperdir={upper},workdir={work}", "none", place)


def image(files: Path, make: str, *options: str) -> Path:
    """A file system of its own in a file."""
    found = files / "image"
    with found.open("wb") as file:
        file.truncate(320 * MIB)
    call(make, *options, found)
    return found


def ext2(place: Path, files: Path) -> None:
    call("mount", "-o", "loop", image(files, "mkfs.ext2", "-q"), place)


def xfs(place: Path, files: Path) -> None:
    call("mount", "-o", "loop", image(files, "mkfs.xfs", "-q"), place)


def btrfs(place: Path, files: Path) -> None:
    call("mount", "-o", "loop", image(files, "mkfs.btrfs", "-q"), place)


def fat(place: Path, files: Path) -> None:
    # Not fusefat: it loses what is in a folder that it renames.
    call("mount", "-t", "vfat", "-o", "loop", image(files, "mkfs.vfat"), place)


def exfat(place: Path, files: Path) -> None:
    disk_image = image(files, "mkfs.exfat")
    device = subprocess.run(["losetup", "--find", "--show", disk_image], check=True, capture_output=True)
    call("mount.exfat-fuse", "-o", "rw", device.stdout.decode().strip(), place)


MOUNTS: tuple[Mount, ...] = (tmpfs, overlay, ext2, xfs, btrfs, fat, exfat)


@pytest.fixture(params=MOUNTS, ids=lambda mount: mount.__name__)
def mounted(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder on such a file system; skipped where it cannot be mounted."""
    place, files = tmp_path / "place", tmp_path / "files"
    place.mkdir()
    files.mkdir()
    try:
        request.param(place, files)
        yield place
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"this machine cannot mount {request.param.__name__}: {error}")
    finally:
        for folder in (place, files):
            if os.path.ismount(folder):
                call("umount", folder)
        loops = subprocess.run(["losetup", "-j", files / "image"], capture_output=True, check=False)
        for line in loops.stdout.decode().splitlines():
            call("losetup", "-d", line.partition(":")[0])


def write_cameras(folder: Path) -> None:
    for camera in ("a", "b"):
        (folder / camera).mkdir(parents=True)
        for number in range(3):
            (folder / camera / f"{number}.jpg").write_bytes(jpeg(number))


def test_sessions_live_there(mounted: Path, tmp_path: Path) -> None:
    sessions = mounted / "sessions"
    sessions.mkdir()
    write_cameras(tmp_path / "in")
    words = ["sessions", "import", str(tmp_path / "in"), "--out", str(sessions), "--fps", "30"]
    assert run(words) == ExitCode.OK
    with Rig(simulated=2, sessions=sessions) as rig:
        rig.wait_until_ready(2)
        taken = rig.burst(frames=3).folder
    renamed = rename_session(sessions / "in", "other")
    set_note(renamed, "kept")
    assert Session.open(renamed).manifest.note == "kept"
    for folder in (renamed, taken):
        assert run(["sessions", "verify", str(folder)]) == ExitCode.OK
    assert disk(sessions, "sessions", "--sessions", MIB).grade in ("good", "note", "warning")
    trash_session(renamed)
    assert not renamed.exists()
    shutil.rmtree(sessions)


def test_a_writer_that_is_killed_there_loses_nothing_that_was_confirmed(mounted: Path) -> None:
    judge([*killed(mounted, "moments", 1, 20), *killed(mounted, "steps", 101, 1, 1)], 20)
    judge(killed(mounted, "videos", 1, 10_000, 9), 8)


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    write_cameras(tmp_path / "in")
    try:
        call("mount", "--bind", sessions, sessions)
        call("mount", "-o", "remount,ro,bind", sessions)
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"this machine cannot mount a folder read-only: {error}")
    try:
        words = ["sessions", "import", str(tmp_path / "in"), "--out", str(sessions), "--fps", "30"]
        assert run(words) == ExitCode.BAD_INPUT
        assert "Read-only file system" in capsys.readouterr().err
        assert disk(sessions, "sessions", "--sessions", MIB).grade == "problem"
    finally:
        call("umount", sessions)
