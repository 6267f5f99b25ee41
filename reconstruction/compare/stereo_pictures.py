"""The pictures of a pair's depth, synchronized and offset, of the instant that shows it most clearly."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.common.drawing import (
    EMPTY,
    box_around,
    colour_depth,
    display_range,
    draw_rows,
    enlarge_crop,
    mark_movers,
    side_by_side,
)
from reconstruction.common.geometry import Array
from reconstruction.compare.study import SIDES, write_pictures
from reconstruction.scores.depth_truth import TOLERANCE_TEXT, right_depth
from reconstruction.scores.results import Picture
from reconstruction.session.dataset import Dataset
from reconstruction.stereo.stereo_pair import DepthMap, StereoPair


@dataclass(frozen=True)
class StereoInstant:
    """Depth by side (`synced`, `offset`), and the pixels it is measured on (bool, reference view).

    `truth` is in the calibration's unit, NaN = unknown; None where the truth is unknown.
    """

    now: int
    later: int
    maps: dict[str, DepthMap]
    moving: Array
    static: Array
    truth: Array | None
    matcher: StereoPair

    def shown(self, side: str) -> int:
        """The instant that the second camera shows."""
        return self.now if side == "synced" else self.later


def stereo_pictures(
    dataset: Dataset, cameras: tuple[str, str], instants: Sequence[StereoInstant], out: Path
) -> tuple[Picture, ...]:
    """Write the pictures into out/pictures: of the instant with the most moving pixels that have a depth."""
    one = max(instants, key=lambda i: int((i.moving & (i.maps["synced"].depth > 0)).sum()))
    photo = dataset.image(cameras[0], one.now)
    drawn = {side: _draw(one, side, photo, dataset.image(cameras[1], one.shown(side))) for side in SIDES}
    return write_pictures(drawn, _texts(cameras, one.truth is not None), out)


def _texts(cameras: tuple[str, str], true: bool) -> dict[str, tuple[str, str]]:
    found = f"the distance found is right {TOLERANCE_TEXT}" if true else "both pictures agree on a distance"
    lost = "there is none, or a wrong one" if true else "they do not"
    return {
        "stereo_late": (
            "The second camera's picture",
            f"What {cameras[1]} took at the instant of {cameras[0]}'s picture, and when it is late.",
        ),
        "stereo_depth": ("Distance", "Bright is near, blue is far; dark means that no distance was found."),
        "stereo_movers": ("What moves", f"Teal: {found}. Orange: {lost}."),
        "stereo_closeup": ("A moving thing, close up", "The picture, and the distance found for it."),
        "stereo_pair": (
            "The two pictures",
            "Turned so that the same point lies on the same line in both; what has moved does not.",
        ),
    }


def _draw(one: StereoInstant, side: str, photo: Array, other: Array) -> dict[str, Array]:
    near, far = display_range(one.maps["synced"].depth, one.moving)
    box = box_around(one.moving, most=0.65)
    depth = one.maps[side].depth
    coloured = colour_depth(depth, near, far)
    right = depth > 0
    if one.truth is not None:
        right &= right_depth(depth, one.truth)
    return {
        "stereo_late": other,
        "stereo_depth": coloured,
        "stereo_movers": mark_movers(photo, one.moving, right),
        "stereo_closeup": side_by_side(enlarge_crop(photo, box), enlarge_crop(coloured, box, smooth=False)),
        "stereo_pair": _draw_pair(one, photo, other),
    }


def _draw_pair(one: StereoInstant, photo: Array, other: Array) -> Array:
    """Both pictures turned so that the same point lies in the same row, with lines to compare by."""
    canvas = one.matcher.rectification
    a, seen = canvas.remap(photo)
    b, seen_b = canvas.remap(other, other=True)
    on, _ = canvas.remap(one.moving.astype(np.uint8), nearest=True)
    a[~seen], b[~seen_b] = EMPTY, EMPTY
    rows, columns = (np.nonzero(seen.mean(axis) > 0.5 * seen.mean(axis).max())[0] for axis in (1, 0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    a, b, on = a[part], b[part], on[part]
    if canvas.mirror:
        a, b, on = (np.ascontiguousarray(image[:, ::-1]) for image in (a, b, on))
    _, top, _, bottom = box_around(on > 0, spare=0.0, least=8)
    count = 3 if (on > 0).any() else 0
    lines = [int(y) for y in np.linspace(top, bottom, count)]
    return draw_rows(a, b, lines)
