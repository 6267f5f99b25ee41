"""The fusion of a COLMAP workspace's depth maps into one cloud of points."""

from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.common.native_libraries import load_pycolmap

MIN_VIEWS = 3
"""Views in whose maps a point must be, fewer where there are fewer; the limits are COLMAP's."""
MAX_NORMAL_ERROR_DEG = 30.0
MAX_DEPTH_ERROR = 0.01
MAX_REPROJECTION_ERROR_PX = 1.5
MAX_TRAVERSAL_DEPTH = 2
"""Views one after the other that a point is followed through; more of them eat its neighbours."""


def fuse_depth_maps(folder: Path, cloud: Path, views: int) -> int:
    """Fuse a workspace's geometric maps into a PLY; how many points it has.

    Raises:
        BadInputError: no point is consistent in enough views.
    """
    pycolmap = load_pycolmap("fusing depth maps")
    asked = pycolmap.StereoFusionOptions()
    asked.min_num_pixels = min(MIN_VIEWS, views)
    asked.max_normal_error = MAX_NORMAL_ERROR_DEG
    asked.max_depth_error = MAX_DEPTH_ERROR
    asked.max_reproj_error = MAX_REPROJECTION_ERROR_PX
    asked.max_traversal_depth = MAX_TRAVERSAL_DEPTH
    # More threads race for the pixels: another cloud every time, and hardly sooner.
    asked.num_threads = 1
    fused = pycolmap.stereo_fusion(
        cloud, folder, "COLMAP", "option-all", "geometric", asked, output_type="ply"
    )
    count = len(fused.points3D)
    if count == 0:
        raise BadInputError(
            "no point of the scene is consistent in enough cameras",
            hint="cameras must see the same things, at the same time, from different places, "
            "and their calibration must be this rig's",
        )
    return count


def read_fused_cloud(path: Path, views: int) -> tuple[Array, Array]:
    """Points (n, 3) of a fused PLY, and by its `.vis` file from which views' maps each was fused."""
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    vertex = np.dtype([("at", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3)])
    points = np.frombuffer(data, vertex, offset=start)["at"]
    lists = np.frombuffer(path.with_name(path.name + ".vis").read_bytes(), "<u4", offset=8)
    seen = np.zeros((len(points), views), bool)
    at = 0
    for row in seen:
        count = int(lists[at])
        row[lists[at + 1 : at + 1 + count]] = True
        at += 1 + count
    return np.array(points), seen
