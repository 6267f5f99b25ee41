"""Depth of an object by rigs of every kind, rendered, with exact truth; ends with one line of JSON.

    python -m benchmarks.reconstruction.any_rig                       all rigs, pictures 640 wide
    python -m benchmarks.reconstruction.any_rig --rig "ring of 12" --width 320

Shares are of all cameras' pixels on the object that another camera sees too, unoccluded, from a direction at
most 35 degrees away; empty ones count as wrong. False points of the fused cloud are farther from any true
surface than 2 % of their distance to the nearest camera; flakes are points on the object farther from it than
5 % of its size, exact ones within 1 %; covered is the share of those pixels with a point within 1 cm.
Simulated pictures.
"""

import json
import time
from typing import Any

import numpy as np

from benchmarks.reconstruction.rendered_rigs import AIM, AROUND_M, RIGS, SIZE_M, RenderedRig, render_rig
from benchmarks.report import new_parser, print_rows, talk
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.view_choice import choose_source_views, seen_points, smallest_group
from reconstruction.methods.multiview.fusion import fuse_maps
from reconstruction.methods.multiview.input_images import InputImage, undistort_image
from reconstruction.methods.multiview.instant_scoring import count_near, visible_points
from reconstruction.methods.multiview.sweep_matcher import ViewDepth, match_all_views

SEEN_WITHIN_DEG = 35.0
RIGHT, WRONG = 0.01, 0.02
FALSE_SHARE = 0.02
FLAKE, EXACT = 0.05, 0.01

COLUMNS = {
    "rig": ("rig", ""),
    "cameras": ("cameras", ""),
    "object_within_1pct": ("object within 1 %", ".1%"),
    "worst_view": ("worst view", ".1%"),
    "object_wrong": ("over 2 % off", ".1%"),
    "around_within_1pct": ("around it", ".1%"),
    "points": ("points", ""),
    "false_points": ("false", ".2%"),
    "flakes": ("flakes", ".2%"),
    "exact": ("exact", ".1%"),
    "covered": ("covered", ".1%"),
    "cpu_s_per_map": ("cpu s/map", ".1f"),
    "refused": ("refused", ""),
}


def seen_twice(rig: RenderedRig, camera: str) -> Array:
    """Return a camera's pixels (bool) that another camera also sees, from a similar direction."""
    view, depth = rig.views[camera], rig.depth[camera]
    points = view.unproject(view.grid(), depth.reshape(-1).astype(float))
    seen = np.zeros(len(points), bool)
    for other, other_view in rig.views.items():
        if other != camera:
            angle = seen_points(view, other_view, points)[1]
            seen |= visible_points(other_view, rig.depth[other], points) & (angle < SEEN_WITHIN_DEG)
    return seen.reshape(depth.shape) & (depth > 0)


def measure(rig: RenderedRig) -> dict[str, Any]:
    """Return a row of the table."""
    row: dict[str, Any] = {"rig": rig.name, "cameras": len(rig.views)}
    begun = time.process_time()
    images = {name: undistort_image(name, 0, rig.pictures[name], view) for name, view in rig.views.items()}
    calibrated = {name: image.calibrated for name, image in images.items()}
    try:
        scene = find_rough_scene(calibrated)
        sources = choose_source_views({name: rig.views[name] for name in scene.points}, scene.points)
        found = match_all_views(calibrated, sources, scene.depth_ranges, has_thin=scene.has_thin)
    except BadInputError as error:
        return row | {"object_within_1pct": 0.0, "refused": error.what}
    row["cpu_s_per_map"] = round((time.process_time() - begun) / max(1, len(found)), 2)
    return row | _depth_scores(rig, found) | _cloud_scores(rig, images, found, smallest_group(sources))


def _depth_scores(rig: RenderedRig, found: dict[str, ViewDepth]) -> dict[str, float]:
    right, wrong, around, worst = [], [], [], 1.0
    for camera, true in rig.depth.items():
        depth = found[camera].depth if camera in found else np.zeros_like(true)
        error = np.where(depth > 0, np.abs(depth - true) / np.maximum(true, 1e-9), 1.0)
        seen = seen_twice(rig, camera)
        thing = seen & rig.object_mask[camera]
        right.append(error[thing] < RIGHT)
        wrong.append((error[thing] > WRONG) & (depth[thing] > 0))
        around.append(error[seen & ~thing] < RIGHT)
        worst = min(worst, float(np.mean(right[-1])) if right[-1].size else 1.0)
    return {
        "object_within_1pct": round(float(np.mean(np.concatenate(right))), 4),
        "worst_view": round(worst, 4),
        "object_wrong": round(float(np.mean(np.concatenate(wrong))), 4),
        "around_within_1pct": round(float(np.mean(np.concatenate(around))), 4),
    }


def _cloud_scores(
    rig: RenderedRig, images: dict[str, InputImage], found: dict[str, ViewDepth], group: int
) -> dict[str, float]:
    views = {name: rig.views[name] for name in found}
    points = fuse_maps(views, found, {name: images[name].colours for name in found}, group).points
    if not len(points):
        return {"points": 0, "false_points": 0.0}
    nearest = np.min([np.linalg.norm(points - view.centre, axis=1) for view in views.values()], axis=0)
    off_m = rig.distance_m(points)
    false = off_m > FALSE_SHARE * nearest
    of_object = np.linalg.norm(points - AIM, axis=1) < AROUND_M
    right, asked = count_near(points, np.concatenate([_seen_surface(rig, name) for name in rig.views]))
    return {
        "points": len(points),
        "false_points": round(float(np.mean(false)), 4),
        "flakes": round(float(np.mean(off_m[of_object] > FLAKE * SIZE_M)), 5),
        "exact": round(float(np.mean(off_m[of_object] < EXACT * SIZE_M)), 4),
        "covered": round(right / asked, 4),
    }


def _seen_surface(rig: RenderedRig, camera: str) -> Array:
    """Return points (n, 3) of the object that a camera and at least one other see."""
    view, seen = rig.views[camera], seen_twice(rig, camera) & rig.object_mask[camera]
    return view.unproject(view.grid()[seen.ravel()], rig.depth[camera][seen].astype(float))


def main() -> None:
    """Print a table, then one line of JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--rig", action="append", choices=list(RIGS), help="[default: all]")
    parser.add_argument("--width", type=int, default=640, help="of most pictures, px (640)")
    chosen = parser.parse_args()
    rows = []
    for name in chosen.rig or RIGS:
        rows.append(measure(render_rig(name, RIGS[name], scale=chosen.width / 320)))
        talk(f"{name}: {rows[-1]['object_within_1pct']:.1%} of the object within 1 %")
    if not chosen.json:
        print_rows([{key: row.get(key) for key in COLUMNS} for row in rows], COLUMNS)
    print(json.dumps({"any_rig": {row.pop("rig"): row for row in rows}}))


if __name__ == "__main__":
    main()
