"""Leader and V4L2 nodes on the kernel's own uvcvideo driver, in a virtual machine with two USB cameras.

`make test KIND=v4l2` runs it. The cameras run at -30 and 0 ppm and begin 250 ms after each start; everything
from the USB bus up is real. The guest sees this checkout read-only and writes to `/out`.
"""

import sys
from pathlib import Path

import pytest

from tests.nightly.drivers.camera_vm import PLUG_IN_AGAIN, Rig, boot, find_camera_vm
from tests.project import ROOT

pytestmark = pytest.mark.timeout(1800)

TOLERANCE_NS = 2_000_000
FRAMES = 5

RIG = """
app() {{ {command} "$@"; }}
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={repository}
cd {repository}
python3 {usb_cameras} 2 >/out/usb_cameras.log 2>&1 &
until [ -e /dev/video2 ]; do sleep .1; done
sleep 1
app cameras --json >/out/cameras.json
app leader --host 127.0.0.1 --port 47010 --sessions /tmp/sessions 2>/out/leader.log &
for side in 0:left 2:right; do
  app node --name ${{side#*:}} --camera v4l2:/dev/video${{side%:*}} --leader 127.0.0.1:47010 \\
    --tolerance-us 2000 2>/out/${{side#*:}}.log &
done
for _ in $(seq 60); do
  [ "$(cat /out/left.log /out/right.log | grep -c ': syncing')" -lt 2 ] || break
  sleep .5
done
app burst --leader 127.0.0.1:47010 --frames {frames} --wait-s 120 --json >/out/burst.json 2>/out/burst.log
echo $? >/out/burst.code
app status --leader 127.0.0.1:47010 --json >/out/status.json
app sessions verify /tmp/sessions/* >/out/verify.txt 2>&1
echo $? >/out/verify.code
cp -r /tmp/sessions /out/sessions
# The right camera is pulled out of its port.
echo 1 >/sys/devices/platform/vhci_hcd.0/detach
sleep 5
app status --leader 127.0.0.1:47010 --json >/out/unplugged.json
# And put back.
python3 -c '{plug_in_again}' &
for _ in $(seq 60); do
  grep -q ': camera is back' /out/right.log && break
  sleep .5
done
app burst --leader 127.0.0.1:47010 --frames {frames} --wait-s 120 2>/out/burst2.log
app sessions verify /tmp/sessions/burst-002 >/out/verify2.txt 2>&1
echo $? >/out/verify2.code
cp -r /tmp/sessions/burst-002 /out/sessions
"""


@pytest.fixture(scope="module")
def camera_vm(shared: Path) -> Path:
    return find_camera_vm(shared)


@pytest.fixture(scope="module")
def rig(camera_vm: Path, tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """One boot: two nodes and a leader, one burst; then a camera is unplugged, and put back."""
    out = tmp_path_factory.mktemp("camera-vm")
    script = RIG.format(
        command=Path(sys.executable).with_name("capture-app"),
        repository=ROOT,
        usb_cameras=camera_vm / "usb_cameras.py",
        frames=FRAMES,
        plug_in_again=PLUG_IN_AGAIN.format(camera_vm=camera_vm),
    )
    return boot(camera_vm, script, out, last="verify2.code")


def test_the_kernels_cameras_are_listed(rig: Rig) -> None:
    listed = rig.text("cameras.json")
    assert "v4l2:/dev/video0" in listed
    assert "v4l2:/dev/video2" in listed
    assert "/dev/video1" not in listed, "a metadata node is no camera"
    assert "MJPG 320x240 at 30, 25, 15, 10 fps" in listed


def test_a_burst_of_both_cameras_is_saved_and_verifies(rig: Rig) -> None:
    assert rig.text("burst.code").strip() == "0", rig.logs
    assert rig.text("verify.code").strip() == "0", rig.text("verify.txt")
    burst = rig.json("burst.json")
    assert (burst["received"], burst["expected"]) == (2 * FRAMES, 2 * FRAMES)


def test_the_cameras_were_aligned_by_restarts_to_within_2_ms(rig: Rig) -> None:
    session = rig.session()
    assert [camera.name for camera in session.manifest.cameras] == ["left", "right"]
    for camera in session.manifest.cameras:
        assert camera.facts.timestamp_source == "start-of-exposure"
        assert camera.facts.stamp is not None
        assert camera.facts.stamp.source == "profile"
        assert camera.phase is not None
        assert camera.facts.phase_control == "reset"
    rig.assert_aligned(session, TOLERANCE_NS)
    for image in session.manifest.images:
        # How late uvcvideo's stamps are nobody has measured, and no clock can tell.
        assert image.hard_bound_ns is None
        assert image.uncertainty_ns is not None
        assert image.uncertainty_ns > 10_000_000


def test_the_nodes_clocks_are_one_and_were_found_to_be(rig: Rig) -> None:
    for camera in rig.session().manifest.cameras:
        assert camera.clock is not None
        assert abs(camera.clock.offset_ns) <= camera.clock.hard_bound_ns < TOLERANCE_NS


def test_the_cameras_own_jpegs_were_saved_untouched(rig: Rig, camera_vm: Path) -> None:
    session = rig.session()
    sent = (camera_vm / "frame.jpg").read_bytes()
    assert len(session.manifest.images) == 2 * FRAMES
    for image in session.manifest.images:
        assert session.image_file(image).read_bytes() == sent


def test_sequence_numbers_follow_each_other_within_the_burst(rig: Rig) -> None:
    for name in ("left", "right"):
        numbers = [image.sequence for image in rig.session().manifest.images if image.camera == name]
        assert None not in numbers
        assert [number - numbers[0] for number in numbers] == list(range(FRAMES))


def test_an_unplugged_camera_shows_as_failed_and_the_other_runs_on(rig: Rig) -> None:
    nodes = {node["name"]: node for node in rig.json("unplugged.json")["nodes"]}
    assert nodes["right"]["state"] == "failed", rig.logs
    assert "/dev/video2" in nodes["right"]["message"]
    assert nodes["left"]["state"] == "ready", rig.logs


def test_a_camera_that_is_put_back_is_aligned_again(rig: Rig) -> None:
    assert rig.text("verify2.code").strip() == "0", rig.text("verify2.txt")
    rig.assert_aligned(rig.session("burst-002"), TOLERANCE_NS)
