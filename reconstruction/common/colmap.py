"""COLMAP, by pycolmap: what of depth it does, and what our plane sweep does instead.

| step | by | module |
|---|---|---|
| calibration from images | COLMAP's structure from motion | `scene/calibration/structure_from_motion.py` |
| refinement of poses | COLMAP's bundle adjustment | `methods/multiview/refinement.py` |
| points, with known poses | COLMAP's matching and triangulation | `checks/triangulation` |
| poses of single instants | COLMAP's incremental mapping | `checks/poses` |
| dense depth, without CUDA | our plane sweep | `methods/multiview/sweep_matcher.py` |
| dense depth, with CUDA | COLMAP's PatchMatch, if asked for | `methods/multiview/colmap_workspace.py` |
| undistortion | OpenCV, by the same model | `methods/multiview/input_images.py` |
| fusion of maps into a cloud | ours, by COLMAP's rules | `methods/multiview/fusion.py` |
| the same, to compare | COLMAP's stereo fusion | `methods/multiview/colmap_workspace.py` |

COLMAP's dense stereo needs CUDA, and pycolmap has it only in a build with CUDA. The sweep runs on any
processor, and more of its depth is right. Its maps are written as a COLMAP workspace, which `stereo_fusion`
reads.
"""

import importlib
import signal
import threading
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.common.native_libraries import GuardedModule, load_guarded

if TYPE_CHECKING:
    from reconstruction.common.geometry import Array, View


def load_pycolmap(purpose: str, *, hint: str = "") -> ModuleType:
    """Load COLMAP's Python module, guarded and silent; `purpose` is what an error says it is for.

    OpenCV must be imported first: in the other order the first PNG that OpenCV writes aborts the process.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    importlib.import_module("cv2")
    on_end = signal.getsignal(signal.SIGTERM)
    module = load_guarded("pycolmap", purpose, hint)
    # COLMAP handles the signal as a crash: it prints a stack and exits without cleanup.
    if on_end is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_end)
    module.logging.minloglevel = 3
    return GuardedModule(module, "COLMAP")


Sightings = Mapping[int, int]
"""The images that see a point, by number, each with the point's place among its keypoints."""


def build_model(
    colmap: Any,
    views: "Mapping[str, View]",
    keypoints: "Mapping[str, Array]",
    points: "Iterable[tuple[Array, Sightings]]" = (),
    corner: float = 0.0,
) -> Any:
    """Return COLMAP's model of views without distortion, whose cameras and images are numbered from 1.

    `keypoints` (n, 2) are pixels of each view's image. `points` (3,) are in the rig's frame. COLMAP's first
    pixel has its centre at 0.5, which is then `corner`. Its dense part uses a pixel's column and row as
    coordinates, and would with that offset fuse points half a pixel off.
    """
    model = colmap.Reconstruction()
    for number, (name, view) in enumerate(views.items(), 1):
        matrix = view.matrix
        camera = colmap.Camera(
            model="PINHOLE",
            width=view.width,
            height=view.height,
            params=[matrix[0, 0], matrix[1, 1], matrix[0, 2] + corner, matrix[1, 2] + corner],
            camera_id=number,
            has_prior_focal_length=True,
        )
        model.add_camera_with_trivial_rig(camera)
        pixels = keypoints[name] + corner
        image = colmap.Image(name=name, keypoints=pixels, camera_id=number, image_id=number)
        pose = colmap.Rigid3d(colmap.Rotation3d(view.rotation), view.translation)
        model.add_image_with_trivial_frame(image, pose)
    for point, seen in points:
        track = colmap.Track()
        for number, place in seen.items():
            track.add_element(number, place)
        model.add_point3D(point, track, np.full(3, 128, np.uint8))
    return model
