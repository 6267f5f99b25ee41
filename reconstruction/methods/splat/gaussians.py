"""A moment as oriented Gaussians: made of depth maps, rendered, and stored as 3D Gaussian Splatting does."""

import gzip
import struct
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.worker_pool import worker_pool
from reconstruction.depth.backdrop import Backdrop
from reconstruction.depth.compiling import GAUSSIANS
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.seen_moment import Moment, SeenView

SIGMA_PX = 0.6
"""Standard deviation of a pixel's Gaussian along the surface, px."""
THIN = 0.1
"""Standard deviation across the surface, relative to that."""
MAX_SLANT = 3.0
"""Maximum stretch of a pixel's Gaussian on a slanted surface."""
LAYER = 0.5
"""Distance between the four layers of a pixel and its neighbours, in widths of a pixel on the surface."""
SAME_DEPTH = 0.01
"""Relative difference of depth within which an earlier map already has a pixel's surface."""
OPACITY = 0.9
PLAIN = 5
"""Maximum difference of grey levels within a block of pixels that becomes one Gaussian."""
FLAT = 0.001
"""Maximum difference of its diagonals' depths, relative to the depth."""
TILE = 8
"""Side, in cells of a backdrop, of a tile that becomes one Gaussian where it has one colour."""
_SH = 0.28209479177387814
"""Value of the constant spherical harmonic."""
_NUMBERS = 7
_CHUNK = 1 << 14


@dataclass(frozen=True, eq=False)
class Gaussians:
    """Oriented Gaussians in the rig's frame, all float32.

    `places` (n, 3); `axes` (n, 3, 3), unit vectors in columns, the last across the surface; `sizes` (n, 3),
    standard deviations along them in the calibration's unit; `colours` (n, 3), BGR from 0 to 1; `opacities`
    (n,) from 0 to 1. `pixels` (n,) int64: the index of the pixel that each was made from, over all cameras.
    """

    places: Array
    axes: Array
    sizes: Array
    colours: Array
    opacities: Array
    pixels: Array

    def __len__(self) -> int:
        return len(self.places)

    def chosen(self, where: Array) -> "Gaussians":
        """Return those at indices, or where a mask is true."""
        return Gaussians(**{name: np.ascontiguousarray(values[where]) for name, values in vars(self).items()})

    @property
    def rotations(self) -> Array:
        """The axes as rotation matrices (n, 3, 3), float64: right-handed, by the last one's sign."""
        axes = self.axes.astype(np.float64)
        axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
        return axes


@dataclass(frozen=True, eq=False)
class Projected:
    """Gaussians in a view: `flat` (n, 7) as the kernels take them, `order` (m,) of those seen, by depth."""

    view: View
    flat: Array
    order: Array


def make_gaussians(moment: Moment, backdrop: Backdrop | None = None) -> Gaussians:
    """Return a Gaussian for each pixel with depth, without those whose surface an earlier map has.

    Blocks of 2 x 2 pixels of one colour on one surface become one Gaussian. Those of a backdrop come last.
    """
    made, earlier, first = [], list[SeenView](), 0
    for seen in moment.values():
        new = seen.depth > 0
        points = seen.view.unproject_map(seen.depth, new)
        for other in earlier:
            kept = ~_has_surface(other, points)
            new[new], points = kept, points[kept]
        made += [_surface_elements(seen, *pixels, first) for pixels in _blocks(seen, new)]
        earlier.append(seen)
        first += seen.depth.size
    if backdrop is not None:
        made += _backdrop_elements(backdrop, first)
    return Gaussians(**{name: np.concatenate([vars(part)[name] for part in made]) for name in vars(made[0])})


def _blocks(seen: SeenView, new: Array) -> Iterator[tuple[Array, Array, float]]:
    """Yield the pixels (m, k) of plain blocks, their centres (m, 2) and size in px; then of all others."""
    height, width = (n // 2 * 2 for n in new.shape)
    numbers = np.arange(new.size).reshape(new.shape)

    def block(values: Array) -> Array:
        small = values[:height, :width].reshape(height // 2, 2, width // 2, 2, -1)
        return small.transpose(0, 2, 1, 3, 4).reshape(height // 2, width // 2, 4, -1)

    colours, depth = block(seen.colours), block(seen.depth)[..., 0]
    plain = block(new)[..., 0].all(axis=2) & (np.ptp(colours, axis=2).max(axis=2) <= PLAIN)
    # On a plane the diagonals have the same mean.
    bend = np.abs(depth[..., 0] + depth[..., 3] - depth[..., 1] - depth[..., 2])
    plain &= (bend < FLAT * depth[..., 0]) & (np.ptp(depth, axis=2) < SAME_DEPTH * depth[..., 0])
    merged = block(numbers)[plain][..., 0]
    single = new.copy()
    single.ravel()[merged.ravel()] = False
    for pixels, size in ((merged, 2.0), (numbers[single][:, None], 1.0)):
        centres = np.column_stack([pixels % new.shape[1], pixels // new.shape[1]])
        columns, rows = np.split(centres, 2, axis=1)
        yield pixels, np.column_stack([columns.mean(axis=1), rows.mean(axis=1)]), size


def _has_surface(seen: SeenView, points: Array) -> Array:
    """Return which points (n, 3) of the rig a map has, bool."""
    local = points @ seen.view.rotation.T + seen.view.translation
    ahead = local[:, 2] > 1e-6
    pixels = np.rint(seen.view.project(np.where(ahead[:, None], local, 1.0))).astype(int)
    inside = ahead & ((pixels >= 0) & (pixels < (seen.view.width, seen.view.height))).all(axis=1)
    columns, rows = np.where(inside[:, None], pixels, 0).T
    depth = seen.depth[rows, columns]
    return np.asarray(inside & (depth > 0) & (np.abs(depth - local[:, 2]) < SAME_DEPTH * local[:, 2]))


def _surface_elements(seen: SeenView, pixels: Array, centres: Array, size_px: float, first: int) -> Gaussians:
    """Return a Gaussian of `size_px` for each row of `pixels` (n, k), their mean, at `centres` (n, 2).

    Neighbours overlap, and the nearer one covers the other: layers give all cameras the same order of them,
    or each would see another picture of the same surface.
    """
    view = seen.view
    depth = seen.depth.ravel()[pixels].mean(axis=1).astype(float)
    row, column = (np.floor(centres[:, axis] / size_px) % 2 for axis in (1, 0))
    depth *= 1 + LAYER / view.focal * (2 * row + column - 1.5)
    points = view.unproject(centres, depth)
    rays = points - view.centre
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    normals = seen.normals.reshape(-1, 3)[pixels].mean(axis=1) @ view.rotation
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0.5, normals / np.maximum(length, 1e-9), -rays)
    along = np.cross(normals, rays)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    # Seen straight on, any direction along the surface will do.
    other = np.cross(normals, np.broadcast_to(view.rotation[1], normals.shape))
    along = np.where(length > 1e-3, along / np.maximum(length, 1e-9), other)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    facing = np.abs((rays * normals).sum(axis=1))
    size = SIGMA_PX * size_px * depth / view.focal
    sizes = np.stack([size, size / np.maximum(facing, 1 / MAX_SLANT), THIN * size], axis=1)
    return Gaussians(
        places=floats(points),
        axes=floats(np.stack([along, np.cross(normals, along), normals], axis=2)),
        sizes=floats(sizes),
        colours=floats(seen.colours.reshape(-1, 3)[pixels].mean(axis=1) / 255),
        opacities=np.full(len(points), OPACITY, np.float32),
        pixels=pixels[:, 0] + first,
    )


def _backdrop_elements(backdrop: Backdrop, first: int) -> Iterator[Gaussians]:
    """Yield the Gaussians of a backdrop's tiles of one colour, then those of all other cells."""
    height, width = backdrop.colours.shape[:2]
    colours = backdrop.colours.reshape(-1, 3)
    cells = np.arange(len(colours)).reshape(height // TILE, TILE, width // TILE, TILE)
    tiles = cells.transpose(0, 2, 1, 3).reshape(-1, TILE * TILE)
    plain = np.ptp(colours[tiles], axis=1).max(axis=1) <= PLAIN
    for group, size in ((tiles[plain], TILE), (tiles[~plain].reshape(-1, 1), 1)):
        up = ((group // width).mean(axis=1) + 0.5) / height * np.pi - np.pi / 2
        round_ = ((group % width).mean(axis=1) + 0.5) / width * 2 * np.pi - np.pi
        right = np.stack([np.cos(round_), np.zeros(len(up)), -np.sin(round_)], axis=1)
        outwards = np.stack([np.cos(up) * np.sin(round_), np.sin(up), np.cos(up) * np.cos(round_)], axis=1)
        side = SIGMA_PX * size * np.pi / height * backdrop.radius
        yield Gaussians(
            places=floats(backdrop.centre + backdrop.radius * outwards),
            axes=floats(np.stack([right, np.cross(outwards, right), -outwards], axis=2)),
            sizes=floats(side * np.stack([np.cos(up), np.ones(len(up)), np.full(len(up), THIN)], axis=1)),
            colours=floats(colours[group].mean(axis=1) / 255),
            opacities=np.full(len(up), OPACITY, np.float32),
            pixels=group[:, 0] + first,
        )


def project(
    gaussians: Gaussians, view: View, grown: Array, pool: Executor, order: Array | None = None
) -> Projected:
    """Return Gaussians in a view; `grown` (n,) are logarithms of factors of their sizes.

    `order` is that of an earlier call for the same view, as places do not change.
    """
    flat = np.empty((len(gaussians), _NUMBERS), np.float32)
    depths = np.empty(len(gaussians), np.float32)
    pose = floats(np.concatenate([view.rotation.ravel(), view.translation]))
    lens = floats(np.array([view.matrix[0, 0], view.matrix[1, 1], view.matrix[0, 2], view.matrix[1, 2]]))

    def chunk(first: int) -> None:
        last = min(first + _CHUNK, len(gaussians))
        call_kernel(
            "project_gaussians",
            *(first, last, gaussians.places, gaussians.axes, gaussians.sizes, grown),
            *(pose, lens, view.width, view.height, flat, depths),
            source=GAUSSIANS,
        )

    list(pool.map(chunk, range(0, len(gaussians), _CHUNK)))
    if order is None:
        shown = np.flatnonzero(depths > 0)
        order = shown[np.argsort(depths[shown], kind="stable")].astype(np.int32)
    return Projected(view, flat, order)


def bands(height: int, number: int) -> Iterator[tuple[int, int]]:
    """Yield the first row and the end of each of some bands of rows."""
    ends = np.linspace(0, height, number + 1).astype(int)
    yield from zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)


def draw(
    projected: Projected, colours: Array, opacities: Array, pool: Executor, number: int
) -> tuple[Array, Array]:
    """Return Gaussians over black (float32 height x width x 3), and the light that passes them."""
    view = projected.view
    picture = np.empty((view.height, view.width, 3), np.float32)
    passes = np.empty((view.height, view.width), np.float32)

    def band(rows: tuple[int, int]) -> None:
        shown = len(projected.order), projected.order, projected.flat, opacities, colours, view.width
        call_kernel("draw_gaussians", *shown, *rows, picture, passes, source=GAUSSIANS)

    list(pool.map(band, bands(view.height, number)))
    return picture, passes


def render_gaussians(gaussians: Gaussians, view: View) -> Array:
    """Return what a view without distortion sees, uint8 height x width x 3, BGR; gaps are filled."""
    with worker_pool() as pool:
        projected = project(gaussians, view, np.zeros(len(gaussians), np.float32), pool)
        picture, passes = draw(projected, gaussians.colours, gaussians.opacities, pool, 4)
    levels = [(picture, 1 - passes)]
    while min(levels[-1][1].shape) > 4:
        levels.append((cv2.pyrDown(levels[-1][0]), cv2.pyrDown(levels[-1][1])))
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)[..., None]
    for sums, weights in levels[-2::-1]:
        around = cv2.pyrUp(filled, dstsize=sums.shape[1::-1])
        filled = sums + np.maximum(1 - weights, 0)[..., None] * around
    return np.asarray(np.clip(np.rint(255 * filled), 0, 255), np.uint8)


def write_splats(path: Path, gaussians: Gaussians) -> None:
    """Write 3D Gaussian Splatting's PLY, without view-dependent colours: 68 bytes each, little-endian."""
    axes = gaussians.rotations
    opacities = np.clip(gaussians.opacities, 1e-3, 1 - 1e-3)
    columns = {
        ("x", "y", "z"): gaussians.places,
        ("nx", "ny", "nz"): axes[:, :, 2],
        ("f_dc_0", "f_dc_1", "f_dc_2"): (gaussians.colours[:, ::-1] - 0.5) / _SH,
        ("opacity",): np.log(opacities / (1 - opacities))[:, None],
        ("scale_0", "scale_1", "scale_2"): np.log(gaussians.sizes),
        ("rot_0", "rot_1", "rot_2", "rot_3"): quaternions(axes),
    }
    rows = np.concatenate([floats(column) for column in columns.values()], axis=1).astype("<f4")
    properties = "".join(f"property float {name}\n" for group in columns for name in group)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head.encode() + rows.tobytes())


def write_spz(path: Path, gaussians: Gaussians) -> None:
    """Write Niantic's SPZ, version 2: a gzipped stream of 19 bytes each, its axes right, up and back."""
    places = gaussians.places * [1, -1, -1]
    bits = int(np.clip(23 - np.ceil(np.log2(np.abs(places).max() + 1e-9)), 0, 23))
    fixed = np.rint(places * 2.0**bits).astype("<i4").clip(1 - 2**23, 2**23 - 1)
    turns = quaternions(gaussians.rotations)[:, 1:] * [1, -1, -1]
    parts = (
        255 * gaussians.opacities,
        255 * (0.5 + 0.15 * (gaussians.colours[:, ::-1] - 0.5) / _SH),
        16 * (np.log(gaussians.sizes) + 10),
        127.5 * (turns + 1),
    )
    head = struct.pack("<4sIIBBBB", b"NGSP", 2, len(gaussians), 0, bits, 0, 0)
    body = b"".join(np.rint(np.clip(part, 0, 255)).astype(np.uint8).tobytes() for part in parts)
    path.write_bytes(
        gzip.compress(head + fixed.view(np.uint8).reshape(-1, 4)[:, :3].tobytes() + body, mtime=0)
    )


def read_splats(path: Path) -> Gaussians:
    """Read a file that `write_splats` wrote."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    columns = {name: rows[:, number] for number, name in enumerate(names)}

    def group(name: str, number: int) -> Array:
        return np.stack([columns[f"{name}_{k}"] for k in range(number)], axis=1)

    w, x, y, z = group("rot", 4).T
    axes = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return Gaussians(
        places=floats(rows[:, :3]),
        axes=floats(np.array(axes).transpose(2, 0, 1)),
        sizes=floats(np.exp(group("scale", 3))),
        colours=floats(group("f_dc", 3)[:, ::-1] * _SH + 0.5),
        opacities=floats(1 / (1 + np.exp(-columns["opacity"]))),
        pixels=np.arange(len(rows)),
    )


def quaternions(rotations: Array) -> Array:
    """Return unit quaternions (n, 4; w >= 0, x, y, z) of rotation matrices (n, 3, 3) (Shepperd 1978)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(rotations, 0, 2)
    # Four times the products of the quaternion's numbers, of which the row of the largest one is exact.
    products = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1 + yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1 + zz - xx - yy],
        ]
    )
    largest = np.diagonal(products).argmax(axis=1)
    columns = products[largest, :, np.arange(len(rotations))]
    return np.asarray(
        np.where(columns[:, :1] < 0, -1, 1) * columns / np.linalg.norm(columns, axis=1, keepdims=True)
    )
