"""Depth of every camera of an instant, one cloud of points of them all, and a mesh."""

from pathlib import Path

from capture_app.session.files.output_folder import OutputFolder, replaces_only
from capture_app.terminal import Progress
from reconstruction.calibration.adoption import adopt_kept_calibration
from reconstruction.common.native_libraries import require_reconstruction
from reconstruction.multiview.instant_model import FUSED, RESULT, MultiviewOptions, model_instant
from reconstruction.multiview.matcher import choose_matcher
from reconstruction.multiview.result import MultiviewResult
from reconstruction.session.dataset import Dataset

OURS = {RESULT, "depth", "workspace", FUSED, f"{FUSED}.vis", "cloud.ply", "mesh.ply", "turntable.png"}


def multiview(
    session: Path, out: Path, options: MultiviewOptions, progress: Progress | None = None
) -> MultiviewResult:
    """Make the depth, the cloud and the mesh of one instant; `out` appears whole or not at all.

    Raises:
        BadInputError: the session, the instant or the offsets cannot be used, or nothing was found.
        NotAvailableError: the matcher asked for, or COLMAP or Open3D, is not here.
    """
    require_reconstruction("pycolmap", "joining the cameras' depth")
    if options.mesh:
        require_reconstruction("open3d", "making a mesh")
    output = OutputFolder(out, replaces_only(OURS))
    matcher = choose_matcher(options.matcher)
    dataset = Dataset.open(session, options.time_shifts_ms)
    adopt_kept_calibration(dataset)
    with output:
        return model_instant(dataset, matcher, options, output.folder, progress)
