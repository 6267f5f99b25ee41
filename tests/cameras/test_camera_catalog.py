import subprocess
import sys

import pytest

from capture_app.camera_facts import CameraFacts
from capture_app.cameras import v4l2
from capture_app.cameras.base import Camera, CapturedFrame, OnFailure, OnFrame
from capture_app.cameras.catalog import CameraSpec, list_cameras, open_camera, parse_spec
from capture_app.clock import HostClock, SimulatedClock
from capture_app.errors import BadInputError
from capture_app.simulation.devices.profiles import PROFILES
from capture_app.sync.wire.camera_commands import CameraCommand


def test_parse_spec() -> None:
    assert parse_spec("sim:pi") == CameraSpec("sim", "pi", {})
    assert parse_spec("v4l2:/dev/video2, width=640 ,fps=30") == CameraSpec(
        "v4l2", "/dev/video2", {"width": "640", "fps": "30"}
    )


@pytest.mark.parametrize(
    ("spec", "needle"),
    [
        ("", "sim:PROFILE"),
        ("phone-a", "v4l2:/dev/videoN"),
        ("gige:10.0.0.1", "sim:PROFILE"),
        ("sim", "names no device"),
        ("sim:", "names no device"),
        ("v4l2:", "v4l2:/dev/videoN"),
        ("sim:pi,scene", "not key=value"),
        ("sim:pi,,", "not key=value"),
        ("sim:pi,seed=", "not key=value"),
        ("sim:pi,seed=1,seed=2", "says seed twice"),
    ],
)
def test_bad_specs_say_what_to_write(spec: str, needle: str) -> None:
    with pytest.raises(BadInputError) as error:
        open_camera(spec, clock=HostClock(), name="a")
    assert needle in str(error.value)


def test_every_simulated_camera_listed_opens() -> None:
    listed = [listing for listing in list_cameras() if listing.kind == "sim"]
    assert [listing.spec for listing in listed] == [f"sim:{name}" for name in PROFILES]
    for listing in listed:
        camera = open_camera(listing.spec, clock=HostClock(), name="a")
        assert camera.facts.model == listing.model
        assert "640x480 at 30 frames/s" in listing.detail


def test_video_devices_are_listed_with_what_is_wrong_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    devices = (
        v4l2.DeviceInfo("/dev/video0", "HD Webcam", "uvcvideo", "usb-1", ()),
        v4l2.DeviceInfo("/dev/video4", "Other", "uvcvideo", "usb-2", (), problem="not allowed"),
    )
    monkeypatch.setattr(v4l2, "list_devices", lambda: devices)
    good, bad = list_cameras()[:2]
    assert (good.spec, good.model, good.usable) == ("v4l2:/dev/video0", "HD Webcam", True)
    assert (bad.spec, bad.detail, bad.usable) == ("v4l2:/dev/video4", "not allowed", False)


class OneFrameCamera(Camera):
    def __init__(self) -> None:
        self.commands: list[CameraCommand] = []

    @property
    def facts(self) -> CameraFacts:
        raise NotImplementedError

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        on_frame(CapturedFrame(sequence=0, stream=0, timestamp_ns=10**15, payload=self))

    async def apply(self, command: CameraCommand) -> None:
        self.commands.append(command)

    async def stop(self) -> None:
        pass

    def encode(self) -> bytes:
        return b""


async def test_a_real_camera_is_translated_into_a_simulated_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[tuple[str, dict[str, str]]] = []

    def open_v4l2(path: str, options: dict[str, str]) -> Camera:
        opened.append((path, options))
        return OneFrameCamera()

    monkeypatch.setattr(v4l2, "open_v4l2", open_v4l2)
    clock = SimulatedClock(7_200_000_000_000, 12.5)
    timestamps = []
    for node_clock in (HostClock(), clock):
        camera = open_camera("v4l2:/dev/video3,fps=30", clock=node_clock, name="a")
        await camera.start(lambda frame: timestamps.append(frame.timestamp_ns), lambda error: None)
    assert opened == [("/dev/video3", {"fps": "30"})] * 2
    assert timestamps == [10**15, clock.local_from_true(10**15)]


def test_opening_a_test_card_loads_no_heavy_library() -> None:
    code = (
        "import sys\n"
        "from capture_app.cameras.catalog import open_camera\n"
        "from capture_app.clock import HostClock\n"
        "open_camera('sim:pi', clock=HostClock(), name='a')\n"
        "print(sorted({'cv2', 'numpy', 'open3d', 'pycolmap', 'textual'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
