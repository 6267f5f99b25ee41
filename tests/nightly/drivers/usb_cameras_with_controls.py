"""Runs in the camera VM: two virtual USB cameras with exposure, gain, white balance and focus.

    python3 usb_cameras_with_controls.py FOLDER_OF_usb_cameras.py LOG

The first one chooses its exposure by itself, anew each time that it is asked, and says so (GET_INFO); the
second has no focus, and a shorter range of exposures. What the driver sets is written to LOG, a line each.
"""

import struct
import sys
import threading
import time
from pathlib import Path
from socket import socketpair
from typing import Any

sys.path.insert(0, sys.argv[1])
import usb_cameras  # type: ignore[import-not-found]

CAMERA_TERMINAL, PROCESSING_UNIT = 1, 2
AE_MODE, EXPOSURE, FOCUS, FOCUS_AUTO = 2, 4, 6, 8
GAIN, WHITE_BALANCE, WHITE_BALANCE_AUTO = 4, 10, 11
SET_CUR, GET_CUR, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF = 1, *range(0x81, 0x88)
MANUAL, APERTURE_PRIORITY = 1, 8
SETTABLE, AND_CHANGES_ITSELF = 3, 11

HAS = {
    # Bits of bmControls: exposure, its mode, focus, that automatic; gain, white balance, that automatic.
    "left": (bytes([0x2A, 0, 0x02]), bytes([0x41, 0x12])),
    "right": (bytes([0x0A, 0, 0]), bytes([0x41, 0x12])),
}
OLD_TERMINAL, OLD_UNIT = bytes([3, 0x0A, 0, 0]), bytes([5, 2, 1, 0, 0, 2, 1, 0, 0])


class CameraWithControls(usb_cameras.Camera):  # type: ignore[misc]
    """`name` says which of the two."""

    def __init__(self, *arguments: Any, name: str, log: Path, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.side, self._log, self._asked = name, log, 0
        most = 10_000 if name == "left" else 30
        # Form, least, most, step and default of each.
        self._ranges = {
            (CAMERA_TERMINAL, AE_MODE): ("<B", 1, 8, MANUAL | APERTURE_PRIORITY, APERTURE_PRIORITY),
            (CAMERA_TERMINAL, EXPOSURE): ("<I", 1, most, 1, 100),
            (CAMERA_TERMINAL, FOCUS): ("<H", 0, 250, 5, 0),
            (CAMERA_TERMINAL, FOCUS_AUTO): ("<B", 0, 1, 1, 1),
            (PROCESSING_UNIT, GAIN): ("<H", 0, 100, 1, 20),
            (PROCESSING_UNIT, WHITE_BALANCE): ("<H", 2000, 7500, 10, 4600),
            (PROCESSING_UNIT, WHITE_BALANCE_AUTO): ("<B", 0, 1, 1, 1),
        }
        self._now = {key: default for key, (_, _, _, _, default) in self._ranges.items()}
        self._now[CAMERA_TERMINAL, EXPOSURE] = 20

    def control(self, setup: bytes, out: bytes) -> bytes | None:
        """Answer a control request; None stalls."""
        kind, request, value, index, length = struct.unpack("<BBHHH", setup)
        if (kind, request, value >> 8) == (0x80, 6, 2):
            terminal, unit = HAS[self.side]
            config = usb_cameras.CFG.replace(OLD_TERMINAL, OLD_TERMINAL[:1] + terminal)
            return bytes(config.replace(OLD_UNIT, OLD_UNIT[:6] + unit + b"\0"))[:length]
        key = index >> 8, value >> 8
        if kind & 0x7F != 0x21 or index & 255 != 0 or key not in self._ranges:
            return super().control(setup, out)
        form, least, most, step, default = self._ranges[key]
        if request == SET_CUR:
            (self._now[key],) = struct.unpack(form, out)
            with self._log.open("a") as log:
                log.write(f"{self.side} {time.monotonic():.3f} {key[0]} {key[1]} {self._now[key]}\n")
            return b""
        if request == GET_INFO:
            return bytes([AND_CHANGES_ITSELF if key == (CAMERA_TERMINAL, EXPOSURE) else SETTABLE])
        if request == GET_LEN:
            return struct.pack("<H", struct.calcsize(form))
        if request == GET_CUR and key == (CAMERA_TERMINAL, EXPOSURE) and not self._is_manual:
            self._asked += 1
            self._now[key] = 20 + self._asked % 7
        answers = {GET_CUR: self._now[key], GET_MIN: least, GET_MAX: most, GET_RES: step, GET_DEF: default}
        return struct.pack(form, answers[request]) if request in answers else None

    @property
    def _is_manual(self) -> bool:
        return self._now[CAMERA_TERMINAL, AE_MODE] == MANUAL


def main() -> None:
    """Plug both in, and stay."""
    log = Path(sys.argv[2])
    log.touch()
    jpeg = Path(sys.argv[1], "frame.jpg").read_bytes()
    hub = Path("/sys/devices/platform/vhci_hcd.0/attach")
    for number, name in enumerate(HAS):
        near, far = socketpair()
        CameraWithControls(near, number, jpeg, name=name, log=log).start()
        hub.write_text(f"{number} {far.fileno()} {65536 + 2 + number} 3")
        far.detach()
    threading.Event().wait()


main()
