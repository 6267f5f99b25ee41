"""Pictures of depth from all cameras, synchronized beside every camera off by another time."""

from collections.abc import Mapping
from pathlib import Path

from reconstruction.common.drawing import colour_depth, display_range, mark_movers
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.multiview.instant_depth import InstantDepth
from reconstruction.scores.depth_truth import TOLERANCE_TEXT, right_depth
from reconstruction.scores.results import Picture


def write_multiview_pictures(
    photo: Array, maps: Mapping[str, InstantDepth], moving: Array, truth: Array | None, out: Path
) -> tuple[Picture, ...]:
    """Distance and what moves (bool) of one instant in both conditions, in out/pictures.

    `photo` (BGR) is the reference's undistorted picture; `truth` is in the maps' unit, NaN = unknown.
    """
    near, far = display_range(maps["synced"].depth, moving)
    paths: dict[str, dict[str, str]] = {"depth": {}, "movers": {}}
    for condition, found in maps.items():
        right = found.depth > 0
        if truth is not None:
            right &= right_depth(found.depth, truth)
        depth = colour_depth(found.depth, near, far)
        paths["depth"][condition] = save_picture(out, f"multiview_depth_{condition}.png", depth)
        marked = mark_movers(photo, moving, right)
        paths["movers"][condition] = save_picture(out, f"multiview_movers_{condition}.jpg", marked)
    judged = f"it is right {TOLERANCE_TEXT}" if truth is not None else "the other cameras agree"
    return (
        Picture(
            key="multiview_depth",
            title="Distance from all cameras",
            caption="Bright is near, blue is far; dark means that no distance was found. On one side all "
            "cameras show the same instant, on the other each shows another.",
            synced=paths["depth"]["synced"],
            offset=paths["depth"]["offset"],
        ),
        Picture(
            key="multiview_movers",
            title="What moves, by all cameras",
            caption=f"Teal: a distance was found, and {judged}. Orange: none, or a wrong one.",
            synced=paths["movers"]["synced"],
            offset=paths["movers"]["offset"],
        ),
    )
