"""Live depth beside a rig of five replayed VGA cameras: rate and delay, cost to the rig, and a burst.

    python -m benchmarks.reconstruction.live_depth --seconds 30

Leader, cameras and depth are processes on this machine's loopback. The cameras deliver JPEGs of the sample
session `jumper`, as webcams do. Phase errors and clock error bars are read twice a second, without depth and
with it; then a burst is taken. Replayed cameras, real processes.
"""

import asyncio
import os
import tempfile
from contextlib import AsyncExitStack, aclosing
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app import AsyncRig
from capture_app.common.child import Child
from capture_app.protocol.status import NodeStatus
from capture_app.rig.live_pictures import live_depth
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import DepthPreview

LOOK_S = 0.5
JUMPER = Path(__file__).parents[2] / "sample_sessions" / "jumper"


async def look(rig: AsyncRig, seconds: float) -> dict[str, Any]:
    """Return the rig's phase errors and clock uncertainties over a time, us."""
    seen: list[NodeStatus] = []
    for _ in range(round(seconds / LOOK_S)):
        await asyncio.sleep(LOOK_S)
        seen += (await rig.status()).cameras
    phases = [abs(node.phase_error_ns) / 1e3 for node in seen if node.phase_error_ns is not None]
    clocks = [node.uncertainty_ns / 1e3 for node in seen if node.uncertainty_ns is not None]
    return {
        "phase_us": float(np.median(phases)),
        "phase_95_us": float(np.percentile(phases, 95)),
        "clock_us": float(np.median(clocks)),
    }


async def measure(seconds: float, images: int, sessions: Path) -> dict[str, Any]:
    """Run the rig, without live depth and with it, and return rows of both and the burst."""
    async with AsyncExitStack() as stack:
        rig = await stack.enter_async_context(AsyncRig(sessions=sessions))
        names = sorted(folder.name for folder in (JUMPER / "images" / "rig1").iterdir())
        for name in names:
            camera = f"replay:{JUMPER},camera={name}"
            command = (
                "capture_app.cli",
                "node",
                "--name",
                name,
                "--camera",
                camera,
                "--leader",
                f"{rig.address}",
            )
            child = await Child.start(name, command)
            stack.push_async_callback(child.stop)
        status = await rig.wait_until_ready(len(names), 120.0)
        await rig.burst(1)  # which has the recording's calibration
        talk("without live depth ...")
        rows = [{"depth": "none", **await look(rig, seconds)}]
        shown: list[DepthPreview] = []
        first = asyncio.Event()

        async def follow() -> None:
            async with aclosing(live_depth(RigLink(rig.address), status, lambda: "cam04")) as depths:
                async for depth in depths:
                    if depth.jpeg:
                        shown.append(depth)
                        first.set()

        async with asyncio.timeout(seconds + 60), asyncio.TaskGroup() as group:
            following = group.create_task(follow())
            await first.wait()
            talk("with live depth ...")
            before = len(shown)
            rows.append({"depth": "live", **await look(rig, seconds)})
            rows[-1]["maps_per_s"] = (len(shown) - before) / seconds
            burst = await rig.burst(images)
            following.cancel()
    late_ms = [depth.late_ns / 1e6 for depth in shown if depth.late_ns is not None]
    frames = [frame for instant in burst.instants for frame in instant.frames.values()]
    return {
        "rows": rows,
        "late_ms": float(np.median(late_ms)),
        "late_95_ms": float(np.percentile(late_ms, 95)),
        "burst_images": len(frames),
        "burst_missing": sum(bool(frame.missing) for frame in frames),
        "cores": os.cpu_count(),
    }


COLUMNS = {
    "depth": ("depth", ""),
    "maps_per_s": ("maps/s", ".1f"),
    "phase_us": ("phase, us", ".0f"),
    "phase_95_us": ("95 %", ".0f"),
    "clock_us": ("clock bar, us", ".0f"),
}


def show(report: dict[str, Any]) -> None:
    """Print the rows, the delay and the burst."""
    print_rows(report["rows"], COLUMNS)
    print("delay {late_ms:.0f} ms, 95 % {late_95_ms:.0f}; {cores} cores".format(**report))
    print("burst beside it: {burst_images} images, {burst_missing} missing".format(**report))


def main() -> None:
    """Print a table, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="without depth, and with it")
    parser.add_argument("--images", type=int, default=40, help="of each camera in the burst")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        report = asyncio.run(measure(asked.seconds, asked.images, Path(folder)))
    print_report(report, show, as_json=asked.json)


if __name__ == "__main__":
    main()
