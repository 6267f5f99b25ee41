"""How fast a session is written, beside `cp` and `sync` of the same bytes, and a leader's memory.

    python -m benchmarks.sessions.session_write [--cameras 20] [--instants 25] [--rounds 6]
        [--sync-ms 30] [--dir DIR]

Three ways in each round: `cp` of the images and `sync` of the disk; the session's writer, an image of each
camera at a time; and a leader's transfer server in a process of its own, fed over loopback by one stream
a camera from another process, from the first report to the manifest. Every session is verified.
Then a small burst, with spools, whose processes need longer for each sync: a stand-in for a slow disk.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import Columns, new_parser, print_report, print_rows, print_table
from benchmarks.sessions.session_transfer import CAMERA, HEIGHT, PERIOD_NS, WIDTH, instants_ns, names
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter


def make_images(folder: Path, cameras: int, instants: int) -> int:
    """Write pictures with the detail and noise of a camera's, each different; return their bytes."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (HEIGHT // 24, WIDTH // 24, 3), np.uint8)
    scene = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    total = 0
    for instant in range(instants):
        noise = rng.normal(0, 5, (HEIGHT, WIDTH, 3)).astype(np.int16)
        picture = np.clip(np.roll(scene, 7 * instant, axis=1) + noise, 0, 255).astype(np.uint8)
        data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
        for number, name in enumerate(names(cameras)):
            (folder / name).mkdir(parents=True, exist_ok=True)
            # What follows the end of a JPEG is not shown: enough to make each file another one.
            (folder / name / f"{instant:06d}.jpg").write_bytes(data + number.to_bytes(2, "big"))
            total += len(data) + 2
    return total


def copy(source: Path, to: Path) -> float:
    """Seconds to copy all files and see them on the disk."""
    began_s = time.perf_counter()
    subprocess.run(["cp", "-r", str(source), str(to)], check=True)
    subprocess.run(["sync", "--file-system", str(to)], check=True)
    return time.perf_counter() - began_s


def write(images: dict[tuple[str, int], bytes], root: Path, cameras: int, instants: int) -> float:
    """Seconds from an empty folder to the manifest, with the images in memory."""
    times_ns = instants_ns(instants)
    began_s = time.perf_counter()
    writer = SessionWriter.create(root, "written")

    def add(of: tuple[str, int]) -> None:
        writer.add_image(images[of], camera=of[0], instant=of[1], leader_ns=times_ns[of[1]])

    with ThreadPoolExecutor(cameras) as pool:
        list(pool.map(add, sorted(images, key=lambda of: of[1])))
    writer.finish(
        [CameraRecord(name=name, facts=CAMERA) for name in names(cameras)],
        BurstRecord(instants_ns=times_ns, period_ns=PERIOD_NS),
    )
    return time.perf_counter() - began_s


def receive(
    source: Path, root: Path, cameras: int, instants: int, environment: dict[str, str] | None = None
) -> tuple[float, dict[str, float]]:
    """Seconds from the first report to the manifest, and the leader's memory in kB, CPU time and syncs."""
    size = [str(cameras), str(instants)]
    command = [sys.executable, "-m", "benchmarks.sessions.session_transfer"]
    lead = [*command, "lead", str(root), *size]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "text": True, "env": os.environ | (environment or {})}
    with subprocess.Popen(lead, **pipes) as leader:
        assert leader.stdout is not None
        port = leader.stdout.readline().strip()
        began_s = time.perf_counter()
        send = [*command, "send", str(source), port, *size]
        with subprocess.Popen(send, stdin=subprocess.PIPE, **pipes) as nodes:
            told = json.loads(leader.stdout.readline())
            seconds = time.perf_counter() - began_s
            told["node_syncs"] = int(nodes.communicate("\n")[0])
    return seconds, told


SLOW_CAMERAS, SLOW_INSTANTS = 5, 5


def measure_slow_disk(folder: Path, sync_ms: float) -> list[dict[str, Any]]:
    """A burst of 5 x 5 images to leader and spools whose disks need so long for a sync, in ms."""
    source = folder / "slow_source"
    make_images(source, SLOW_CAMERAS, SLOW_INSTANTS)
    rows = []
    for name, environment in (
        ("as it is", {}),
        ("syncs together", {"SYNC_MS": str(sync_ms)}),
        ("one after the other", {"SYNC_MS": str(sync_ms), "ONE_BY_ONE": "1"}),
    ):
        to = folder / "slow"
        to.mkdir()
        spool = {"SPOOL": str(to / "spool")}
        seconds, told = receive(source, to, SLOW_CAMERAS, SLOW_INSTANTS, environment | spool)
        rows.append(
            {
                "disk": name,
                "sync_ms": sync_ms if environment else 0.0,
                "seconds": round(seconds, 2),
                "leader_syncs": told["syncs"],
                "node_syncs": told["node_syncs"],
            }
        )
        shutil.rmtree(to)
    return rows


def measure(folder: Path, cameras: int, instants: int, rounds: int) -> dict[str, Any]:
    """All figures; every session is verified."""
    source = folder / "source"
    total = make_images(source, cameras, instants)
    images = {
        (name, number): (source / name / f"{number:06d}.jpg").read_bytes()
        for name in names(cameras)
        for number in range(instants)
    }
    os.sync()
    seconds: dict[str, list[float]] = {"copy": [], "write": [], "receive": []}
    peak_kb: list[float] = []
    cpu_s: list[float] = []
    for number in range(rounds):
        to = folder / "round"
        to.mkdir()
        # In another order each time: a disk may take what comes first faster than what comes last.
        for how in [*seconds][number % 3 :] + [*seconds][: number % 3]:
            if how == "copy":
                spent = copy(source, to / "copied")
            elif how == "write":
                spent = write(images, to, cameras, instants)
            else:
                spent, told = receive(source, to, cameras, instants)
                peak_kb.append(told["peak_kb"])
                cpu_s.append(told["cpu_s"])
            seconds[how].append(spent)
        for name in ("written", "received"):
            session = Session.open(to / name)
            problems = verify(session)
            if problems or len(session.manifest.images) != len(images):
                raise SystemExit(f"{name}: {problems[:3]}")
        shutil.rmtree(to)
    speed = {how: [total / 1e6 / spent for spent in of] for how, of in seconds.items()}
    ratios = [w / c for w, c in zip(speed["write"], speed["copy"], strict=True)]
    received = [r / c for r, c in zip(speed["receive"], speed["copy"], strict=True)]
    return {
        "images": len(images),
        "megabytes": round(total / 1e6, 1),
        "rounds": rounds,
        "copy_mb_per_s": round(statistics.median(speed["copy"]), 1),
        "write_mb_per_s": round(statistics.median(speed["write"]), 1),
        "receive_mb_per_s": round(statistics.median(speed["receive"]), 1),
        "write_to_copy": round(statistics.median(ratios), 2),
        "write_to_copy_worst": round(min(ratios), 2),
        "receive_to_copy": round(statistics.median(received), 2),
        "leader_peak_mb": round(max(peak_kb) / 1000, 1),
        "leader_cpu_s": round(statistics.median(cpu_s), 2),
    }


SLOW_COLUMNS: Columns = {
    "disk": ("disk", ""),
    "sync_ms": ("a sync, ms", ".0f"),
    "seconds": ("seconds", ".2f"),
    "leader_syncs": ("leader's syncs", ""),
    "node_syncs": ("nodes' syncs", ""),
}


def main() -> None:
    """Read the options, measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--instants", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument(
        "--dir", type=Path, help="a folder on the disk to measure; default: the temporary one"
    )
    parser.add_argument(
        "--sync-ms", type=float, default=30.0, help="what a sync takes longer on the slow disk (30)"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.dir) as folder:
        figures = measure(Path(folder), options.cameras, options.instants, options.rounds)
        figures["slow_disk"] = measure_slow_disk(Path(folder), options.sync_ms)
    print_report(figures, _print, as_json=options.json)


def _print(figures: dict[str, Any]) -> None:
    print(f"{figures['images']} images, {figures['megabytes']} MB, medians of {figures['rounds']} rounds")
    rows = [
        ("cp and sync", f"{figures['copy_mb_per_s']:.1f}", ""),
        ("session written", f"{figures['write_mb_per_s']:.1f}", f"{figures['write_to_copy']:.2f}"),
        (
            "session received over loopback",
            f"{figures['receive_mb_per_s']:.1f}",
            f"{figures['receive_to_copy']:.2f}",
        ),
    ]
    print_table(("", "MB/s", "times cp"), rows)
    print(f"the worst round wrote at {figures['write_to_copy_worst']:.2f} times cp's speed")
    print(f"\n{SLOW_CAMERAS} x {SLOW_INSTANTS} images, to a leader and spools on a slow disk (a stand-in)")
    print_rows(figures["slow_disk"], SLOW_COLUMNS)
    print(f"leader's peak memory {figures['leader_peak_mb']:.0f} MB, CPU {figures['leader_cpu_s']:.1f} s")


if __name__ == "__main__":
    main()
