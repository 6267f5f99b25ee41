"""Which mode is chosen, and what a user reads when it cannot be."""

import errno
import os
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import pytest

from capture_app.cameras.frames import PixelFormat
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2 import v4l2_driver
from capture_app.plugins.cameras.v4l2.kernel import driver_error
from capture_app.plugins.cameras.v4l2.modes import Mode, check_capture, choose_mode, configure, parse_options
from capture_app.plugins.cameras.v4l2.v4l2_driver import list_cameras, open_camera, open_video_node
from tests.unit.plugins.cameras.v4l2.fake_device import MJPG, FickleDevice, rates

WEBCAM = (
    Mode("YUYV", 640, 480, rates(30, 15)),
    Mode("YUYV", 1280, 720, rates(10)),
    Mode("MJPG", 1920, 1080, rates(30)),
    Mode("MJPG", 640, 480, rates(30, 15)),
    Mode("MJPG", 320, 240, rates(60, 30)),
)
THERMAL = (Mode("GREY", 160, 120, rates(9)),)


def chosen(modes: tuple[Mode, ...], **options: str) -> tuple[str, int, int, Fraction]:
    mode, period = choose_mode("/dev/video0", modes, parse_options(options))
    return mode.fourcc, mode.width, mode.height, 1 / period


@pytest.mark.parametrize(
    ("modes", "options", "expected"),
    [
        (WEBCAM, {}, ("MJPG", 640, 480, 30)),
        (WEBCAM, {"format": "yuyv"}, ("YUYV", 640, 480, 30)),
        (WEBCAM, {"fps": "60"}, ("MJPG", 320, 240, 60)),
        (WEBCAM, {"width": "1280"}, ("YUYV", 1280, 720, 10)),
        (WEBCAM, {"height": "1080"}, ("MJPG", 1920, 1080, 30)),
        (WEBCAM, {"fps": "29.97"}, ("MJPG", 640, 480, 30)),
        (THERMAL, {}, ("GREY", 160, 120, 9)),
    ],
)
def test_the_best_mode_with_all_wishes_is_chosen(
    modes: tuple[Mode, ...], options: dict[str, str], expected: tuple[str, int, int, int]
) -> None:
    assert chosen(modes, **options) == expected


def test_a_range_of_rates_is_clamped_only_without_a_wish() -> None:
    modes = (Mode("YUYV", 640, 480, ((Fraction(1, 25), Fraction(1, 5)),)),)
    assert chosen(modes) == ("YUYV", 640, 480, 25)
    assert chosen(modes, fps="12") == ("YUYV", 640, 480, 12)
    with pytest.raises(CameraError, match=r"no mode at 30 fps \(it offers YUYV 640x480 at 5 to 25 fps\)"):
        chosen(modes, fps="30")


@pytest.mark.parametrize("options", [{"width": "800"}, {"fps": "120"}, {"format": "GREY"}, {"height": "1"}])
def test_a_mode_that_is_not_offered_is_refused_with_those_that_are(options: dict[str, str]) -> None:
    with pytest.raises(
        CameraError, match=r"/dev/video0 has no mode .*it offers .*MJPG 640x480 at 30, 15 fps"
    ):
        chosen(WEBCAM, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"width": "wide"},
        {"width": "0"},
        {"height": "-480"},
        {"fps": "fast"},
        {"fps": "1/0"},
        {"fps": "0"},
    ],
)
def test_an_unreadable_option_is_named(options: dict[str, str]) -> None:
    with pytest.raises(BadInputError, match=next(iter(options))):
        parse_options(options)


@pytest.mark.parametrize(
    ("flags", "word"),
    [
        (v4l2.CAP_META_CAPTURE | v4l2.CAP_STREAMING, "metadata"),
        (v4l2.CAP_VIDEO_CAPTURE_MPLANE | v4l2.CAP_STREAMING, "planes"),
        (v4l2.CAP_STREAMING, "not a capture device"),
        (v4l2.CAP_VIDEO_CAPTURE, "not a capture device"),
    ],
)
def test_nodes_without_pictures_are_refused(flags: int, word: str) -> None:
    with pytest.raises(CameraError, match=word):
        check_capture("/dev/video1", "Webcam", flags)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.ENOENT, "there is no camera"),
        (errno.EACCES, "group `video`"),
        (errno.EBUSY, "in use"),
        (errno.ENOTTY, "not a camera"),
        (errno.ENOSPC, "USB"),
        (errno.ENODEV, "does not answer"),
        (errno.EIO, "does not answer"),
        (errno.ENOMEM, "Cannot allocate memory"),
    ],
)
def test_the_kernels_errors_say_what_to_do(code: int, words: str) -> None:
    error = driver_error("/dev/video0", OSError(code, "x"))
    assert words in str(error)
    assert "/dev/video0" in error.what
    assert error.hint


@pytest.mark.parametrize(
    ("path", "words"),
    [("/dev/video-none", "no camera"), ("/dev/null", "not a camera"), ("/dev", "not a camera")],
)
def test_opening_what_is_no_camera_fails_in_words(path: str, words: str) -> None:
    with pytest.raises(CameraError, match=words):
        open_camera(path, {}, clock=HostClock(), name="a")


def test_a_regular_file_is_not_opened(tmp_path: Path) -> None:
    note = tmp_path / "video0"
    note.write_text("no camera")
    with pytest.raises(CameraError, match="not a camera"):
        open_camera(str(note), {}, clock=HostClock(), name="a")
    assert list_cameras(tmp_path) == []


def test_a_camera_that_may_not_be_opened_is_listed_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(_path: str) -> NoReturn:
        raise PermissionError(errno.EACCES, "Permission denied")

    for name in ("video10", "video2", "videox"):
        Path(tmp_path, name).touch()
    monkeypatch.setattr(v4l2_driver, "open_video_node", denied)
    found = list_cameras(tmp_path)
    assert [Path(listing.spec).name for listing in found] == ["video2", "video10"]
    assert all("group `video`" in listing.detail and not listing.usable for listing in found)


def test_a_camera_is_listed_with_its_modes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path(tmp_path, "video0").touch()
    monkeypatch.setattr(v4l2_driver, "open_video_node", lambda _path: FickleDevice(MJPG, 30))
    (found,) = list_cameras(tmp_path)
    assert (found.spec, found.model) == (f"v4l2:{tmp_path}/video0", "Fake camera")
    assert (found.detail, found.usable) == ("MJPG 640x480 at 30, 15 fps", True)


@pytest.mark.parametrize(("busy", "opens"), [(3, True), (99, False)])
def test_a_camera_that_wakes_up_is_tried_again(
    busy: int, opens: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [OSError(errno.EBUSY, "Device or resource busy")] * busy

    webcam = FickleDevice(MJPG, 30)

    def device(_path: str) -> FickleDevice:
        if answers:
            raise answers.pop()
        return webcam

    monkeypatch.setattr(v4l2_driver, "VideoDevice", device)
    monkeypatch.setattr(v4l2_driver, "VIDEO4LINUX_MAJOR", os.major(Path("/dev/null").stat().st_rdev))
    monkeypatch.setattr(v4l2_driver, "WAKING_PAUSE_S", 0.0)
    if opens:
        assert open_video_node("/dev/null") is webcam
    else:
        with pytest.raises(OSError, match="busy"):
            open_video_node("/dev/null")


def test_the_period_is_the_one_the_driver_took() -> None:
    assert configure(FickleDevice(MJPG, 25), parse_options({})) == (MJPG, Fraction(1, 25))


@pytest.mark.parametrize(
    ("taken", "rate", "options"), [(PixelFormat("MJPG", 320, 240, 0), 30, {}), (MJPG, 15, {"fps": "30"})]
)
def test_a_driver_that_takes_another_mode_is_refused(
    taken: PixelFormat, rate: int, options: dict[str, str]
) -> None:
    with pytest.raises(CameraError, match="it offers MJPG 640x480 at 30, 15 fps"):
        configure(FickleDevice(taken, rate), parse_options(options))
