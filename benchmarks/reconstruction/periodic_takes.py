"""Two cameras without common times film a motion that repeats: who is aligned a whole period off?

    make bench NAME=periodic            forty takes, each begun by the second camera at another time
    make bench NAME=periodic BENCH="--count 8"

A pendulum swings with periods of 0.2 to 2 s before both cameras (simulated); in every other take a second
board wanders beside it, which breaks the period. An alignment is false if its offset is more than its error
bar, and more than half a frame, from the truth. Prints one line a take, and the sums.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from capture_app.console.terminal import Progress
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.motion_alignment import align_cameras
from tests.unit.reconstruction.conftest import PERIOD_NS, Board, Scene, make_view, texture
from tests.unit.reconstruction.time_offsets.cut_apart import Recorder, wander, write_cut_apart

PERIODS_S = 0.2, 0.3, 0.5, 0.7, 0.9, 1.2, 1.6, 2.0
SECOND = {
    "beside": make_view((0.1, 0.01, 0.0), yaw=-1.5),
    "above": make_view((0.02, -0.12, 0.0)),
}
"""Views of the second camera: a pendulum crosses its lines twice in a period, or once."""


def swing(period_s: float) -> Callable[[float], tuple[float, float]]:
    """Return the path of a pendulum by the time in frames."""

    def path(periods: float) -> tuple[float, float]:
        angle = 0.5 * np.sin(2 * np.pi * periods * PERIOD_NS / 1e9 / period_s)
        return 0.6 * np.sin(angle), 0.6 * np.cos(angle) - 0.5

    return path


def scene(is_broken: bool) -> Scene:
    """Return a wall, two boards at rest, one that wanders if the period `is_broken`, and one that swings."""
    boards = [
        Board((-9, -9, 9, 9), 4.0, texture(1)),
        Board((-1.6, 0.2, -0.9, 1.4), 3.0, texture(2)),
        Board((0.9, -0.2, 1.5, 1.3), 2.6, texture(3)),
        Board((-0.2, -0.2, 0.2, 0.2), 2.2, texture(5), wander),
    ]
    if is_broken:
        walker = Board((-0.75, -0.35, -0.3, 0.1), 2.5, texture(7), wander)
        boards.insert(3, walker)
    return Scene(boards)


def main() -> None:
    """Run the takes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    sums = {"aligned": 0, "falsely aligned": 0, "refused": 0}
    broken_aligned = broken = 0
    for number in range(given.first, given.first + given.count):
        rng = np.random.default_rng(number)
        period_s = PERIODS_S[number // 2 % len(PERIODS_S)]
        is_broken = number % 2 == 1
        late_s = float(rng.uniform(0.1, 1.2))
        where = ("beside", "above")[number // 16 % 2]
        seconds = 2.5 if number % 3 else 4.0
        first = Recorder(make_view((-0.1, 0.0, 0.0), yaw=1.5))
        cameras = {
            "left": first,
            "right": Recorder(SECOND[where], start_s=late_s, fps=(30.0, 25.0)[number % 5 == 4]),
        }
        with tempfile.TemporaryDirectory() as folder:
            session = write_cut_apart(Path(folder), scene(is_broken), cameras, seconds, path=swing(period_s))
            found = align_cameras(OpenScene(Dataset.open(session.folder)), Progress(0, silent=True))["right"]
        if found.offset_ns is None:
            kind, said = "refused", found.reason
        else:
            # Both count from their own beginnings: the second's is `late_s` later.
            error_ms = found.offset_ns / 1e6 - late_s * 1e3
            bar_ms = (found.uncertainty_ns or 0) / 1e6
            is_false = abs(error_ms) > max(bar_ms, 17.0)
            kind, said = ("falsely aligned" if is_false else "aligned"), f"{error_ms:+.2f} ± {bar_ms:.2f} ms"
        sums[kind] += 1
        broken += is_broken
        broken_aligned += is_broken and kind == "aligned"
        walker = "with a walker" if is_broken else ""
        take = f"{period_s:.1f} s  {seconds:.1f} s  {late_s * 1e3:+6.0f} ms  {where:7s} {walker:14s}"
        print(f"{number:3d}  {take} {kind}: {said}", flush=True)
    print(
        ", ".join(f"{count} {kind}" for kind, count in sums.items()),
        f"; {broken_aligned} of {broken} with a walker aligned",
    )


if __name__ == "__main__":
    main()
