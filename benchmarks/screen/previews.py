"""What live previews cost: processor time of the screen, and bytes to the terminal, by cameras and rate.

The mode Shoot runs in a terminal of its own on a rig that is not there; its cameras show the pictures of a
sample session, moving, with a sensor's noise on each. Figures are of this machine and simulated pictures.

    python -m benchmarks.screen.previews --cameras 5 --size 120x40
"""

import argparse
import asyncio
import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
import time
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil

ROOT = Path(__file__).parents[2]
NOISE = 3.0
"""Standard deviation of a pixel, of 255: a webcam by lamp light."""
WARM_UP_S, SPAN_S = 4.0, 10.0
READ = 1 << 16


def show(cameras: int, stop: Path) -> None:
    """Run the screen; previews come as it asks for them."""
    from capture_app.protocol.status import Preview
    from capture_app.tui.app import SimulshotApp
    from capture_app.tui.settings import Settings
    from tests.tui.shoot.studio import ready_rig

    session = ROOT / "sample_sessions" / "jumper" / "images" / "rig1"
    views: list[Any] = [
        [cv2.imread(str(path)) for path in sorted(view.iterdir())] for view in sorted(session.iterdir())
    ]
    random = np.random.default_rng(1)
    rig = ready_rig(cameras)

    def jpeg(view: list[np.ndarray], number: int, width: int) -> bytes:
        image = cv2.resize(view[number % len(view)], (width, width * 3 // 4), interpolation=cv2.INTER_AREA)
        noisy = np.clip(image + random.normal(0, NOISE, image.shape), 0, 255).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 70])[1].tobytes())

    async def feed() -> None:
        pictures: dict[int, list[list[bytes]]] = {}
        for number in count():
            wishes = [asked for asked in rig.asked if asked[0] == "want_previews"]
            wish: tuple[Any, ...] = wishes[-1] if wishes else (None, None, 64, 0.0)
            _, _, width, fps = wish
            if not fps:
                await asyncio.sleep(0.1)
                continue
            if width not in pictures:
                # Made before they are shown: their making is a camera's work, not the screen's.
                pictures[width] = [[jpeg(view, n, width) for n in range(20)] for view in views]
            for at, node in enumerate(rig.nodes):
                data = pictures[width][at % len(views)][number % 20]
                rig.tell(
                    Preview(camera=node.name, leader_ns=number, width=width, height=width * 3 // 4, jpeg=data)
                )
            await asyncio.sleep(1 / fps)

    class Screen(SimulshotApp):
        def on_mount(self) -> None:
            super().on_mount()
            self.call_later(self.switch_mode, "shoot")
            self.run_worker(feed(), group="feed")

    Screen(rig, settings=Settings(), sessions=stop).run()


def measure(cameras: int, size: tuple[int, int]) -> dict[str, float]:
    """Bytes a second to the terminal and the share of a processor that the screen takes."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    environment = os.environ | {"TERM": "xterm-256color", "COLORTERM": "truecolor", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "benchmarks.screen.previews", "--show", str(cameras)]
    child = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    process, began, total = psutil.Process(child.pid), time.monotonic(), 0
    mark: tuple[float, float, int] | None = None
    try:
        while True:
            total += len(os.read(ours, READ))
            now = time.monotonic()
            if mark is None and now > began + WARM_UP_S:
                mark = now, sum(process.cpu_times()[:2]), total
            if mark is not None and now > mark[0] + SPAN_S:
                span = now - mark[0]
                used = sum(process.cpu_times()[:2]) - mark[1]
                return {"kB_per_s": (total - mark[2]) / span / 1e3, "processor_share": used / span}
    finally:
        child.kill()
        child.wait()
        os.close(ours)


def main() -> None:
    """Measure, and print a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, default=5)
    parser.add_argument("--size", default="120x40")
    parser.add_argument("--show", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.show:
        show(arguments.show, Path("sessions"))
        return
    columns, rows = map(int, arguments.size.split("x"))
    found = measure(arguments.cameras, (columns, rows))
    told = {"cameras": arguments.cameras, "size": arguments.size}
    print(json.dumps(told | {name: round(value, 3) for name, value in found.items()}))


if __name__ == "__main__":
    main()
