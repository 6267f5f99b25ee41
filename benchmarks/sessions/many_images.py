"""What large sessions cost: import and verify beside cp and sha256sum, and opening up to a million images.

    python -m benchmarks.sessions.many_images [--images 800] [--largest 1000000]

The images are drawn, of about 1 kB and 250 kB, of two cameras. Processor time is that of the whole command,
its start included. The sessions that are only opened have the manifest of a simulated rig of ten cameras, and
empty files.
"""

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.report import Report, new_parser, print_report, print_table, talk
from capture_app.session.files.untrusted_files import indented
from capture_app.session.format.manifest import MANIFEST

SAMPLES = Path(__file__).parents[2] / "sample_sessions"
PICTURES = {"1 kB": (64, 32), "250 kB": (1280, 720)}
SESSIONS = (sys.executable, "-m", "capture_app.cli", "sessions")
OPEN = (
    "import sys; from pathlib import Path; from capture_app.session.reading.reader import Session; "
    "Session.open(Path(sys.argv[1]))"
)
HASH = "find . -type f -name '*.jpg' -print0 | xargs -0 sha256sum"
MEASURE = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True); "
MEASURE += "r = resource.getrusage(resource.RUSAGE_CHILDREN); print(r.ru_utime + r.ru_stime, r.ru_maxrss)"


def cost(*words: str | Path, folder: Path) -> tuple[float, float]:
    """Run a command in a folder; return its processor time in s and its largest memory in MB."""
    quiet = ("sh", "-c", '"$@" >/dev/null 2>&1', "sh", *words)
    said = subprocess.run(
        (sys.executable, "-c", MEASURE, *quiet), check=True, capture_output=True, text=True, cwd=folder
    ).stdout
    used_s, kilobytes = map(float, said.split())
    return used_s, kilobytes / 1024


def write_images(folder: Path, count: int, size: tuple[int, int]) -> None:
    """Write a drawn picture that moves, `count` times for two cameras together."""
    noise = np.random.default_rng(0).integers(0, 256, (size[1] // 4, size[0] // 4, 3), dtype=np.uint8)
    picture = cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
    for camera in ("left", "right"):
        (folder / camera).mkdir(parents=True)
        for n in range(count // 2):
            moved = np.roll(picture, 3 * n, axis=1)
            cv2.imwrite(str(folder / camera / f"{n:06d}.jpg"), moved, [cv2.IMWRITE_JPEG_QUALITY, 60])


def write_session(folder: Path, count: int) -> None:
    """Write a session of ten cameras whose records are as those of the sample `crossing`."""
    manifest = msgspec.json.decode((SAMPLES / "crossing" / MANIFEST).read_bytes())
    camera, image = manifest["cameras"][0], manifest["images"][0]
    names = [f"cam{n:02d}" for n in range(10)]
    for name in names:
        (folder / "images" / "rig1" / name).mkdir(parents=True)
    images = []
    for n in range(count):
        name, instant = names[n % 10], n // 10
        path = f"images/rig1/{name}/{instant:06d}.jpg"
        (folder / path).touch()
        own = {"camera": name, "instant": instant, "path": path, "leader_ns": 10**9 + 10**7 * instant}
        images.append(image | own | {"sha256": hashlib.sha256(path.encode()).hexdigest()})
    manifest["burst"]["instants_ns"] = [10**9 + 10**7 * n for n in range(-(-count // 10))]
    manifest |= {"cameras": [camera | {"name": name} for name in names], "images": images, "missing": []}
    (folder / MANIFEST).write_bytes(indented(msgspec.json.encode(manifest)))


def measure_commands(folder: Path, count: int) -> list[Report]:
    """Return processor times, ms an image, of import and verify and of the tools that only copy and hash."""
    rows: list[Report] = []
    for name, size in PICTURES.items():
        source = folder / name.replace(" ", "-")
        write_images(source, count, size)
        orders = {
            "import": (*SESSIONS, "import", source, "--out", folder / "sessions", "--fps", "30"),
            "cp": ("cp", "-r", source, folder / "copy"),
            "verify": (*SESSIONS, "verify", folder / "sessions" / source.name),
            "sha256sum": ("sh", "-c", HASH),
        }
        places = {"sha256sum": source}
        costs = {
            order: cost(*words, folder=places.get(order, folder))[0] * 1000 / count
            for order, words in orders.items()
        }
        rows.append({"images": name, **costs})
        subprocess.run(("rm", "-r", folder / "copy"), check=True)
    return rows


def measure_opening(folder: Path, largest: int) -> list[Report]:
    """Return processor time and memory by which sessions of up to so many images are opened."""
    rows: list[Report] = []
    for count in (largest // 100, largest // 10, largest):
        talk(f"opening a session of {count} images")
        session = folder / str(count)
        write_session(session, count)
        used_s, used_mb = cost(sys.executable, "-c", OPEN, session, folder=folder)
        rows.append({"images": count, "s": used_s, "mb": used_mb})
        subprocess.run(("rm", "-r", session), check=True)
    return rows


def print_tables(report: Report) -> None:
    """Print both tables."""
    orders = ("import", "cp", "verify", "sha256sum")
    print_table(
        ("image", *(f"{order}, CPU-ms" for order in orders)),
        [[row["images"], *(f"{row[order]:.2f}" for order in orders)] for row in report["commands"]],
    )
    print_table(
        ("images", "opened in, CPU-s", "memory, MB"),
        [[f"{row['images']}", f"{row['s']:.2f}", f"{row['mb']:.0f}"] for row in report["opening"]],
    )


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--images", type=int, default=800, help="number of images that are imported (800)")
    parser.add_argument("--largest", type=int, default=1_000_000, help="images of the largest session")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="many-images-") as name:
        folder = Path(name)
        report: Report = {
            "commands": measure_commands(folder, given.images),
            "opening": measure_opening(folder, given.largest),
        }
    print_report(report, print_tables, as_json=given.json)


if __name__ == "__main__":
    main()
