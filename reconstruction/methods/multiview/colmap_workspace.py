"""COLMAP for depth: its dense workspace, and PatchMatch on a CUDA GPU.

Maps (`width&height&channels&`, then float32 row by row, channel by channel) are written here: pycolmap 4.2's
`NormalMap.from_array` takes the channels for the innermost axis, and fusion then silently drops most points.
`pycolmap-cuda12` has pycolmap's import name and aborts a process without a GPU. It is therefore never
imported here, but run by another Python.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import NotAvailableError, SimulshotError
from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.common.colmap import build_model, load_pycolmap
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import FAST_PNG, write_image
from reconstruction.common.native_libraries import foreign_calls
from reconstruction.methods.multiview.sweep_matcher import ViewDepth

POINTS_PER_VIEW = 300
"""Points per view in the sparse model; fusion finds neighbouring views by shared points only."""
ENVIRONMENT = "SIMULSHOT_CUDA_PYTHON"
HINT = (
    "python3 -m venv cuda && cuda/bin/pip install pycolmap-cuda12, then set "
    f"{ENVIRONMENT}=cuda/bin/python; or use --matcher sweep"
)
PROGRAM = """
import sys, pycolmap
pycolmap.logging.minloglevel = 2
options = pycolmap.PatchMatchOptions()
options.geom_consistency = True
options.depth_min, options.depth_max = float(sys.argv[2]), float(sys.argv[3])
pycolmap.patch_match_stereo(sys.argv[1], "COLMAP", "option-all", options)
"""


def write_workspace(
    folder: Path,
    views: Mapping[str, View],
    pictures: Mapping[str, Array],
    depth_views: Mapping[str, ViewDepth] | None = None,
    *,
    depth_range: tuple[float, float] = (0.1, 100.0),
) -> None:
    """Write a dense workspace in COLMAP's layout from undistorted images (uint8) of pinhole views.

    With `depth_views` it contains depth and normal maps, named as by COLMAP's geometric pass, and points
    that views share. Without, it contains points between the two depths of `depth_range`, from which
    COLMAP chooses what to match, and `patch-match.cfg` requests all cameras.
    """
    pycolmap = load_pycolmap("writing COLMAP's workspace")
    stereo = folder / "stereo"
    for part in ("depth_maps", "normal_maps", "consistency_graphs"):
        (stereo / part).mkdir(parents=True, exist_ok=True)
    for part in ("images", "sparse"):
        (folder / part).mkdir(exist_ok=True)
    for name in views:
        write_image(folder / "images" / f"{name}.png", pictures[name], FAST_PNG)
    points = (
        _scatter_points(views, depth_range) if depth_views is None else _shared_points(views, depth_views)
    )
    _sparse_model(pycolmap, views, points).write(folder / "sparse")
    (stereo / "fusion.cfg").write_text("".join(f"{name}.png\n" for name in views))
    (stereo / "patch-match.cfg").write_text("".join(f"{name}.png\n__auto__, 20\n" for name in views))
    for name, depth_view in (depth_views or {}).items():
        write_array(_map_file(folder, "depth", name), depth_view.depth)
        write_array(_map_file(folder, "normal", name), depth_view.normals)


def fuse_by_colmap(
    views: Mapping[str, View],
    pictures: Mapping[str, Array],
    depth_views: Mapping[str, ViewDepth],
    min_views: int,
) -> tuple[Array, Array]:
    """Fuse maps by COLMAP's stereo fusion; return points (n, 3) in the rig's frame, and colours (uint8 RGB).

    Raises:
        NotAvailableError: pycolmap is not installed.
        ForeignError: COLMAP failed.
    """
    pycolmap = load_pycolmap("fusing maps")
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        folder = Path(scratch)
        write_workspace(folder, views, pictures, depth_views)
        # COLMAP's own 10 degrees suit smoother normals.
        options = pycolmap.StereoFusionOptions(min_num_pixels=min_views, max_normal_error=30.0)
        with foreign_calls("COLMAP", "fusing maps"):
            pycolmap.stereo_fusion(
                folder / "fused.ply", folder, "COLMAP", "option-all", "geometric", options, output_type="ply"
            )
        cloud = read_ply(folder / "fused.ply")
    return cloud.points, cloud.colours


def _shared_points(views: Mapping[str, View], depth_views: Mapping[str, ViewDepth]) -> Array:
    """Return random points (n, 3) of all depth maps, in the rig's frame and unit."""
    rng = np.random.default_rng(0)
    points = []
    for name, depth_view in depth_views.items():
        rows, columns = rng.permutation(np.argwhere(depth_view.depth > 0))[:POINTS_PER_VIEW].T
        depth = depth_view.depth[rows, columns].astype(float)
        points.append(views[name].unproject(np.column_stack([columns, rows]), depth))
    return np.concatenate(points)


def _scatter_points(views: Mapping[str, View], depth_range: tuple[float, float]) -> Array:
    """Return points spread over all views between two depths, in the rig's frame (n, 3)."""
    rng = np.random.default_rng(0)
    size, nearest, far = POINTS_PER_VIEW, 1 / depth_range[0], 1 / depth_range[1]
    inverse = {name: rng.uniform(far, nearest, size) for name in views}
    pixels = {name: rng.random((size, 2)) * (view.width, view.height) for name, view in views.items()}
    return np.concatenate([view.unproject(pixels[name], 1 / inverse[name]) for name, view in views.items()])


def _sparse_model(pycolmap: Any, views: Mapping[str, View], points: Array) -> Any:
    """Build the sparse model; every view whose image contains a point sees it."""
    seen: list[dict[int, int]] = [{} for _ in points]
    pixels = {}
    for number, (name, view) in enumerate(views.items(), 1):
        in_view = points @ view.rotation.T + view.translation
        pixel = view.undistorted.project(in_view)
        inside = (in_view[:, 2] > 0) & ((pixel >= 0) & (pixel < (view.width, view.height))).all(1)
        for place, index in enumerate(np.flatnonzero(inside)):
            seen[index][number] = place
        pixels[f"{name}.png"] = pixel[inside]
    files = {f"{name}.png": view for name, view in views.items()}
    shared = (pair for pair in zip(points, seen, strict=True) if len(pair[1]) >= 2)
    return build_model(pycolmap, files, pixels, shared)


def read_maps(workspace: Path, cameras: Iterable[str]) -> dict[str, ViewDepth]:
    """Read the depth and normals that PatchMatch wrote into the workspace, by camera.

    Raises:
        SimulshotError: a map is missing or broken.
    """
    maps = {c: [read_array(_map_file(workspace, kind, c)) for kind in ("depth", "normal")] for c in cameras}
    return {
        c: ViewDepth(np.maximum(depth, 0), normal * (depth > 0)[..., None])
        for c, (depth, normal) in maps.items()
    }


def _map_file(workspace: Path, kind: str, camera: str) -> Path:
    return workspace / "stereo" / f"{kind}_maps" / f"{camera}.png.geometric.bin"


def read_array(path: Path) -> Array:
    """Read a map, float32 height x width (x channels).

    Raises:
        SimulshotError: it is missing or truncated.
    """
    try:
        *size, values = path.read_bytes().split(b"&", 3)
        width, height, channels = map(int, size)
        shaped = np.frombuffer(values, np.float32).reshape(channels, height, width).transpose(1, 2, 0)
    except (OSError, ValueError) as error:
        raise SimulshotError(
            f"{path} is not a depth or normal map of COLMAP: {error}", hint="use --matcher sweep"
        ) from error
    return np.array(shaped[..., 0] if channels == 1 else shaped)


def write_array(path: Path, values: Array) -> None:
    """Write a map of height x width (x channels)."""
    channels = values.shape[2] if values.ndim == 3 else 1
    header = f"{values.shape[1]}&{values.shape[0]}&{channels}&".encode()
    planes = np.moveaxis(values.reshape(*values.shape[:2], channels), 2, 0)
    path.write_bytes(header + np.ascontiguousarray(planes, "<f4").tobytes())


CudaGpu = tuple[str, Path]
"""A CUDA GPU's name, and the Python whose pycolmap can use it."""


def find_gpu(environment: Mapping[str, str] = os.environ) -> CudaGpu:
    """Find the first GPU, and the Python of the environment with `pycolmap-cuda12`.

    Raises:
        NotAvailableError: there is no GPU, or no environment with `pycolmap-cuda12` is named.
    """
    tool = shutil.which("nvidia-smi", path=environment.get("PATH"))
    no_gpu = NotAvailableError(
        "PatchMatch needs an NVIDIA GPU, and this machine has none", hint="use --matcher sweep"
    )
    if tool is None:
        raise no_gpu
    try:
        asked = subprocess.run(  # noqa: S603
            [tool, "--query-gpu=name", "--format=csv,noheader"], capture_output=True, text=True, timeout=30
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotAvailableError(f"the GPU does not answer: {error}", hint="use --matcher sweep") from error
    names = asked.stdout.strip().splitlines()
    if asked.returncode != 0 or not names:
        raise no_gpu
    python = environment.get(ENVIRONMENT, "")
    if not python:
        raise NotAvailableError(f"there is a GPU ({names[0]}), but no pycolmap with CUDA", hint=HINT)
    if not Path(python).is_file():
        raise NotAvailableError(f"{ENVIRONMENT} names {python}, which does not exist", hint=HINT)
    return names[0], Path(python)


def run_patch_match(gpu: CudaGpu, workspace: Path, depth_min: float, depth_max: float) -> None:
    """Compute a workspace's depth and normal maps between two depths; messages go to stderr.

    Raises:
        SimulshotError: the other process failed or died.
    """
    name, python = gpu
    command = [str(python), "-c", PROGRAM, str(workspace), repr(depth_min), repr(depth_max)]
    # Its lines go to stderr, as stdout is for data.
    done = subprocess.run(command, stdout=2, stderr=subprocess.PIPE, text=True)  # noqa: S603
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
        raise SimulshotError(
            f"PatchMatch on {name} ended with {how}: {said[-1] if said else 'no message'}",
            hint="--matcher sweep does without a GPU",
        )
