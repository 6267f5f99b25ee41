"""Depth and views of a rendered rig of four calibrated cameras: in step, and in two steps.

In two steps, cam0 and cam1 take each instant, and cam2 and cam3 half a period later; each pair spans the rig.
The engine takes the burst in virtual time. "As one moment" matches all four as if they were in step. Depth is
of what moves, the mean of all cameras. A view from the middle is compared with the true picture of each
step's time, where something moves. Simulated.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import PropertyMock, patch

import numpy as np
from msgspec.structs import replace

from benchmarks.reconstruction.novel_view_scenes import JUMPER, Held, render_places
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows, talk
from benchmarks.samples.recipe import CameraRecipe, Recipe
from benchmarks.samples.render import open_sources, render
from benchmarks.samples.takes import take_synchronized
from capture_app.common.stagger import Stagger
from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.method.interface import find_method
from reconstruction.method.picture_quality import psnr
from reconstruction.scene.dataset import Dataset

SCENE = "studio"
VIEWS = {"cam0": "cam05", "cam1": "cam01", "cam2": "cam00", "cam3": "cam04"}
"""Each camera's view of the scene, in which a child jumps and a pinwheel turns."""
TWO_STEPS = Stagger.parse("cam2=16.667ms,cam3=16.667ms")
PLACE = "between"
COLUMNS: Columns = {
    "rig": ("rig", ""),
    "mover_coverage": ("moving: with depth", ".0%"),
    "mover_within": ("within 2 %", ".0%"),
    "static_within": ("at rest: within 2 %", ".0%"),
    "first_db": ("view at step 1: dB", ".1f"),
    "second_db": ("at step 2: dB", ".1f"),
}


def render_rig(root: Path, stagger: Stagger | None, *, frames: int = 5, scale: float = 1.0) -> Session:
    """Render the rig's session, with the truth of each image's depth, into a folder of `root`."""
    recipe = Recipe(
        name="in-step" if stagger is None else "two-steps",
        scene=SCENE,
        cameras=tuple(CameraRecipe(name=name, view=view) for name, view in VIEWS.items()),
        created="2026-11-25T12:00:00.000Z",
        seed=5,
        frames=frames,
        scale=scale,
    )
    take = take_synchronized(recipe, open_sources(recipe), stagger)
    return render(replace(recipe, take=take), root)[0]


def true_view(session: Session, camera: str, instant: int) -> Held:
    """Return what a camera in the middle would see when a camera takes its image of an instant."""
    (image,) = (one for one in session.manifest.images if (one.camera, one.instant) == (camera, instant))
    assert image.exposure_start_ns is not None
    assert image.exposure_ns is not None
    row_time_ns = session.camera(camera).facts.row_time_ns or 0
    shutter = image.exposure_start_ns, image.exposure_ns, row_time_ns
    return render_places(SCENE, {PLACE: JUMPER[PLACE]}, shutter)[PLACE]


@contextmanager
def as_one_moment() -> Iterator[None]:
    """Match all cameras of an instant, whatever their steps."""
    steps_ns = dict.fromkeys(VIEWS, 0)
    with patch.object(Dataset, "steps_ns", new_callable=PropertyMock, return_value=steps_ns):
        yield


def _score(session: Session, instant: int, truths: list[Held]) -> dict[str, Any]:
    """Return the depth's scores, and the views' PSNR at the times of the truths."""
    with tempfile.TemporaryDirectory() as folder:
        multiview = find_method("multiview", instant=instant, mesh=False, quick=True)
        views = multiview.make([session.folder], Path(folder, "depth")).views
        lens = truths[0].view.to_calibration()
        made = open_session(session.folder).view(instant=instant, path=(lens, lens), quick=True)
        pictures = [made.frame(number) for number in (0, 1)]
    first_db, second_db = (
        psnr(picture, held.picture, held.moving) for picture, held in zip(pictures, truths, strict=True)
    )
    return {
        "mover_coverage": float(np.mean([one.mover_coverage for one in views])),
        "mover_within": float(np.mean([one.mover_within_2pct for one in views])),
        "static_within": float(np.mean([one.static_within_2pct for one in views])),
        "first_db": first_db,
        "second_db": second_db,
    }


def measure(instant: int, scale: float) -> Report:
    """Render both rigs, and score them and the staggered one as if in step."""
    with tempfile.TemporaryDirectory() as folder:
        talk("rendering")
        in_step, steps = (
            render_rig(Path(folder), stagger, frames=instant + 2, scale=scale)
            for stagger in (None, TWO_STEPS)
        )
        truths = [true_view(steps, camera, instant) for camera in ("cam0", "cam2")]
        own = [true_view(in_step, "cam0", instant)] * 2
        talk("depth and views")
        rows = [
            {"rig": "in step", **_score(in_step, instant, own)},
            {"rig": "two steps", **_score(steps, instant, truths)},
        ]
        with as_one_moment():
            rows.append({"rig": "two steps, as one moment", **_score(steps, instant, truths)})
    return {"kind": "simulated", "instant": instant, "rigs": rows}


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--instant", type=int, default=2, help="instant that is judged (2)")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images (1)")
    options = parser.parse_args()
    report = measure(options.instant, options.scale)
    print_report(report, lambda found: print_rows(found["rigs"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
