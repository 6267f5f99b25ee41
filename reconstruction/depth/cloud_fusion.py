"""The fusion of a COLMAP workspace's depth maps into one cloud of points."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import BadInputError
from reconstruction.common.native_libraries import load_pycolmap


@dataclass(frozen=True)
class FusionOptions:
    """When COLMAP joins pixels of several views into a point."""

    min_views: int = 3
    max_normal_error_deg: float = 30.0
    max_depth_error: float = 0.01
    max_reprojection_error_px: float = 1.5
    max_traversal_depth: int = 2
    """Views one after the other that a point is followed through; more of them eat its neighbours."""


def fuse_depth_maps(folder: Path, cloud: Path, views: int, options: FusionOptions | None = None) -> int:
    """Fuse a workspace's geometric maps into a PLY; how many points it has.

    Raises:
        BadInputError: no point is consistent in enough views.
    """
    pycolmap = load_pycolmap("fusing depth maps")
    limits = options or FusionOptions()
    asked = pycolmap.StereoFusionOptions()
    asked.min_num_pixels = min(limits.min_views, views)
    asked.max_normal_error = limits.max_normal_error_deg
    asked.max_depth_error = limits.max_depth_error
    asked.max_reproj_error = limits.max_reprojection_error_px
    asked.max_traversal_depth = limits.max_traversal_depth
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
