"""What is wrong with a machine is found, with the line that repairs it."""

import errno
import os
from pathlib import Path

import pytest

from capture_app.common import system
from capture_app.common.camera_facts import CameraListing
from capture_app.machine import doctor
from capture_app.machine.doctor import usb_cameras
from capture_app.plugins.cameras.v4l2.kernel import driver_error

SAMPLE_BYTES = 1 << 20


@pytest.mark.parametrize(("raw_clock", "grade"), [(4, "good"), (None, "note")])
def test_a_clock_that_a_daemon_may_slew_is_noted(
    monkeypatch: pytest.MonkeyPatch, raw_clock: int | None, grade: str
) -> None:
    monkeypatch.setattr(doctor, "RAW_CLOCK", raw_clock)
    assert doctor.clock().grade == grade


def test_a_folder_that_is_not_there_yet_is_measured_where_it_will_be(tmp_path: Path) -> None:
    found = doctor.disk(tmp_path / "spool" / "new", "the spool", "--spool", SAMPLE_BYTES)
    assert found.grade in ("good", "warning")
    assert f"MB/s to {tmp_path}" in found.text
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_cannot_be_written_is_a_problem() -> None:
    found = doctor.disk(Path("/dev/full/spool"), "the spool", "--spool", SAMPLE_BYTES)
    assert found.grade == "problem"
    assert "choose another folder with --spool" in found.remedy


def test_a_disk_that_fails_in_the_check_itself_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a share does that is lost between two calls."""

    def failing(_: Path) -> list[str]:
        raise OSError(errno.EIO, os.strerror(errno.EIO), f"{tmp_path}/.simulshot-1/file")

    monkeypatch.setattr(doctor, "missing_abilities", failing)
    found = doctor.disk(tmp_path, "sessions", "--sessions", SAMPLE_BYTES)
    assert (found.grade, found.text) == ("problem", f"sessions: cannot write {tmp_path}: Input/output error")


@pytest.mark.parametrize("name", ["file", "file/sessions"])
def test_a_leader_whose_folder_takes_nothing_says_so(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    (warning,) = doctor.warnings_for_leader("127.0.0.1", 47010, tmp_path / name, tmp_path)
    said = f"sessions: cannot write {tmp_path}/file: Not a directory: choose another folder with --sessions"
    assert warning == said


def test_a_leader_on_a_full_disk_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(system, "sync_data", full)
    (warning,) = doctor.warnings_for_leader("127.0.0.1", 47010, tmp_path, tmp_path)
    assert warning.startswith(f"sessions: the disk of {tmp_path} is full: choose another folder")


def test_cameras_that_may_not_be_used_say_how_they_may(tmp_path: Path) -> None:
    refused = driver_error("/dev/video0", PermissionError(13, "Permission denied"))
    listings = [
        CameraListing("v4l2:/dev/video0", "v4l2", "Webcam", str(refused), usable=False),
        CameraListing("v4l2:/dev/video2", "v4l2", "Other", "640x480"),
        CameraListing("sim:webcam", "sim", "", ""),
    ]
    problem, good = doctor.cameras(listings)
    assert (problem.grade, problem.text) == ("problem", "no permission to use /dev/video0")
    assert "sudo usermod -aG video $USER" in problem.remedy
    assert good.text == "v4l2:/dev/video2: Other"


def test_a_machine_without_cameras_is_noted_only() -> None:
    (found,) = doctor.cameras([CameraListing("sim:webcam", "sim", "", "")])
    assert found.grade == "note"


def plug(root: Path, port: str, bus: int, speed: str, *nodes: str) -> None:
    """Plug a USB camera in, as /sys shows it."""
    device = root / "devices" / f"usb{bus}" / port
    interface = device / f"{port}:1.0"
    interface.mkdir(parents=True)
    (device / "busnum").write_text(f"{bus}\n")
    (device / "speed").write_text(f"{speed}\n")
    for node in nodes:
        entry = root / "class" / node
        entry.mkdir(parents=True)
        (entry / "device").symlink_to(interface)


def test_cameras_that_share_a_slow_bus_are_a_warning(tmp_path: Path) -> None:
    plug(tmp_path, "1-2", 1, "480", "video0", "video1")
    plug(tmp_path, "1-3", 1, "480", "video2", "video3")
    plug(tmp_path, "2-1", 2, "5000", "video4")
    plug(tmp_path, "2-2", 2, "5000", "video10")
    found = usb_cameras(tmp_path / "class")
    assert [node for node, *_ in found] == ["/dev/video0", "/dev/video2", "/dev/video4", "/dev/video10"]
    (warning,) = doctor.usb(found)
    assert warning.grade == "warning"
    assert warning.text.startswith("/dev/video0 and /dev/video2 share one USB 2 bus of 480 Mbit/s")
    assert "format=MJPG" in warning.remedy


def test_cameras_apart_are_no_warning(tmp_path: Path) -> None:
    (good,) = doctor.usb([("/dev/video0", 1, 480), ("/dev/video2", 2, 480)])
    assert good.grade == "good"
    assert list(doctor.usb([])) == []


def test_what_is_no_usb_camera_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "video0").mkdir()
    assert usb_cameras(tmp_path) == []
    assert usb_cameras(tmp_path / os.devnull) == []


def test_bursts_that_no_leader_takes_are_named_and_how_to_drop_them(tmp_path: Path) -> None:
    """The frames of a session whose folder was removed stayed in the spool, and nothing said so."""
    assert [*doctor.spooled(tmp_path / "none")] == []
    (tmp_path / "cam0").mkdir()
    for number in range(7):
        folder = tmp_path / "cam0" / f"0000004d-{number:06d}"
        folder.mkdir()
        (folder / "000000.jpg").write_bytes(bytes(1_000_000))
        text = [found.text for found in doctor.spooled(tmp_path)]
        assert text[0] == f"1 file that no node of this version wrote, which nodes leave alone: {folder}"
        assert len(text) == min(2, number + 1), "not without a report"
        (folder / "report.json").write_bytes(b"{}")
    (found,) = doctor.spooled(tmp_path)
    assert (found.check, found.grade) == ("spool", "note")
    assert found.text.startswith("7 bursts, 7.0 MB, not taken by a leader yet: ")
    assert f"{tmp_path}/cam0/0000004d-000004, ..." in found.text
    assert "delete these folders" in found.remedy
