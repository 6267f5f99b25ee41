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
from types import ModuleType

from reconstruction.common.native_libraries import GuardedModule, load_guarded


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
