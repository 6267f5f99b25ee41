"""Leader and libcamera nodes: the real library on the kernel's own uvcvideo driver, in a virtual machine.

`make test KIND=libcamera` runs it, in a Debian 13 of its own below the guest's root, as libcamera comes
with the system; its environment does not see the system's packages. The cameras run at -30 and 0 ppm and
begin 250 ms after each start. libcamera cannot set their frame durations: they are restarted. It names a USB
camera after its controller's place in the firmware's tables; the virtual controller has none, and is given
one.
"""

from pathlib import Path

import pytest

from tests.nightly.drivers.camera_vm import (
    PLUG_IN_AGAIN,
    Rig,
    boot,
    find_camera_vm,
    skip,
)
from tests.nightly.drivers.debian_root import ENVIRONMENT, NoRootError, debian_root
from tests.project import ROOT

pytestmark = pytest.mark.timeout(1800)

TOLERANCE_NS = 2_000_000
FRAMES = 5
LEFT, RIGHT = (rf"libcamera:\_SB_.VHCI-{port}:1.0-1d6b:0104" for port in (1, 2))

RIG = """
R={root} V=/sys/devices/platform/vhci_hcd.0
python3 {usb_cameras} 2 >/out/usb_cameras.log 2>&1 &
until [ -e /dev/video2 ]; do sleep .1; done
sleep 1
for folder in /dev /proc /sys /run /out /tmp {repository}; do
  mkdir -p $R$folder; mount --rbind $folder $R$folder
done
chroot $R sh -c '/usr/lib/systemd/systemd-udevd --daemon; export SYSTEMD_IGNORE_CHROOT=1
  udevadm trigger --subsystem-match=media --subsystem-match=video4linux; udevadm settle' >/out/udev.log 2>&1
mount -t tmpfs t $R$V; mkdir $R$V/firmware_node; echo '\\_SB_.VHCI' >$R$V/firmware_node/path
for bus in $V/usb[0-9]*; do mkdir $R$bus; mount --bind $bus $R$bus; done
app() {{
  chroot $R env PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={repository} \\
    /{environment}/bin/python -c 'from capture_app.cli import main; main()' "$@"
}}
app cameras --json >/out/cameras.json 2>/out/cameras.log
app leader --host 127.0.0.1 --port 47010 --sessions /tmp/sessions 2>/out/leader.log &
app node --name left --camera '{left}' --leader 127.0.0.1:47010 --tolerance-us 2000 2>/out/left.log &
app node --name right --camera '{right}' --leader 127.0.0.1:47010 --tolerance-us 2000 2>/out/right.log &
for _ in $(seq 120); do
  [ "$(cat /out/left.log /out/right.log | grep -c ': syncing')" -lt 2 ] || break
  sleep .5
done
app burst --leader 127.0.0.1:47010 --frames {frames} --wait-s 120 --json >/out/burst.json 2>/out/burst.log
echo $? >/out/burst.code
app sessions verify /tmp/sessions/burst-001 >/out/verify.txt 2>&1
echo $? >/out/verify.code
cp -r /tmp/sessions /out/sessions
# The right camera is pulled out of its port.
echo 1 >$V/detach
for _ in $(seq 60); do
  grep -q ': camera failed' /out/right.log && break
  sleep .5
done
app status --leader 127.0.0.1:47010 --json >/out/unplugged.json
# And put back.
python3 -c '{plug_in_again}' &
for _ in $(seq 120); do
  grep -q ': camera is back' /out/right.log && break
  sleep .5
done
app burst --leader 127.0.0.1:47010 --frames {frames} --wait-s 120 2>/out/burst2.log
app sessions verify /tmp/sessions/burst-002 >/out/verify2.txt 2>&1
cp -r /tmp/sessions/burst-002 /out/sessions
echo $? >/out/verify2.code
"""


@pytest.fixture(scope="module")
def camera_vm(shared: Path) -> Path:
    return find_camera_vm(shared)


@pytest.fixture(scope="module")
def rig(camera_vm: Path, tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """One boot: two nodes and a leader, one burst; then a camera is unplugged, and put back."""
    try:
        root = debian_root()
    except NoRootError as reason:
        skip(str(reason))
    script = RIG.format(
        root=root,
        environment=ENVIRONMENT,
        repository=ROOT,
        usb_cameras=camera_vm / "usb_cameras.py",
        left=LEFT,
        right=RIGHT,
        frames=FRAMES,
        plug_in_again=PLUG_IN_AGAIN.format(camera_vm=camera_vm),
    )
    return boot(camera_vm, script, tmp_path_factory.mktemp("libcamera"), last="verify2.code")


def test_webcams_are_listed_once_as_those_of_v4l2(rig: Rig) -> None:
    listed = [camera["spec"] for camera in rig.json("cameras.json")["cameras"]]
    real = [spec for spec in listed if not spec.startswith("sim:")]
    assert real == ["v4l2:/dev/video0", "v4l2:/dev/video2"], rig.logs


def test_a_burst_of_both_cameras_is_saved_and_verifies(rig: Rig) -> None:
    assert rig.text("burst.code").strip() == "0", rig.logs
    assert rig.text("verify.code").strip() == "0", rig.text("verify.txt")
    burst = rig.json("burst.json")
    assert (burst["received"], burst["expected"]) == (2 * FRAMES, 2 * FRAMES)


def test_the_cameras_were_aligned_by_restarts_to_within_2_ms(rig: Rig) -> None:
    session = rig.session()
    assert [camera.name for camera in session.manifest.cameras] == ["left", "right"]
    for camera in session.manifest.cameras:
        facts = camera.facts
        assert (facts.kind, facts.phase_control, facts.pixel_format) == ("libcamera", "reset", "MJPG")
        assert (facts.width, facts.height, facts.period_ns) == (320, 240, 33_333_333)
    rig.assert_aligned(session, TOLERANCE_NS)


def test_a_webcams_stamp_is_not_believed_to_be_its_light(rig: Rig) -> None:
    for camera in rig.session().manifest.cameras:
        stamp = camera.facts.stamp
        assert stamp is not None
        assert stamp.source == "profile"
        assert stamp.uncertainty_ns > 10_000_000


def test_the_cameras_own_jpegs_were_saved_untouched_and_in_their_order(rig: Rig, camera_vm: Path) -> None:
    session = rig.session()
    sent = (camera_vm / "frame.jpg").read_bytes()
    for image in session.manifest.images:
        assert session.image_file(image).read_bytes() == sent
    for name in ("left", "right"):
        numbers = [image.sequence for image in session.manifest.images if image.camera == name]
        assert None not in numbers
        assert [number - numbers[0] for number in numbers] == list(range(FRAMES))


def test_an_unplugged_camera_shows_as_failed_and_the_other_runs_on(rig: Rig) -> None:
    nodes = {node["name"]: node for node in rig.json("unplugged.json")["nodes"]}
    assert nodes["right"]["state"] == "failed", rig.logs
    assert "VHCI-2" in nodes["right"]["message"]
    assert nodes["left"]["state"] == "ready", rig.logs


def test_a_camera_that_is_put_back_is_aligned_again(rig: Rig) -> None:
    assert "camera is back" in rig.text("right.log"), rig.logs
    assert rig.text("verify2.code").strip() == "0", rig.text("verify2.txt")
    rig.assert_aligned(rig.session("burst-002"), TOLERANCE_NS)
