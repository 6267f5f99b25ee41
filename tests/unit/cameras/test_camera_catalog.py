import subprocess
import sys
import time
from typing import Any, ClassVar

import pytest

from capture_app.cameras import specs
from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.machine.cameras import list_cameras
from capture_app.plugins.cameras.sim.profiles import PROFILES
from tests.unit.cameras.fake_camera import FakeCamera, frame


def test_parse_spec() -> None:
    assert specs.parse_spec("sim:pi") == specs.CameraSpec("sim", "pi", {})
    assert specs.parse_spec("v4l2:/dev/video2, width=640 ,fps=30") == specs.CameraSpec(
        "v4l2", "/dev/video2", {"width": "640", "fps": "30"}
    )


@pytest.mark.parametrize("kind", ["aravis", "libcamera", "hyphens"])
@pytest.mark.parametrize("key", ["exposure_us", "exposure-us"])
def test_every_camera_accepts_both_spellings_of_an_option(
    monkeypatch: pytest.MonkeyPatch, kind: str, key: str
) -> None:
    given: dict[str, str] = {}
    driver = FakeDriver() if kind == "hyphens" else specs.load_driver(kind)
    monkeypatch.setattr(specs, "camera_kinds", lambda: (kind,))
    monkeypatch.setattr(specs, "load_driver", lambda _: driver)
    monkeypatch.setattr(driver, "open_camera", lambda device, options, **_: given.update(options))
    specs.open_camera(f"{kind}:1,{key}=4000", clock=HostClock(), name="a")
    assert given == {"exposure-us" if kind == "hyphens" else "exposure_us": "4000"}


class FakeDriver:
    """A driver of another package, whose own option has a hyphen."""

    OPTIONS: ClassVar = {"exposure-us": "exposure"}
    open_camera: Any = None


@pytest.mark.parametrize(
    ("spec", "label"),
    [
        ("v4l2:/dev/video2,width=640", "video2"),
        ("replay:takes/jump-001,camera=left", "left"),
        ("replay:my clip.mp4", "my-clip.mp4"),
        ("aravis:10.0.0.2", "aravis-10.0.0.2"),
        ("libcamera:0", "libcamera-0"),
    ],
)
def test_a_camera_is_named_after_its_device(spec: str, label: str) -> None:
    assert specs.parse_spec(spec).label == label


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
        ("sim:pi,noise-us=1,noise_us=2", "says noise_us twice"),
        (
            "v4l2:/dev/video0,zoom=2",
            "v4l2 cameras have no option 'zoom' (there are width, height, fps, format)",
        ),
    ],
)
def test_bad_specs_say_what_to_write(spec: str, needle: str) -> None:
    with pytest.raises(BadInputError) as error:
        specs.open_camera(spec, clock=HostClock(), name="a")
    assert needle in str(error.value)


def test_every_simulated_camera_listed_opens() -> None:
    listed = [listing for listing in list_cameras() if listing.kind == "sim"]
    assert [listing.spec for listing in listed] == [f"sim:{name}" for name in PROFILES]
    for listing in listed:
        camera = specs.open_camera(listing.spec, clock=HostClock(), name="a")
        assert camera.facts.model == listing.model
        assert "640x480 at 30 frames/s" in listing.detail


async def test_a_real_camera_is_translated_into_a_simulated_clock() -> None:
    """Drivers stamp in CLOCK_MONOTONIC, whatever the host's clock is."""
    clock = SimulatedClock(7_200_000_000_000, 12.5)
    timestamps: list[int] = []
    stamp_ns = time.monotonic_ns()
    for node_clock in (HostClock(), clock):
        real = FakeCamera()
        camera = real.in_clock(node_clock)
        await camera.start(lambda frame: timestamps.append(frame.timestamp_ns), lambda error: None)
        real.on_frame(frame(stream=1, timestamp_ns=stamp_ns))
    host_ns = host_from_monotonic(stamp_ns)
    assert timestamps == pytest.approx([host_ns, clock.local_from_true(host_ns)], abs=50_000, rel=0)


def test_opening_a_test_card_loads_no_heavy_library() -> None:
    code = (
        "import sys\n"
        "from capture_app.cameras.specs import open_camera\n"
        "from capture_app.common.clock import HostClock\n"
        "open_camera('sim:pi', clock=HostClock(), name='a')\n"
        "print(sorted({'cv2', 'numpy', 'open3d', 'pycolmap', 'textual'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_path_of_a_device_is_its_camera() -> None:
    assert specs.parse_spec("/dev/video2,fps=30") == specs.parse_spec("v4l2:/dev/video2,fps=30")
