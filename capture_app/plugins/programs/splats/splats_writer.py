"""Gaussian splatting: undistorted pinhole images, binary COLMAP models and points, in trainers' layouts."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.plugins.programs.splats.colmap_binary import write_model
from capture_app.plugins.programs.splats.gltf_cameras import write_gltf
from capture_app.session.exporting.csv_tables import yaml_names
from capture_app.session.exporting.exported_burst import ExportedBurst, suffix_for, write_mask
from capture_app.session.exporting.exporter import Exporter, Masks, Option
from capture_app.session.exporting.pinhole import (
    common_pinhole,
    focus_depths,
    llff_row,
    nearest_pinhole,
    opengl_pose,
)
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.exporting.starting_points import match_points, scatter_points
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import Redraw, redrawing

MAX_POINTS = 100_000
_MIN_POINTS = 1000
_DNERF_PX = 800
"""Side of D-NeRF's images; 4DGaussians scales every image to it."""
_MODEL = Path("sparse/0")
_NEAR, _FAR = 0.5, 2.0
"""Guessed bounds, relative to the distance at which the cameras' axes meet."""
LAYOUTS = ("colmap", "per-instant", "multipleview", "4c4d", "blender")

Cameras = Mapping[str, CameraCalibration]


class _Layout:
    """An export that is being written: its cameras, and the files of each image."""

    def __init__(
        self,
        burst: ExportedBurst,
        folder: Path,
        lenses: Cameras,
        suffix: str,
        *,
        masks: Path | None,
        points: Path | None,
        max_points: int | None,
    ) -> None:
        """Take the pinhole of each camera; `suffix` is the images' type, if the layout fixes it, or empty."""
        self.burst, self.folder, self.lenses = burst, folder, lenses
        self._masks, self._points = masks, points
        self._max_points = MAX_POINTS if max_points is None else max_points
        cameras = burst.required_calibration.cameras
        self.redraws: dict[str, Redraw | None] = {
            name: redrawing(cameras[name], lens) for name, lens in lenses.items()
        }
        burst.drawn.update({name: lens for name, lens in lenses.items() if self.redraws[name]})
        redrawn = ".png" if burst.lossless else ".jpg"
        own = redrawn if any(self.redraws.values()) else suffix_for(burst, list(burst.images.values()))
        self.suffix = suffix or own
        self.names = yaml_names(burst.cameras)
        """Names without dots: trainers cut a file's name at its first dot."""
        self.matched: list[int] = []
        """Number of points matched between cameras, of each instant without a given cloud."""
        self._say_what_is_drawn(cameras)

    def put(self, camera: str, instant: int, file: str) -> None:
        """Write an image, and its mask if there is one; `file` has no suffix."""
        image, redraw = self.burst.images[camera, instant], self.redraws[camera]
        self.burst.write_image(image, self.folder, f"{file}{self.suffix}", redraw)
        beside = file.replace("images", "masks", 1) if "images" in Path(file).parts else f"masks/{file}"
        target = self.folder / f"{beside}.png"
        write_mask(self.burst, self._masks, image, target, movers=255, redraw=redraw)

    def cloud(self, instant: int) -> PointCloud:
        """Return the points of an instant, thinned: given ones, or ones that are matched between cameras."""
        number = self._max_points
        if (given := self._points) is None:
            return self._matched(instant).thinned(number)
        if given.is_dir():
            clouds = given / "clouds" if (given / "clouds").is_dir() else given
            given = clouds / f"{instant:06d}.ply"
        return read_ply(given).thinned(number)

    def _matched(self, instant: int) -> PointCloud:
        pictures = {
            name: self.burst.load(self.burst.images[name, instant], redraw)[1]
            for name, redraw in self.redraws.items()
        }
        matched = match_points(self.lenses, pictures)
        self.matched.append(len(matched.points))
        if (short := _MIN_POINTS - len(matched.points)) > 0:
            depths = focus_depths(self.lenses).items()
            bounds = {name: (_NEAR * depth, _FAR * depth) for name, depth in depths}
            random = scatter_points(self.lenses, bounds, short)
            matched = PointCloud(
                np.concatenate([matched.points, random.points]),
                np.concatenate([matched.colours, random.colours]),
            )
        return matched

    def note_matches(self) -> None:
        """Add a note on where the points come from, unless they were given."""
        if self.matched:
            low, high = min(self.matched), max(self.matched)
            number = f"{low:,}" if low == high else f"{low:,} to {high:,}"
            filled = f", filled to {_MIN_POINTS:,} with random ones" if low < _MIN_POINTS else ""
            self.burst.notes.append(
                f"{number} points are matched between cameras{filled}; "
                "`--points` takes the cloud of reconstruct multiview"
            )

    def _say_what_is_drawn(self, cameras: Cameras) -> None:
        same = {name for name, redraw in self.redraws.items() if redraw is None}
        cropped = {
            name
            for name, lens in self.lenses.items()
            if name not in same and (lens.fx, lens.fy) == (cameras[name].fx, cameras[name].fy)
        }
        resampled = [name for name in self.lenses if name not in same | cropped]
        if cropped:
            self.burst.warn(f"cropped to centre the principal point: {', '.join(sorted(cropped))}")
        if resampled:
            self.burst.warn(f"resampled without distortion: {', '.join(resampled)}")


def write(
    burst: ExportedBurst,
    folder: Path,
    *,
    masks: Masks = None,
    layout: Annotated[
        str | None, Option("folders as a trainer reads them; colmap is one instant", choices=LAYOUTS)
    ] = None,
    points: Annotated[
        Path | None,
        Option("cloud of reconstruct multiview, or its folder with a cloud of each instant", "PLY|DIR"),
    ] = None,
    max_points: Annotated[
        int | None,
        Option(f"keep at most this many points, drawn at random ({MAX_POINTS:,})", "N"),
    ] = None,
) -> None:
    """Write instants that every camera has, in the chosen layout, and the cameras as cameras.gltf."""
    calibration = burst.required_calibration
    cameras = {name: calibration.cameras[name] for name in burst.cameras}
    layout = layout or "colmap"
    if len(cameras) < 2:
        raise BadInputError(
            f"{burst.session.folder} has one camera, and splats need several",
            hint="three or more cameras of different places give depth",
        )
    if len(cameras) < 3:
        burst.warn("two cameras: a trainer finds depth only where both see a point")
    instants = burst.complete_instants()
    if layout == "colmap":
        instants = [instants[len(instants) // 2]]
    if left_out := len({instant for _, instant in burst.images}) - len(instants):
        burst.warn(
            f"instant {instants[0]} alone is exported; --layout per-instant takes all"
            if layout == "colmap"
            else f"left out: {count(left_out, 'instant')} that not every camera has"
        )
    burst.images = {place: image for place, image in burst.images.items() if place[1] in instants}
    pinholes, suffix, write_images = _LAYOUTS[layout]
    lenses = pinholes(burst, cameras)
    export = _Layout(burst, folder, lenses, suffix, masks=masks, points=points, max_points=max_points)
    cloud = write_images(export, instants)
    export.note_matches()
    write_gltf(folder / "cameras.gltf", lenses, cloud, calibration.unit)


def _colmap(layout: _Layout, instants: list[int]) -> PointCloud:
    """Write images/<camera>_<instant> and sparse/0 of one instant."""
    return _write_instant(layout, Path(), instants[0])


def _per_instant(layout: _Layout, instants: list[int]) -> PointCloud:
    """Write a folder of each instant, as in the layout colmap."""
    clouds = [_write_instant(layout, Path(f"{instant:06d}"), instant) for instant in instants]
    return clouds[0]


def _write_instant(layout: _Layout, part: Path, instant: int) -> PointCloud:
    files = {camera: f"{layout.names[camera]}_{instant:06d}" for camera in layout.lenses}
    for camera, file in files.items():
        layout.put(camera, instant, str(part / "images" / file))
    cloud = layout.cloud(instant)
    images = [(camera, f"{file}{layout.suffix}") for camera, file in files.items()]
    write_model(layout.folder / part / _MODEL, layout.lenses, images, cloud)
    return cloud


def _four_cameras(layout: _Layout, instants: list[int]) -> PointCloud:
    """Write images/cam<N>_<frame>.png, and sparse/0 of the first frames."""
    for number, camera in enumerate(layout.lenses):
        for frame, instant in enumerate(instants):
            layout.put(camera, instant, f"images/cam{number:02d}_{frame:04d}")
    cloud = layout.cloud(instants[0])
    images = [(camera, f"cam{number:02d}_0000.png") for number, camera in enumerate(layout.lenses)]
    write_model(layout.folder / _MODEL, layout.lenses, images, cloud)
    return cloud


def _multiple_view(layout: _Layout, instants: list[int]) -> PointCloud:
    """Write cam<N>/frame_<N>.jpg, counted from 1."""
    for number, camera in enumerate(layout.lenses, 1):
        for frame, instant in enumerate(instants, 1):
            layout.put(camera, instant, f"cam{number:02d}/frame_{frame:05d}")
    cloud = layout.cloud(instants[0])
    images = [(camera, f"image{number:02d}.jpg") for number, camera in enumerate(layout.lenses, 1)]
    write_model(layout.folder / "sparse_", layout.lenses, images, cloud)
    write_ply(layout.folder / "points3D_multipleview.ply", cloud, np.zeros_like(cloud.points))
    depths = focus_depths(layout.lenses)
    rows = [llff_row(lens, _NEAR * depths[name], _FAR * depths[name]) for name, lens in layout.lenses.items()]
    np.save(layout.folder / "poses_bounds_multipleview.npy", np.array(rows))
    return cloud


def _blender(layout: _Layout, instants: list[int]) -> PointCloud:
    """Write D-NeRF's images, transforms_train.json and, of the first camera, transforms_test.json."""
    first = next(iter(layout.lenses))
    frames: list[dict[str, object]] = []
    times_ns = [layout.burst.instants_ns[instant] for instant in instants]
    lasts_ns = max(times_ns[-1] - times_ns[0], 1)
    for camera, lens in layout.lenses.items():
        for at_ns, instant in zip(times_ns, instants, strict=True):
            file = f"train/{layout.names[camera]}_{instant:06d}"
            layout.put(camera, instant, file)
            matrix = opengl_pose(lens).tolist()
            entry = {
                "file_path": f"./{file}",
                "time": (at_ns - times_ns[0]) / lasts_ns,
                "transform_matrix": matrix,
            }
            frames.append(entry)
    angle = {"camera_angle_x": 2 * math.atan(_DNERF_PX / (2 * layout.lenses[first].fx))}
    parts = {"train": frames, "test": frames[: len(instants)]}
    for part, entries in (parts | {"val": parts["test"]}).items():
        text = json.dumps({**angle, "frames": entries}, indent=1)
        (layout.folder / f"transforms_{part}.json").write_text(f"{text}\n", encoding="utf-8")
    cloud = layout.cloud(instants[0])
    for name in ("points3d.ply", "fused.ply"):  # 3DGS's name and 4DGaussians'
        write_ply(layout.folder / name, cloud, np.zeros_like(cloud.points))
    layout.burst.notes.append(f"the test images are those of {first}, which are also trained on")
    return cloud


def _own_pinholes(burst: ExportedBurst, cameras: Cameras) -> dict[str, CameraCalibration]:
    lenses = {name: nearest_pinhole(camera) for name, camera in cameras.items()}
    sizes = {(lens.width, lens.height) for lens in lenses.values()}
    if len(sizes) > 1:
        named = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        burst.warn(
            f"the images differ in size ({named}), which some trainers refuse; not in --layout multipleview"
        )
    return lenses


_LAYOUTS: dict[
    str,
    tuple[Callable[[ExportedBurst, Cameras], Cameras], str, Callable[[_Layout, list[int]], PointCloud]],
] = {
    "colmap": (_own_pinholes, "", _colmap),
    "per-instant": (_own_pinholes, "", _per_instant),
    "multipleview": (lambda burst, cameras: common_pinhole(cameras), ".jpg", _multiple_view),
    "4c4d": (_own_pinholes, ".png", _four_cameras),
    "blender": (lambda burst, cameras: common_pinhole(cameras, (_DNERF_PX, _DNERF_PX)), ".png", _blender),
}
"""Of each layout: the cameras' lenses, the images' type if it is fixed, and what writes the files.

The writer returns the points of the first instant.
"""

EXPORTER = Exporter(
    fisheyes=True,
    write=write,
    help="pinhole images for trainers of Gaussian splats",
    program="Gaussian splatting",
    one_instant=True,
    calibration="required",
    complete_instants=True,
)
