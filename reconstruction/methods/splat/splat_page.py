"""Splats in a page to walk round in: some 6 bytes a Gaussian, and once for all instants that it stays."""

import base64
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reconstruction.common.camera_paths import Frame
from reconstruction.common.geometry import Array, View
from reconstruction.methods.splat.gaussians import THIN, Gaussians, quaternions, read_splats, render_gaussians
from reconstruction.pages.walk_page import Drawing, path_of, write_walk_page

HELD = 4
"""Number of instants that the page keeps in the GPU's memory."""
BLUR = 0.3
"""Variance that every Gaussian has at least in a picture, px squared, as in `gaussians.c`."""
STRAY = 0.1
"""Percentile of the Gaussians' places, on both ends of each axis, beyond which they may be strays."""
BEYOND = 0.5
"""Farthest stray that is shown, in extents of all others."""
FINE, MAX_STEPS = 0.3, 2**15 - 1
"""Step of places, relative to the median of the Gaussians' smaller sizes, and the largest number of steps."""
SIZE_STEP = 0.25
"""Step of the sizes' logarithms."""
ROTATION_BITS, OPACITY_BITS = 6, 3
GREEN_SHIFT, CHROMA_SHIFT = 2, 3
"""Bits of 8 that are left out of green, and of the differences of blue and red to it."""
COLOURS = slice(8, 11)
"""Columns of green, and of blue and red, in the rows of integers."""
SAME_COLOUR = 40
"""Difference of levels up to which a Gaussian that stays has its colour of the instant when it came."""


class Grid(NamedTuple):
    """Quantization of all instants: a place is `low` + `step` times an integer along each axis.

    A size is `smallest` times exp(`SIZE_STEP` times an integer).
    """

    low: Array
    step: Array
    smallest: float

    @classmethod
    def around(cls, files: Mapping[int, Path]) -> "Grid":
        """Return the grid that holds the splats of files."""
        low, high, smallest, fine = np.full(3, np.inf), np.full(3, -np.inf), np.inf, np.inf
        for file in files.values():
            gaussians = _shown(file)
            low = np.minimum(low, gaussians.places.min(axis=0))
            high = np.maximum(high, gaussians.places.max(axis=0))
            sizes = gaussians.sizes[:, :2].min(axis=1)
            smallest, fine = min(smallest, float(sizes.min())), min(fine, FINE * float(np.median(sizes)))
        return cls(low, np.maximum((high - low) / MAX_STEPS, fine), smallest)

    def integers(self, gaussians: Gaussians) -> Array:
        """Return Gaussians as integers (n, 12): place, two sizes, turn (x, y, z), green, blue, red, opacity.

        Blue and red are differences to green. The third size is left out: it is `THIN` times the first.
        """
        turns = quaternions(gaussians.rotations)[:, 1:]
        blue, green, red = np.rint(np.clip(gaussians.colours, 0, 1) * 255).astype(int).T
        columns = [
            np.rint((gaussians.places - self.low) / self.step),
            np.rint(np.log(gaussians.sizes[:, :2] / self.smallest) / SIZE_STEP),
            np.rint((turns + 1) / 2 * (2**ROTATION_BITS - 1)),
            np.stack(
                [green >> GREEN_SHIFT, blue - green >> CHROMA_SHIFT, red - green >> CHROMA_SHIFT], axis=1
            ),
            np.rint(gaussians.opacities * (2**OPACITY_BITS - 1))[:, None],
        ]
        return np.concatenate(columns, axis=1).astype(np.int64)


def write_splat_page(
    page: Path, name: str, files: Mapping[int, Path], frame: Frame, views: Mapping[str, View], period_ns: int
) -> None:
    """Write the page as a file, with splats by instant; `views` are those that they were made from.

    An instant holds which Gaussians of the one before stay, and all others. Those stay that are at the same
    place with about the same colour.
    """
    grid = Grid.around(files)
    rows, instants = np.empty((0, 12), np.int64), list[dict[str, Any]]()
    for instant, file in files.items():
        others = grid.integers(_shown(file))
        stay = _stay(rows, others)
        new = others[~np.isin(_places(others), _places(rows[stay]))]
        instants.append({"instant": instant, "stay": _packed(np.packbits(stay)), **pack(new)})
        rows = np.concatenate([rows[stay], new])
    shape, first = next(iter(views.values())), _shown(next(iter(files.values())))
    depths = np.concatenate(
        [first.places @ view.rotation[2] + view.translation[2] for view in views.values()]
    )
    write_walk_page(
        page,
        name,
        path=path_of(frame, (float(depths[depths > 0].min()), float(depths.max())), views),
        views=views,
        still=render_gaussians(first, frame.view(frame.place(0, 0), shape.width, shape.height)),
        period_ns=period_ns,
        drawing=Drawing(
            Path(__file__).with_name("page") / "splats.js",
            instants,
            {
                "held": HELD,
                "blur": BLUR,
                # In the page's pictures, which are as wide as the views.
                "focal": float(np.median([view.focal for view in views.values()])),
                "low": grid.low.tolist(),
                "step": grid.step.tolist(),
                "smallest": grid.smallest,
                "ratio": SIZE_STEP,
                "thin": THIN,
                "levels": [2**ROTATION_BITS - 1, 2**OPACITY_BITS - 1],
                "shifts": [GREEN_SHIFT, CHROMA_SHIFT],
            },
        ),
    )


def _shown(file: Path) -> Gaussians:
    """Read a file's Gaussians without strays far beyond nearly all others, which would cost all precision."""
    gaussians = read_splats(file)
    low, high = np.percentile(gaussians.places, [STRAY, 100 - STRAY], axis=0)
    margin = BEYOND * (high - low) + 1e-9
    near = (gaussians.places >= low - margin) & (gaussians.places <= high + margin)
    return gaussians.chosen(near.all(axis=1))


def _places(integers: Array) -> Array:
    """Return one number for each place."""
    return np.asarray(integers[:, 0] | integers[:, 1] << 16 | integers[:, 2] << 32)


def _stay(rows: Array, integers: Array) -> Array:
    """Return which Gaussians (bool) are at the same place at another instant, with about the same colour."""
    order = np.argsort(_places(integers), kind="stable")
    places = np.searchsorted(_places(integers), _places(rows), sorter=order).clip(max=len(order) - 1)
    others = integers[order[places]]
    apart = np.abs(others[:, COLOURS] - rows[:, COLOURS]) << [GREEN_SHIFT, CHROMA_SHIFT, CHROMA_SHIFT]
    return np.asarray((_places(others) == _places(rows)) & (apart <= SAME_COLOUR).all(axis=1))


def pack(integers: Array) -> dict[str, Any]:
    """Return rows of integers for the page: column by column, compressed, as differences to the row before.

    The sign is a difference's lowest bit. Places have two bytes, the lower ones of all rows first.
    """
    steps = np.diff(integers, axis=0, prepend=0)
    codes = np.where(steps < 0, -2 * steps - 1, 2 * steps).T
    planes = [part for place in codes[:3] for part in (place & 255, place >> 8)] + [*codes[3:]]
    return {"number": len(integers), "splats": _packed(np.concatenate(planes).astype(np.uint8))}


def _packed(values: Array) -> str:
    packer = zlib.compressobj(9, memLevel=9, strategy=zlib.Z_FILTERED)
    return base64.b64encode(packer.compress(values.tobytes()) + packer.flush()).decode()
