"""A virtual machine with the kernel's own camera drivers, and USB cameras that they take for real."""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from capture_app.session.reading.reader import Session

BOOT_SECONDS = 1500
"""On a busy machine; on a quiet one the rigs need two minutes."""

# Virtual time, an instruction a nanosecond: the host's load stays out of the cameras' timing.
MACHINE = {
    "ACCEL": "tcg,thread=single",
    "SMP": "1",
    "QEMU_EXTRA": "-icount shift=0,sleep=off",
    "NDEV": "0",
    "MODS": "vhci-hcd uvcvideo",
    # The virtual hub loses its cameras when several wake up at once; real hubs do not.
    "APPEND": "usbcore.autosuspend=-1",
    "TMO": str(BOOT_SECONDS),
}

PLUG_IN_AGAIN = """
import pathlib, socket, sys, threading
sys.path.insert(0, "{camera_vm}")
import usb_cameras
near, far = socket.socketpair()
usb_cameras.Camera(near, 1, pathlib.Path("{camera_vm}/frame.jpg").read_bytes()).start()
pathlib.Path("/sys/devices/platform/vhci_hcd.0/attach").write_text(f"1 {{far.fileno()}} 65539 3")
far.detach()
threading.Event().wait()
"""


@dataclass(frozen=True)
class Rig:
    """What came out of the guest."""

    out: Path

    def text(self, name: str) -> str:
        return (self.out / name).read_text()

    def session(self, name: str = "burst-001") -> Session:
        return Session.open(self.out / "sessions" / name)

    def json(self, name: str) -> dict[str, Any]:
        return json.loads(self.text(name))

    @property
    def logs(self) -> str:
        return "\n".join(f"--- {log.name}\n{log.read_text()}" for log in sorted(self.out.glob("*.log")))

    def assert_aligned(self, session: Session, tolerance_ns: int) -> None:
        """Every instant has both cameras, and each camera's frames lie within the tolerance of the instants.

        By their median: a stamp is the arrival of a frame's first bytes, which a busy guest may delay.
        """
        for images in session.images_by_instant():
            assert set(images) == {"left", "right"}, self.logs
        for name in ("left", "right"):
            residuals_ns = [image.residual_ns for image in session.manifest.images if image.camera == name]
            assert abs(median(residuals_ns)) <= tolerance_ns, self.logs


def find_camera_vm(shared: Path) -> Path:
    """The scripts that boot the machine; without them, or qemu where it cannot be installed, no test."""
    folder = shared / "camera-vm"
    reason = ""
    if not (folder / "boot.sh").is_file():
        reason = f"no {folder.name}/boot.sh in the shared folder"
    elif shutil.which("qemu-system-x86_64") is None and os.geteuid() != 0:
        reason = "no qemu: sudo apt-get install qemu-system-x86 busybox-static kmod cpio"
    if reason:
        skip(reason)
    return folder


def skip(reason: str) -> None:
    """Skip, but in CI, where what is missing is a failure."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


def boot(camera_vm: Path, script: str, out: Path, *, last: str) -> Rig:
    """Run a script in the guest, as root; its `/out` is `out`, `last` the last file that it makes there."""
    done = subprocess.run(
        ["bash", camera_vm / "boot.sh", script],
        env={**os.environ, **MACHINE, "OUT": str(out)},
        capture_output=True,
        text=True,
        timeout=BOOT_SECONDS + 60,
        check=False,
    )
    (out / "machine.log").write_text(done.stdout + done.stderr)
    result = Rig(out)
    assert (out / last).is_file(), f"the rig did not finish (exit {done.returncode})\n{result.logs}"
    return result
